"""MCAP files: index, walk over damaged ones, and writing."""
