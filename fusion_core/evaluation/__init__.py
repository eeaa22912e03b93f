"""Measures against truth, one definition each, for tests and commands alike."""
