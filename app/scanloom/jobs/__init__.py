"""Background work: a latest-only worker, long jobs, and the batch runs of the Map panel."""
