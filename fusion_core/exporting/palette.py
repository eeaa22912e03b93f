"""Colours of the figures: those of Okabe and Ito (2008), distinct for colour-blind readers.

``static/palette.json`` gives the workbench the same ones. LiDAR is warm and depth blue, as in
Xu 2024.
"""

GOOD = "#009E73"
HOLE = "#56B4E9"
BURR = "#D55E00"
CONFLICT = "#CC79A7"
LIDAR = "#E69F00"
DEPTH = "#0072B2"
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
