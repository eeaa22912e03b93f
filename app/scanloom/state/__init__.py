"""State: open recordings, shared by all browsers, and each browser's view, history and runs."""
