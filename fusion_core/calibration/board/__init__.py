"""Checkerboards, and a 2D LiDAR's points with their pixels (Fu 2024 §2)."""
