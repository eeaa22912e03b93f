"""Work beside the server's own threads: only the latest request, or one long job at a time."""
