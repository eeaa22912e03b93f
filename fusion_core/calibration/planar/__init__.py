"""A 2D LiDAR and a depth camera by what both see of a room."""
