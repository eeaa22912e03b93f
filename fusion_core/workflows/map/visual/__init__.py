"""``scanloom map --slam visual``: a map by an RGB-D camera, with or without a LiDAR beside it."""
