"""Extrinsics and intrinsics: Song 2022 (3D LiDAR and camera), Fu 2024 §2 and Li 2022 §2.1 (2D)."""
