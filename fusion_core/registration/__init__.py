"""Xu 2024 §2.3.1: the map A between paired points."""
