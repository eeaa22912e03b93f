"""Xu 2024 §2.1-2.2: time, sampling, similarity, search, and the mount of the rig."""
