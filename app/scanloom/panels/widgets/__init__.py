"""Building blocks of panels: bound controls, HTML, a job with its progress bar, help texts."""
