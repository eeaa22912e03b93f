"""What panels are made of: bound controls, HTML, a job with its progress bar, help texts."""
