"""Data types that all stages share. Imports numpy and the standard library only."""
