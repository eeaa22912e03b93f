"""Rays and occupancy grids."""
