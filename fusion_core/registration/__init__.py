"""Xu 2024 §2.3.1: the transform A between paired points."""
