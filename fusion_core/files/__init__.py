"""File handling: atomic writes, locks, bounded reads, and inputs that are never overwritten."""
