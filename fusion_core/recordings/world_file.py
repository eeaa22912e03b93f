"""World files: the outline of a world as JSON, ``NAME.world.json`` beside a synthetic recording.

    {"format": "scanloom-world", "version": 1, "units": "m", "frame": "map",
     "robot_height_m": 0.55,
     "obstacles": [{"name": …, "z_min_m": …, "z_max_m": …, "outline": [[x, y], …],
                    "seen_by": {"lidar": [[start, end], …], "camera": …}}, …],
     "lines": [{"name": …, "length_m": …, "faces": [[[x, y], [x, y]], [[x, y], [x, y]]]}, …],
     "angles": [{"name": …, "angle_deg": …, "arms": [[[x, y], [x, y]], [[x, y], [x, y]]]}, …]}

An outline is sampled at most 1 cm apart: S = ceil(length / 1 cm) samples, in the middles of S
pieces of equal length; ``seen_by`` lists runs [start, end) of samples. Outlines and faces decide;
``length_m`` and ``angle_deg`` are for people who measure by hand.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fusion_core.files.atomic import cannot_write, write_text
from fusion_core.files.regular_file import read_regular
from fusion_core.model.errors import RecordingError
from fusion_core.model.world_outline import (
    MeasuredAngle,
    MeasuredLine,
    ObstacleOutline,
    WorldOutline,
)

_VERSION = 1
_MAX_BYTES = 64 << 20
# A hundred kilometres of outline, sampled every centimetre.
_MAX_LENGTH_M = 1e5
_DIGITS = 6
_ADVICE = "It must be a world file as `scanloom sample` writes it."

_Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
_Point = tuple[_Coordinate, _Coordinate]
_Segment = tuple[_Point, _Point]
_Name = Annotated[str, Field(min_length=1, max_length=200)]
_Count = Annotated[int, Field(ge=0, le=1 << 40)]
_Run = tuple[_Count, _Count]


class _StrictModel(BaseModel):
    # Strict: text is no number. Unknown keys may come with later versions of what is known.
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _SeenBy(_StrictModel):
    lidar: list[_Run] = []
    camera: list[_Run] = []


class _Obstacle(_StrictModel):
    name: _Name
    z_min_m: _Coordinate
    z_max_m: _Coordinate
    outline: Annotated[list[_Point], Field(min_length=2)]
    seen_by: _SeenBy


class _Line(_StrictModel):
    name: _Name
    faces: tuple[_Segment, _Segment]


class _Angle(_StrictModel):
    name: _Name
    arms: tuple[_Segment, _Segment]


class _World(_StrictModel):
    format: Literal["scanloom-world"]
    version: int
    units: Literal["m"]
    frame: _Name
    robot_height_m: Annotated[float, Field(gt=0.0, le=100.0)]
    obstacles: list[_Obstacle]
    lines: list[_Line] = []
    angles: list[_Angle] = []


def world_path(recording: Path) -> Path:
    """The path of a recording's world file: ``NAME.mcap`` has ``NAME.world.json`` beside it."""
    return recording.with_name(f"{recording.stem}.world.json")


def read_world(file: Path) -> WorldOutline:
    """Read a world file.

    Raises RecordingError, naming the place in the file, for what is no world of this version;
    OSError where the file cannot be read, is no regular file or is larger than 64 MiB.
    """
    content = read_regular(file, _MAX_BYTES)
    try:
        stated = _World.model_validate_json(content)
    except ValidationError as error:
        raise RecordingError(_describe_first_error(error), file=file, advice=_ADVICE) from error
    if stated.version != _VERSION:
        raise RecordingError(
            f"is a world file of version {stated.version}.",
            file=file,
            advice=f"This version of ScanLoom reads version {_VERSION}.",
        )
    try:
        return _world_from_file(stated)
    except ValueError as error:
        raise RecordingError(f"{error}.", file=file, advice=_ADVICE) from error


def write_world(file: Path, world: WorldOutline) -> None:
    """Write a world file, whole or not at all; the same world gives the same bytes.

    Raises ExportError where it cannot be written.
    """
    try:
        write_text(file, _format_world(world))
    except OSError as error:
        raise cannot_write(file, error) from error


def _world_from_file(stated: _World) -> WorldOutline:
    total_m = 0.0
    obstacles = []
    for part in stated.obstacles:
        outline_m = np.array(part.outline, dtype=np.float64)
        total_m += float(np.linalg.norm(np.diff(outline_m, axis=0), axis=1).sum())
        if total_m > _MAX_LENGTH_M:
            raise ValueError(f"its outlines are longer than {_MAX_LENGTH_M:g} m")
        runs = {"lidar": part.seen_by.lidar, "camera": part.seen_by.camera}
        obstacles.append(
            ObstacleOutline(
                name=part.name,
                z_min_m=part.z_min_m,
                z_max_m=part.z_max_m,
                outline_m=outline_m,
                seen_by={
                    sensor: np.array(own, dtype=np.int64).reshape(-1, 2)
                    for sensor, own in runs.items()
                },
            )
        )
    return WorldOutline(
        robot_height_m=stated.robot_height_m,
        obstacles=tuple(obstacles),
        lines=tuple(
            MeasuredLine(name=line.name, faces_m=np.array(line.faces, dtype=np.float64))
            for line in stated.lines
        ),
        angles=tuple(
            MeasuredAngle(name=angle.name, arms_m=np.array(angle.arms, dtype=np.float64))
            for angle in stated.angles
        ),
        frame_id=stated.frame,
    )


def _format_world(world: WorldOutline) -> str:
    """A line for each obstacle, line and angle: readable, and small."""
    head = {
        "format": "scanloom-world",
        "version": _VERSION,
        "units": "m",
        "frame": world.frame_id,
        "robot_height_m": world.robot_height_m,
    }
    obstacles = [
        {
            "name": obstacle.name,
            "z_min_m": round(obstacle.z_min_m, _DIGITS),
            "z_max_m": round(obstacle.z_max_m, _DIGITS),
            "outline": _round(obstacle.outline_m),
            "seen_by": {sensor: runs.tolist() for sensor, runs in obstacle.seen_by.items()},
        }
        for obstacle in world.obstacles
    ]
    lines = [
        {
            "name": line.name,
            "length_m": round(line.length_m, _DIGITS),
            "faces": _round(line.faces_m),
        }
        for line in world.lines
    ]
    angles = [
        {
            "name": angle.name,
            "angle_deg": round(float(np.degrees(angle.angle_rad)), _DIGITS),
            "arms": _round(angle.arms_m),
        }
        for angle in world.angles
    ]
    parts = [f'"{key}": {json.dumps(value)}' for key, value in head.items()]
    parts += [
        f'"{key}": {_format_entries(entries)}'
        for key, entries in (("obstacles", obstacles), ("lines", lines), ("angles", angles))
    ]
    return "{" + ",\n ".join(parts) + "}\n"


def _format_entries(entries: Sequence[dict[str, Any]]) -> str:
    return "[" + ",\n  ".join(json.dumps(entry) for entry in entries) + "]"


def _round(values: np.ndarray[Any, np.dtype[np.float64]]) -> Any:
    # Adding zero makes -0.0 to 0.0.
    return (np.round(values, _DIGITS) + 0.0).tolist()


def _describe_first_error(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(str(step) for step in first["loc"])
    return f"{where}: {first['msg']}." if where else f"{first['msg']}."
