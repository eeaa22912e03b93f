"""Accuracy measures against the truth, each defined once for tests and commands."""
