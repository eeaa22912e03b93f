"""Synthetic recordings with truth: worlds, sensor models, rigs, scenes."""
