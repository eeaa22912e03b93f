"""Files to model values and back: one file per format, and a table of formats."""
