"""``scanloom fuse``: the chain of Xu 2024 over a recording, and on single frames."""
