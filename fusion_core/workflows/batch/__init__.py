"""``scanloom batch``: one command over many recordings."""
