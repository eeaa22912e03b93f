"""Seeds of random draws."""

SEED_MAX = 2**63 - 1
"""The largest whole number that a settings file has."""
