"""Xu 2024 §2.3.2: correspondence by beam and pixel, noise classes, repair."""
