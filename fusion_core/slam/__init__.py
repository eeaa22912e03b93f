"""Simultaneous localisation and mapping from planar scans."""
