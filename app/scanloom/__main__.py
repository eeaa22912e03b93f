"""``python -m scanloom``: the command of the same name."""

from scanloom.cli import run

# A worker process imports the main module of its parent.
if __name__ == "__main__":
    run()
