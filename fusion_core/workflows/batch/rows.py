"""The row of a recording of a batch, from its outcome and the results in its folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion_core.files.regular_file import open_regular, read_head
from fusion_core.model.conventions import NS_PER_S, BoolArray
from fusion_core.model.names import escape_undecodable, printable
from fusion_core.model.rig import MOUNT_PARAMETERS
from fusion_core.workflows.batch.columns import Row, unknown_row
from fusion_core.workflows.batch.frame_totals import FrameTotals
from fusion_core.workflows.batch.outcome import Outcome

if TYPE_CHECKING:
    import pyarrow as pa

_CLASSES = ("good", "hole", "burr", "conflict")
_COUNTS = tuple(f"{sensor}_{noise}" for sensor in ("lidar", "depth") for noise in _CLASSES)
_STAMPS = ("stamp_ns", "scan_stamp_ns")
_OFFSETS = ("u", "u_alone")
# A block of frames.csv: memory does not grow with the length of a recording.
_BLOCK_BYTES = 1 << 20
_LINE_BYTES = 4096
_SETTINGS_BYTES_MAX = 1 << 20
# Of one recording: a report is read by a person.
_WARNINGS_MAX = 20


def read_row(outcome: Outcome, run_folder: Path) -> Row:
    """The row of ``outcome``, whose results lie in ``run_folder``.

    What cannot be read of the results is null, and a warning of the row says why.
    """
    row = unknown_row()
    row.update(
        name=printable(outcome.name),
        recording=printable(outcome.recording),
        robot=printable(outcome.robot),
        command=outcome.command,
        state="done" if outcome.is_done else "failed",
        error=None if outcome.error is None else printable(outcome.error),
        advice=None if outcome.advice is None else printable(outcome.advice),
        seconds=_number(outcome.seconds),
        recorded_bytes=outcome.recorded_bytes,
        warnings=[printable(text) for text in outcome.warnings[:_WARNINGS_MAX]],
    )
    if not outcome.is_done:
        return row
    readers = {"info": _read_info, "fuse": _read_fuse, "map": _read_map}
    if outcome.command in readers:
        try:
            readers[outcome.command](row, outcome.result, run_folder)
        except (OSError, ValueError, LookupError, TypeError) as error:
            text = escape_undecodable(f"{type(error).__name__}: {error}")
            row["warnings"].append(printable(f"The results cannot be read back: {text}"))
    return row


def _read_info(row: Row, result: Mapping[str, Any], _: Path) -> None:
    row.update(start_ns=_whole(result["start_ns"]), duration_s=_number(result["duration_s"]))
    counts = [topic["count"] for topic in result["topics"] if topic["role"] == "depth"]
    row["frames"] = sum(counts) if counts else None


def _read_map(row: Row, result: Mapping[str, Any], folder: Path) -> None:
    row["duration_s"] = _number(result["duration_s"])
    if result.get("slam") == "visual":
        # It places images; those without a pose are not trusted.
        row.update(
            frames=_whole(result["images"]),
            paired=_whole(result["images_tracked"]),
            untrusted_stretches=len(result["lost"]),
        )
    else:
        row.update(
            frames=_whole(result["scans_recorded"]),
            paired=_whole(result["scans"]),
            untrusted_stretches=len(result["untrusted"]),
        )
    trusted = _proportion(result["trusted_share"])
    row["untrusted_share"] = None if trusted is None else 1.0 - trusted
    lines = read_head(folder / "trajectory.tum", _LINE_BYTES).decode().splitlines()
    first = next(line for line in [*lines, "no pose"] if not line.startswith("#"))
    seconds, _, fraction = first.split(maxsplit=1)[0].partition(".")
    row["start_ns"] = int(seconds) * NS_PER_S + int(fraction.ljust(9, "0")[:9])


def _read_fuse(row: Row, result: Mapping[str, Any], folder: Path) -> None:
    if "alignment" not in result:
        row["warnings"].append("These are several rooms: each has results of its own.")
        return
    alignment = result["alignment"]
    row.update(
        frames=_whole(result["frames"]),
        paired=_whole(result["paired"]),
        agreement=_proportion(alignment["agreement"]),
        peak_score=_number(alignment["score"]),
        geometry=describe_geometry(alignment),
    )
    for name in MOUNT_PARAMETERS:
        row[name], row[f"{name}_sd"] = (
            _number(alignment[name]),
            _number(alignment[f"{name}_sd"]),
        )
    row.update(_read_frames(folder, alignment))


def describe_geometry(alignment: Mapping[str, Any]) -> str:
    """LiDAR and cameras as text, equal for sensors of one kind."""
    lidar = alignment["lidar"]
    field_deg = abs(lidar["angle_increment_rad"]) * lidar["beams"] * 180.0 / pi
    cameras = []
    for camera in alignment["cameras"]:
        width, focal = camera["width"], camera["fx"]
        view = "" if focal is None else f" {2 * np.degrees(np.arctan(0.5 * width / focal)):.0f}°"
        cameras.append(f"{width} × {camera['height']}{view}")
    kind = "virtual LiDAR" if alignment["virtual_lidar"] else "LiDAR"
    return f"{kind} {lidar['beams']} beams {field_deg:.0f}°, camera {', '.join(cameras)}"


@dataclass(slots=True, kw_only=True)
class _FrameRows:
    """What is known of a recording after some of the rows of its frames.csv."""

    totals: FrameTotals
    first_ns: int | None = None
    last_ns: int | None = None
    untrusted_stretches: int = 0
    is_in_stretch: bool = False

    def add(self, block: "pa.RecordBatch", prior_samples: float, turn: float | None) -> None:
        """Add the images of a block, which follow those before."""
        import pyarrow.compute as pc

        for name in _STAMPS:
            ends = pc.min_max(block[name]).as_py()
            if ends["min"] is not None:
                known = [ns for ns in (self.first_ns, self.last_ns) if ns is not None]
                self.first_ns = min(*known, ends["min"], ends["max"])
                self.last_ns = max(*known, ends["min"], ends["max"])
        is_paired = np.asarray(pc.is_valid(block["scan_stamp_ns"]))
        untrusted = is_paired & ~_is_trusted(block, prior_samples, turn)
        before = np.concatenate([[self.is_in_stretch], untrusted[:-1]])
        counts = [np.asarray(pc.fill_null(block[name], 0)) for name in _COUNTS]
        self.totals.add(np.stack([*counts, is_paired, untrusted], axis=1))
        self.untrusted_stretches += int((untrusted & ~before).sum())
        if untrusted.size:
            self.is_in_stretch = bool(untrusted[-1])


def _is_trusted(block: "pa.RecordBatch", prior_samples: float, turn: float | None) -> BoolArray:
    """(B,) whether an image's pairs lie where they should: along the recording's mount, or at an
    offset that is the best one anywhere."""
    import pyarrow.compute as pc

    u, alone = (block[name].to_numpy(zero_copy_only=False) for name in _OFFSETS)
    apart = np.abs(alone - u)
    if turn is not None:
        apart = np.abs((alone - u + 0.5 * turn) % turn - 0.5 * turn)
    on_curve = np.asarray(pc.fill_null(pc.equal(block["row_model"], "curve"), False))
    with np.errstate(invalid="ignore"):
        trusted: BoolArray = on_curve | (apart <= prior_samples)
    return trusted


def _read_frames(folder: Path, alignment: Mapping[str, Any]) -> Row:
    """What frames.csv tells, read block by block. Raises OSError, ValueError and KeyError."""
    import pyarrow as pa
    import pyarrow.csv as csv

    lidar = alignment["lidar"]
    step_rad = abs(lidar["angle_increment_rad"])
    is_full_turn = step_rad * (lidar["beams"] + 0.5) >= 2.0 * pi
    turn = float(lidar["samples"]) if is_full_turn else None
    prior_samples = _prior_samples(folder / "settings.toml")
    types = {name: pa.int64() for name in (*_COUNTS, *_STAMPS)}
    types |= {name: pa.float64() for name in _OFFSETS} | {"row_model": pa.string()}
    options = csv.ConvertOptions(
        include_columns=list(types), column_types=types, strings_can_be_null=True
    )
    totals = FrameTotals((*_COUNTS, "paired", "untrusted"))
    rows = _FrameRows(totals=totals)
    read = csv.ReadOptions(block_size=_BLOCK_BYTES, use_threads=False)
    with (
        open_regular(folder / "frames.csv") as stream,
        csv.open_csv(stream, read_options=read, convert_options=options) as blocks,
    ):
        for block in blocks:
            rows.add(block, prior_samples, turn)
    row: Row = {}
    for sensor in ("lidar", "depth"):
        classes = tuple(f"{sensor}_{noise}" for noise in _CLASSES)
        for column in classes[1:]:
            row[f"{column}_share"], row[f"{column}_share_sd"] = totals.share(column, classes)
    if rows.first_ns is not None and rows.last_ns is not None:
        row["start_ns"] = rows.first_ns
        row["duration_s"] = (rows.last_ns - rows.first_ns) / NS_PER_S
    share = totals.share("untrusted", ("paired",))
    row["untrusted_share"], row["untrusted_share_sd"] = share
    if totals.total("paired"):
        row["untrusted_stretches"] = rows.untrusted_stretches
    return row


def _prior_samples(settings_file: Path) -> float:
    """How far an image's own offset may lie from the recording's. Raises OSError, ValueError."""
    import tomllib

    text = read_head(settings_file, _SETTINGS_BYTES_MAX).decode()
    return float(tomllib.loads(text)["search"]["prior_samples"])


def _number(value: Any) -> float | None:
    """A finite number, or None."""
    is_known = isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    return float(value) if is_known else None


def _proportion(value: Any) -> float | None:
    """A number from 0 to 1, or None."""
    number = _number(value)
    return number if number is not None and 0.0 <= number <= 1.0 else None


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None
