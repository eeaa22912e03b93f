"""Errors of the estimated mount against the deviations that it states, on recordings with truth.

    python -m tests.benchmarks.bench_mount_uncertainty ROOMS [--only room_4 ...] [--starts 10]
        [--frames 12]

ROOMS is a folder of recordings with NAME.truth.npz beside them, which hold ``cam_yaw`` and, where
the mount differs from that of the folder's README, ``cam_pitch``, ``cam_offset``, ``cam_z`` and
``lidar_z``. Nothing of the mount is known to the estimate: recorded transforms are left out. It is
made as ``fuse`` makes it, from pieces of consecutive frames, their starts spread evenly over each
recording, and from each recording as a whole.

The normalised error squared of a parameter is (error / deviation)^2, over the pieces that call it
observable. Were the errors normal with the stated deviations, its mean over n would lie between
the 2.5 % and 97.5 % quantiles of chi^2_n / n; pieces of one recording see one room and overlap, so
that they are fewer than n in truth.
"""

import argparse
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.stats import chi2

from fusion_core.model.conventions import wrap_angle
from fusion_core.model.recording import Message, Recording
from fusion_core.model.rig import Mount
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.align import RecordingAlignment, align_recording
from fusion_core.workflows.fuse.session import FuseOptions, Session, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from tests.benchmarks.known_recordings import CLOCK_OFFSET_MS

# The mount of the rooms whose truth has the yaw alone, by their README.
README_MOUNT = {"cam_pitch": 0.0, "cam_offset": (0.05, 0.03), "cam_z": 0.92, "lidar_z": 0.31}
UNITS = (
    ("yaw", "deg"),
    ("delta_z", "m"),
    ("forward", "m"),
    ("left", "m"),
    ("pitch", "deg"),
    ("clock", "ms"),
)
FACTORS = np.array([180.0 / np.pi if unit == "deg" else 1.0 for _, unit in UNITS])
# Rooms that nothing was chosen on are reported apart.
HELD_OUT = ("room_6", "room_7", "room_8", "room_9")


class Piece:
    """The images ``first`` to ``last`` of a recording, with all of its scans."""

    def __init__(self, recording: Recording, depth_topic: str, first: int, last: int) -> None:
        self._recording = recording
        self._depth_topic = depth_topic
        self._images = range(first, last)
        self.topics = tuple(
            replace(topic, count=last - first) if topic.name == depth_topic else topic
            for topic in recording.topics
        )

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """The messages of the piece, in order."""
        for message in self._recording.messages(topics, start_ns, end_ns):
            if message.topic != self._depth_topic or message.index in self._images:
                yield message


@dataclass(frozen=True)
class Trial:
    """What one estimate says of one recording: (6,) errors and deviations in the units of UNITS,
    nan where not observable."""

    room: str
    piece: str
    errors: np.ndarray
    sd: np.ndarray
    agreement: float
    seconds: float


def true_mount(path: Path) -> Mount:
    """The mount that the truth beside a recording states."""
    arrays = dict(np.load(path))
    stated = {name: arrays.get(name, value) for name, value in README_MOUNT.items()}
    forward_m, left_m = np.asarray(stated["cam_offset"], dtype=float)
    return Mount(
        yaw_rad=float(arrays["cam_yaw"]),
        delta_z_m=float(np.subtract(stated["cam_z"], stated["lidar_z"])),
        forward_m=float(forward_m),
        left_m=float(left_m),
        pitch_rad=float(np.asarray(stated["cam_pitch"])),
        clock_offset_ms=CLOCK_OFFSET_MS.get(path.name.split(".")[0], 0.0),
    )


def trial(room: str, piece: str, session: Session, truth: Mount) -> Trial:
    """Estimate the mount of a session, and compare."""
    begin = time.perf_counter()
    alignment: RecordingAlignment = align_recording(session)
    seconds = time.perf_counter() - begin
    assert alignment.estimate is not None
    mount = alignment.estimate.mount
    errors = mount.vector() - truth.vector()
    errors[[0, 4]] = wrap_angle(errors[[0, 4]])
    sd = np.array([np.nan if value is None else value for value in mount.sd])
    return Trial(room, piece, errors * FACTORS, sd * FACTORS, alignment.estimate.agreement, seconds)


