"""Pairs of 320 x 240 a second through the whole chain, without maps and figures, on one thread.

    python -m tests.benchmarks.bench_chain

Pass 2 over the built-in sample, from pairs to the rows of the tables, after one round that compiles
and aligns. Nothing is written: that is the disk's time. The times are of the processor, not of the
clock, so other work on the machine counts little, and a hidden thread would show.
"""

import os

# Read once, when the libraries below are imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
os.environ.update(NUMBA_NUM_THREADS="1")

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from fusion_core.model.progress import silent
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse import frame, frame_result, match_images, result_writer
from fusion_core.workflows.fuse import session as session_module
from fusion_core.workflows.fuse.align import RecordingAlignment, align_recording
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.session import (
    FuseOptions,
    Session,
    open_session,
)
from fusion_core.workflows.fuse.settings import PRESETS
from tests.workflows.fuse.fused_frames import fuse_frames

SAMPLE = Path(__file__).parents[2] / "samples" / "furnished_room.mcap"
ROUNDS = 7
BAR, AIM = 150, 200
# Where pass 2 looks each of its stages up.
STAGES = {
    "search": ((match_images, "search_offset"),),
    "mount observation": ((match_images, "observe_mount"),),
    "frame yaw check": ((match_images, "motion_to_image"),),
    "correspondence": (
        (match_images, "match_along_curve"),
        (match_images, "match_in_row"),
        (match_images, "map_through_A"),
    ),
    "registration": ((match_images, "register"),),
    "classify": ((frame, "classify"),),
    "repair": ((frame, "repair"),),
    "tables": (
        (frame_result, "results_of"),
        (result_writer, "repaired_image"),
    ),
}


def chain(session: Session, alignment: RecordingAlignment) -> int:
    """Pass 2 with everything but files; returns the pairs."""
    pairs = 0
    for entry in fuse_frames(session, alignment):
        if isinstance(entry, FusedFrame):
            pairs += 1
            (result,) = frame_result.results_of([entry], alignment, session)
            result_writer.repaired_image(entry.match.pair.image, result)
    return pairs


def without_decoding(session: Session) -> Any:
    """The session's pairs come from memory."""
    kept = list(session.pairs())

    def from_memory(*_: Any, **__: Any) -> Iterator[Any]:
        return iter(kept)

    return patch.object(session_module, "paired_images", from_memory)


def seconds(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def breakdown(session: Session, alignment: RecordingAlignment) -> dict[str, float]:
    """Seconds of one run in each stage, and in what lies between them."""
    spent: dict[str, float] = defaultdict(float)

    def timed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*args: Any, **given: Any) -> Any:
            begin = time.process_time()
            try:
                return function(*args, **given)
            finally:
                spent[stage] += time.process_time() - begin

        return call

    with ExitStack() as stack:
        for stage, places in STAGES.items():
            for module, name in places:
                stack.enter_context(patch.object(module, name, timed(stage, getattr(module, name))))
        whole = seconds(lambda: chain(session, alignment))
    return {**spent, "between the stages": whole - sum(spent.values())}


def main() -> None:
    cv2.setNumThreads(1)
    with open_recording(SAMPLE) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        alignment = align_recording(session, silent)
        pairs = chain(session, alignment)
        lens = session.rig.cameras[0].intrinsics
        with_decoding = [seconds(lambda: chain(session, alignment)) for _ in range(ROUNDS)]
        with without_decoding(session):
            plain = [seconds(lambda: chain(session, alignment)) for _ in range(ROUNDS)]
            parts = [breakdown(session, alignment) for _ in range(ROUNDS)]
    print(f"1 thread; {pairs} pairs of {lens.width} x {lens.height}: median of {ROUNDS} rounds")
    print(f"{'':24}{'ms a pair':>10}{'pairs/s':>10}")
    for name, times in (("decoded before", plain), ("decoding included", with_decoding)):
        each = float(np.median(times)) / pairs
        print(f"{name:24}{1e3 * each:10.2f}{1.0 / each:10.0f}")
    print(f"bar {BAR}, aim {AIM} pairs/s\n\n{'stage':24}{'ms a pair':>10}")
    medians = {name: float(np.median([part[name] for part in parts])) for name in parts[0]}
    for name, spent in sorted(medians.items(), key=lambda item: -item[1]):
        print(f"{name:24}{1e3 * spent / pairs:10.2f}")


if __name__ == "__main__":
    main()
