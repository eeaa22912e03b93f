"""What people share (recordings, their results) and what each browser has for itself (its view)."""
