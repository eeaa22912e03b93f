"""The workbench's server: where it listens, whom it lets in, and what it takes from browsers."""
