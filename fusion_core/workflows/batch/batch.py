"""``scanloom batch``: one command over many recordings, on Dask. The entry is ``run_batch``."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from distributed import Client

from fusion_core.model.progress import Progress, silent
from fusion_core.model.project import project_version
from fusion_core.workflows.batch.batch_folder import batch_folder
from fusion_core.workflows.batch.cache import RemoteCache
from fusion_core.workflows.batch.cluster import local_workers, workers_of
from fusion_core.workflows.batch.in_flight import endings
from fusion_core.workflows.batch.input_state import InputStates
from fusion_core.workflows.batch.items import BatchItem
from fusion_core.workflows.batch.outcome_file import StoredOutcomes, is_done
from fusion_core.workflows.batch.remote import default_cache_folder
from fusion_core.workflows.batch.run_one import Ending
from fusion_core.workflows.batch.settings import BatchSettings
from fusion_core.workflows.batch.task import BatchCall, BatchTask, outcome_path

_STAGE = "recordings"
_GIB = 1 << 30


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSummary:
    """``skipped``: how many an earlier batch had done. ``failures``: by name."""

    output: Path
    total: int
    skipped: int
    failures: tuple[Ending, ...]

    @property
    def done(self) -> int:
        """How many are done, now or before."""
        return self.total - len(self.failures)

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {
            "output": str(self.output),
            "recordings": self.total,
            "done": self.done,
            "skipped": self.skipped,
            "failures": [{"name": each.name, "error": each.error} for each in self.failures],
        }

    def lines(self) -> list[str]:
        """The same for people."""
        width = max((len(each.name) for each in self.failures), default=0)
        return [
            f"recordings  {self.total}: {self.done} done ({self.skipped} of them before), "
            f"{len(self.failures)} failed",
            *(f"failed      {each.name:<{width}}  {each.error}" for each in self.failures),
            f"results     {self.output}",
        ]


def run_batch(
    items: Sequence[BatchItem],
    call: BatchCall,
    output: Path,
    settings: BatchSettings,
    *,
    scheduler: str | None = None,
    cache_folder: Path | None = None,
    progress: Progress = silent,
) -> BatchSummary:
    """Run ``call`` on each recording: results in ``output``/runs/NAME, and what became of it in
    ``output``/outcomes/NAME.json. What an earlier batch has done and is unchanged is skipped.

    ``scheduler``: the address of one that runs; without it, worker processes are started here.
    ``cache_folder``: where workers copy remote recordings to while they read them.
    Raises ScanLoomError where the folder or the workers cannot be used, or the disk is full: what
    is done until then stays. A recording that fails is in the summary.
    """
    # As the workers know it, whose working folder may be another.
    folder = output.resolve()
    cache = RemoteCache(
        folder=(cache_folder or default_cache_folder()).resolve(),
        bytes_max=int(settings.cache_gib * _GIB),
    )
    with batch_folder(folder, call.command):
        skipped = 0
        failures: list[Ending] = []

        def left() -> Iterator[BatchTask]:
            nonlocal skipped
            for task in _tasks(items, call, folder, cache):
                if is_done(task):
                    skipped += 1
                    progress(skipped, len(items), "done before")
                else:
                    yield task

        tasks = left()
        first = next(tasks, None)
        if first is not None:
            with _workers(folder, scheduler, settings) as client:
                flow = endings(client, chain([first], tasks), settings)
                for ended, ending in enumerate(flow, start=1):
                    if ending.error is not None:
                        failures.append(ending)
                    progress(skipped + ended, len(items), _STAGE)
    return BatchSummary(
        output=output,
        total=len(items),
        skipped=skipped,
        failures=tuple(sorted(failures, key=lambda failure: failure.name)),
    )


def stored_outcomes(output: Path, items: Sequence[BatchItem]) -> StoredOutcomes:
    """What became of each recording of a batch that has ended, in their order."""
    return StoredOutcomes([outcome_path(output, item) for item in items])


def _tasks(
    items: Sequence[BatchItem], call: BatchCall, folder: Path, cache: RemoteCache
) -> Iterator[BatchTask]:
    states = InputStates()
    for item in items:
        yield BatchTask(
            item=item,
            call=call,
            folder=folder,
            version=project_version(),
            input_state=states.of(item, call),
            cache=cache,
        )


def _workers(
    folder: Path, scheduler: str | None, settings: BatchSettings
) -> AbstractContextManager[Client]:
    if scheduler is None:
        return local_workers(settings)
    return workers_of(scheduler, folder, settings)
