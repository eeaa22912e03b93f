"""Colours and scale bar of maps on the screen, the same as in the files."""

from fusion_core.exporting.map_picture import FREE, UNKNOWN, difference_colors, scale_bar_m

__all__ = ["FREE", "UNKNOWN", "difference_colors", "scale_bar_m"]
