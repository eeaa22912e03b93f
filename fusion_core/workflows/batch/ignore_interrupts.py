"""Loaded by each worker process of this machine: a terminal's Ctrl-C reaches it too, but it is the
batch itself that ends its workers."""

import signal


def dask_setup(worker: object) -> None:
    """Called in the main thread of a worker process, as Dask names it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
