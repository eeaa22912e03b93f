"""Robot@Home, plain text and Robot@Home2."""
