"""Folders of depth and colour images."""
