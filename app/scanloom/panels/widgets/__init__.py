"""Building blocks of panels: bound controls, a job with its progress bar, help texts."""