def recordings(folder: Path, only: list[str]) -> Iterator[tuple[str, Path, Path]]:
    """Name, recording and truth."""
    for truth in sorted(folder.glob("*.truth.npz")):
        name = truth.name.removesuffix(".truth.npz")
        found = [path for path in sorted(folder.glob(f"{name}*")) if path != truth]
        if name in only and found:
            yield name, found[0], truth


def trials_of(
    name: str, path: Path, truth: Mount, starts: int, frames: int
) -> tuple[Trial, list[Trial]]:
    """The trial of a whole recording and those of its pieces."""
    with open_recording(path) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        session = replace(session, rig=replace(session.rig, recorded_mount=None))
        whole = trial(name, "all", session, truth)
        topic = session.rig.cameras[0].topic
        count = session.image_count
        pieces = []
        for first in np.linspace(0, count - frames, starts).round().astype(int):
            piece = cast(Recording, Piece(recording, topic, int(first), int(first) + frames))
            pieces.append(trial(name, f"{first}", replace(session, recording=piece), truth))
    return whole, pieces


def show_trial(one: Trial) -> None:
    """A line with error / deviation of each parameter."""
    cells = []
    for error, sd in zip(one.errors, one.sd, strict=True):
        stated = "   ----" if np.isnan(sd) else f"{sd:7.3f}"
        cells.append(f"{error:+8.3f} / {stated}")
    print(
        f"{one.room} {one.piece:>4}  {'  '.join(cells)}  {one.agreement:.2f}  {one.seconds:.1f} s"
    )


def show_normalised(title: str, trials: list[Trial]) -> None:
    """The table of normalised errors squared."""
    if not trials:
        return
    print(f"\n{title}: {len(trials)} estimates")
    print(
        "parameter  observable  mean NEES  95 % of chi2/n  largest |error|/sd  median |error|, sd"
    )
    for index, (name, unit) in enumerate(UNITS):
        errors = np.array([one.errors[index] for one in trials])
        sd = np.array([one.sd[index] for one in trials])
        seen = np.isfinite(sd)
        n = int(seen.sum())
        line = f"{name:9}  {n:3d} of {len(trials):3d}"
        if n:
            normalised = errors[seen] / sd[seen]
            low, high = chi2.ppf([0.025, 0.975], n) / n
            mean = np.mean(normalised**2)
            verdict = "in " if low <= mean <= high else "OUT"
            line += (
                f"  {mean:9.2f}  {low:.2f} .. {high:.2f} {verdict}"
                f"  {np.abs(normalised).max():18.1f}"
                f"  {np.median(np.abs(errors[seen])):.3f}, {np.median(sd[seen]):.3f} {unit}"
            )
        print(line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", type=Path)
    parser.add_argument("--only", nargs="*", default=[f"room_{i}" for i in range(3, 10)])
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--frames", type=int, default=12)
    asked = parser.parse_args()
    whole: list[Trial] = []
    pieces: list[Trial] = []
    names = "  ".join(f"{f'{name} [{unit}]':>18}" for name, unit in UNITS)
    print(f"error / deviation (---- where not observable)\nroom  piece{names}  agreement")
    for name, path, truth in recordings(asked.rooms, asked.only):
        first, others = trials_of(name, path, true_mount(truth), asked.starts, asked.frames)
        for one in [first, *others]:
            show_trial(one)
        whole.append(first)
        pieces += others
    show_normalised(f"pieces of {asked.frames} frames", pieces)
    held_out = [one for one in pieces if one.room in HELD_OUT]
    show_normalised(f"pieces of {asked.frames} frames of {', '.join(HELD_OUT)}", held_out)
    show_normalised("whole recordings", whole)
    yaws = np.abs([one.errors[0] for one in whole])
    worst = whole[int(yaws.argmax())].room
    print(
        f"\nyaw error over whole recordings: median {np.median(yaws):.2f} deg, worst "
        f"{yaws.max():.2f} deg ({worst})"
    )


if __name__ == "__main__":
    main()
