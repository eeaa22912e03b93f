"""``scanloom calibrate``: a LiDAR and a camera put into one frame."""
