"""Odometry from wheels, laser and camera, and their fusion (Li 2022 §3)."""
