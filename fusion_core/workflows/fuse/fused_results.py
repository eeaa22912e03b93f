"""Pass 2: scans as they come, and what is kept of each image, by as many processes as there are."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from fusion_core.compiled import load_cached
from fusion_core.model.sensors import LaserScan
from fusion_core.worker_processes import Shared, WorkerPool
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.frame_result import FrameResult, results_of
from fusion_core.workflows.fuse.frame_tasks import FrameFuser, FrameTask, frame_tasks
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session

# Images that one task of a worker has: with more of them handing over costs less, and more wait.
_IMAGES_PER_CHUNK = 4
# Scans, and images without one, that are kept back at most.
_ENTRIES_PER_CHUNK = 256

_Entry = LaserScan | PairedImage | FrameTask


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskResults:
    """A task and what came of its images; no ``results`` where they have no offset."""

    task: FrameTask
    results: tuple[FrameResult, ...]


def prepare_to_fuse() -> None:
    """What a worker does while the recording is aligned: import and load what the chain calls."""
    import scipy.special  # noqa: F401  # the repair does with its first opening

    load_cached()


def fused_results(
    session: Session,
    alignment: RecordingAlignment,
    pool: WorkerPool,
    clock_offset_ms: float = 0.0,
    labels: SessionLabels | None = None,
) -> Iterator[LaserScan | PairedImage | TaskResults]:
    """Scans as they arrive, images without a scan, and the results of the others, in the order of
    the recording: the same for any number of workers.

    ``labels``: a person's, which overrule the classes. Raises WorkerFailed where a worker dies.
    """
    entries = frame_tasks(session, alignment, clock_offset_ms, labels)
    fuser = pool.share(FrameFuser(setup=session.setup, alignment=alignment))
    chunks = _chunks(entries, _IMAGES_PER_CHUNK if pool.is_parallel else 1)
    # The products of a frame are too small for several threads, whose sums would depend on how many
    # cores there are.
    with threadpool_limits(1, user_api="blas"):
        for chunk, fused in pool.in_order(_fuse, chunks, lambda chunk: (fuser, _tasks_in(chunk))):
            results = iter(fused)
            for entry in chunk:
                if isinstance(entry, FrameTask):
                    yield TaskResults(task=entry, results=tuple(next(results)))
                else:
                    yield entry


def _fuse(work: tuple[Shared[FrameFuser], list[FrameTask]]) -> list[list[FrameResult]]:
    """What is kept of the images of each task."""
    shared, tasks = work
    fuser = shared.value
    return [results_of(fuser.fuse(task) or (), fuser.alignment, fuser.setup) for task in tasks]


def fuse_again(
    task: FrameTask, session: Session, alignment: RecordingAlignment, pool: WorkerPool
) -> list[FusedFrame] | None:
    """The fused images of a task whole, None where they have no offset."""
    fuser = pool.share(FrameFuser(setup=session.setup, alignment=alignment))
    with threadpool_limits(1, user_api="blas"):
        ((_, fused),) = pool.in_order(_fuse_whole, [(fuser, task)], lambda work: work)
    return fused


def _fuse_whole(work: tuple[Shared[FrameFuser], FrameTask]) -> list[FusedFrame] | None:
    fuser, task = work
    return fuser.value.fuse(task)


def _tasks_in(chunk: Iterable[_Entry]) -> list[FrameTask]:
    return [entry for entry in chunk if isinstance(entry, FrameTask)]


def _chunks(entries: Iterable[_Entry], images: int) -> Iterator[list[_Entry]]:
    """Entries up to and with a task that brings a chunk to its number of images."""
    chunk: list[_Entry] = []
    waiting = 0
    for entry in entries:
        chunk.append(entry)
        waiting += len(entry.images) if isinstance(entry, FrameTask) else 0
        if waiting >= images or len(chunk) >= _ENTRIES_PER_CHUNK:
            yield chunk
            chunk, waiting = [], 0
    if chunk:
        yield chunk
