"""Frozen values that every stage shares. This package imports numpy and nothing else."""
