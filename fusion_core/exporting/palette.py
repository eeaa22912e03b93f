"""Colours of the figures: one for each noise class, each sensor and the fused result.

``static/palette.json`` gives the workbench the same ones. LiDAR is warm and depth blue, as in
Xu 2024. The hues follow Okabe and Ito (2008); lightness and hue were then searched for colours that
all have a contrast of at least 3 : 1 to a white and to a dark page, and that differ from each other
and from the middle of cividis as much as they can for readers with deuteranopia.
"""

GOOD = "#52A05A"
HOLE = "#149CDC"
BURR = "#C93828"
CONFLICT = "#A8549E"
LIDAR = "#E27504"
DEPTH = "#1473E6"
FUSED = "#000000"
UNKNOWN = "#c4ccd6"
"""Unknown cells of maps."""

PALETTE = {
    "good": GOOD,
    "hole": HOLE,
    "burr": BURR,
    "conflict": CONFLICT,
    "lidar": LIDAR,
    "depth": DEPTH,
    "fused": FUSED,
}
