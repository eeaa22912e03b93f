"""Files as such: written whole or not at all, held by one process alone, and inputs kept."""
