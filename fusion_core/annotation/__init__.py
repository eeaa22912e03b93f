"""People's labels: their journal, its history, their agreement, and files that others read."""
