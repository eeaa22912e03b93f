"""Readers of recordings in every format, and writers: files to model values and back."""
