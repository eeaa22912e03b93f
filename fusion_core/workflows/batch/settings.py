"""The settings of a batch: none of them changes a result."""

from fusion_core.settings import StageSettings, setting


class BatchSettings(StageSettings):
    """How the work is shared out."""

    workers: int = setting(
        0, "Worker processes of this machine, 0 for one a core", unit="processes", ge=0, le=1024
    )
    memory_gib: float = setting(
        0.0,
        "Memory of a worker process, which is ended above it; 0 shares this machine's memory out",
        unit="GiB",
        ge=0.0,
        le=65_536.0,
    )
    tasks_per_worker: int = setting(
        2, "Recordings that are sent to a worker ahead", unit="recordings", ge=1, le=100
    )
    worker_deaths_max: int = setting(
        1,
        "How often a recording is tried again after its worker process died, among the others and "
        "then alone; another scheduler decides for itself",
        unit="times",
        ge=0,
        le=100,
    )
    connect_s: float = setting(
        20.0,
        "How long a scheduler and its first worker may take to answer",
        unit="s",
        ge=0.1,
        le=3600.0,
    )
    cache_gib: float = setting(
        20.0, "The cache of remote recordings on each machine", unit="GiB", ge=0.001, le=1_000_000.0
    )
