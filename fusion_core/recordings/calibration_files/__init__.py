"""Calibrations as people have them, told by content: a camera's intrinsics, a LiDAR's extrinsics,
and what ``scanloom calibrate`` itself has written."""
