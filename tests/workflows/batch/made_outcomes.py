"""Outcomes of a batch with results in its folder, made without any recording."""

from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.tables import CsvTable
from fusion_core.model.conventions import NS_PER_S
from fusion_core.workflows.batch.outcome import Outcome
from fusion_core.workflows.fuse.tables import FRAME_COLUMNS

DAY_NS = 86_400 * NS_PER_S
MONDAY_NS = 1_700_000_000 * NS_PER_S


def alignment_of(**changes: Any) -> dict[str, Any]:
    """alignment.json as fuse writes it, as far as a batch reads it."""
    return {
        "virtual_lidar": False,
        "score": 0.9,
        "agreement": 0.9,
        "yaw_rad": 0.12,
        "yaw_rad_sd": 0.001,
        "delta_z_m": 0.6,
        "delta_z_m_sd": 0.01,
        "forward_m": 0.05,
        "forward_m_sd": 0.004,
        "left_m": 0.03,
        "left_m_sd": 0.002,
        "pitch_rad": 0.0,
        "pitch_rad_sd": 0.005,
        "clock_offset_ms": -1.0,
        "clock_offset_ms_sd": 1.2,
        "lidar": {
            "angle_increment_rad": 0.006135923787951469,
            "beams": 682,
            "samples": 240,
        },
        "cameras": [{"width": 320, "height": 240, "fx": 288.0}],
        **changes,
    }


def frame(number: int, start_ns: int = MONDAY_NS, **changes: Any) -> dict[str, Any]:
    """A row of frames.csv, ten images a second, with a scan 3 ms before each."""
    stamp_ns = start_ns + number * NS_PER_S // 10
    row: dict[str, Any] = dict.fromkeys(FRAME_COLUMNS)
    return row | {
        "camera": "/camera/depth/image_raw",
        "stamp_ns": stamp_ns,
        "scan_stamp_ns": stamp_ns - 3_000_000,
        "u": 80.0,
        "u_alone": 80.0,
        "row_model": "curve",
        **{f"lidar_{noise}": 0 for noise in ("hole", "burr", "conflict")},
        **{f"depth_{noise}": 0 for noise in ("hole", "burr", "conflict")},
        "lidar_good": 100,
        "depth_good": 100,
        **changes,
    }


def write_run(folder: Path, frames: list[dict[str, Any]]) -> None:
    """The files of a run of fuse that a batch reads."""
    folder.mkdir(parents=True)
    (folder / "settings.toml").write_text("[search]\nprior_samples = 1\n", encoding="utf-8")
    with CsvTable(folder / "frames.csv", FRAME_COLUMNS) as table:
        for row in frames:
            table.append(row)


def done(name: str, result: dict[str, Any], **changes: Any) -> Outcome:
    """An outcome of fuse that is done."""
    values: dict[str, Any] = {
        "name": name,
        "recording": f"{name}.mcap",
        "robot": "",
        "command": "fuse",
        "error": None,
        "advice": None,
        "seconds": 3.5,
        "recorded_bytes": 12_000_000,
        "warnings": (),
        "result": result,
    }
    return Outcome(**values | changes)


def fused(
    batch: Path, name: str, frames: list[dict[str, Any]], *, robot: str = "", **alignment: Any
) -> Outcome:
    """Write the results of ``name`` below ``batch`` and return its outcome."""
    write_run(batch / "runs" / name, frames)
    paired = sum(row["scan_stamp_ns"] is not None for row in frames)
    result = {"frames": len(frames), "paired": paired, "alignment": alignment_of(**alignment)}
    return done(name, result, robot=robot)


def failed(name: str, error: str = "is cut off.", advice: str = "Copy it again.") -> Outcome:
    """An outcome of a recording that cannot be read."""
    return done(name, {}, error=error, advice=advice)


def fleet(batch: Path, count: int = 12, seed: int = 0, robot: str = "") -> list[Outcome]:
    """A sound rig's recordings, one a day, each with its own noise."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for number in range(count):
        start_ns = MONDAY_NS + number * DAY_NS
        holes, burrs = (int(n) for n in rng.normal([12.0, 3.0], [2.0, 0.5]).clip(0.0))
        frames = [
            frame(place, start_ns, lidar_hole=holes, depth_hole=holes, lidar_burr=burrs)
            for place in range(5)
        ]
        outcomes.append(
            fused(
                batch,
                f"{robot or 'run'}_{number:02d}",
                frames,
                robot=robot,
                yaw_rad=0.12 + float(rng.normal(0.0, 0.001)),
                clock_offset_ms=float(rng.normal(0.0, 2.0)),
                agreement=0.9 + float(rng.normal(0.0, 0.005)),
            )
        )
    return outcomes
