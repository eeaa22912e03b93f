"""How maps are coloured and measured, for pictures on the screen: as in the files."""

from fusion_core.exporting.map_picture import FREE, UNKNOWN, difference_colors, scale_bar_m

__all__ = ["FREE", "UNKNOWN", "difference_colors", "scale_bar_m"]
