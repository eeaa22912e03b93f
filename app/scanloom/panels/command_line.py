"""The commands equivalent to the Map panel, to copy: ``scanloom fuse`` and ``scanloom map``."""

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

from fusion_core.model.names import escape_undecodable
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.options import MapOptions


def fuse_command(recording: Path, output: Path, options: FuseOptions) -> str:
    """A line for a POSIX shell that gives ``options`` to ``scanloom fuse``."""
    arguments = [
        "scanloom",
        "fuse",
        str(recording),
        "--output",
        str(output),
        *_fuse_arguments(options),
    ]
    return " ".join(map(_shell_quoted, arguments))


def map_command(recording: Path, output: Path, options: MapOptions) -> str:
    """A line for a POSIX shell that gives ``options`` to ``scanloom map``."""
    named = (
        ("--scan", None if options.is_visual else options.scan),
        ("--motion", None if options.is_visual else options.motion),
        ("--slam", options.slam),
        ("--fusion", None if options.fusion == "none" else options.fusion),
        ("--preset", None if options.preset == "default" else options.preset),
        ("--settings", options.settings_file),
        ("--seed", options.seed),
        ("--extrinsics", options.extrinsics_file),
        ("--clock-offset-ms", options.clock_offset_ms or None),
        ("--home", options.room and options.room.session),
        ("--room", options.room and options.room.room),
        ("--subsession", options.room and options.room.subsession),
        ("--lidar", options.lidar_topic),
        ("--pose", options.pose_topic),
    )
    arguments = ["scanloom", "map", str(recording), "--output", str(output)]
    arguments += [f"{option}={value}" for option, value in named if value is not None]
    switches = (("--force", options.force), ("--overwrite", options.overwrite))
    arguments += [switch for switch, is_on in switches if is_on]
    return " ".join(map(_shell_quoted, arguments))


def calibrate_command(recording: Path, output: Path, guess: Path | None) -> str:
    """A line for a POSIX shell that finds the LiDAR's pose from walls and floor."""
    arguments = ["scanloom", "calibrate", "planar", str(recording), "--output", str(output)]
    arguments += [] if guess is None else [f"--guess={guess}"]
    return " ".join(map(_shell_quoted, arguments))


def calibrate_camera_command(recording: Path, image_topic: str, output: Path) -> str:
    """A line for a POSIX shell that finds a turning LiDAR's pose in a camera's frame."""
    arguments = ["scanloom", "calibrate", "camera", str(recording), image_topic]
    return " ".join(map(_shell_quoted, [*arguments, "--output", str(output)]))


def view_command(recording: Path, extrinsics: Path) -> str:
    """A line for a POSIX shell that opens a recording with extrinsics from a file."""
    arguments = ["scanloom", "view", str(recording), f"--extrinsics={extrinsics}"]
    return " ".join(map(_shell_quoted, arguments))


def _shell_quoted(argument: str) -> str:
    """Quote an argument; bytes of a path that are not UTF-8 become escapes of bash and zsh."""
    if escape_undecodable(argument) == argument:
        return shlex.quote(argument)
    raw = os.fsencode(argument)
    plain = (chr(b) if 0x20 <= b < 0x7F and chr(b) not in "'\\" else f"\\x{b:02x}" for b in raw)
    return f"$'{''.join(plain)}'"


def _fuse_arguments(options: FuseOptions) -> Iterator[str]:
    if options.preset != "default":
        yield from ("--preset", options.preset)
    room = options.room
    named = (
        ("--home", room and room.session),
        ("--room", room and room.room),
        ("--subsession", room and room.subsession),
        ("--settings", options.settings_file),
        ("--lidar", options.lidar_topic),
        *(("--depth", topic) for topic in options.depth_topics),
        ("--pose", options.pose_topic),
        ("--extrinsics", options.extrinsics_file),
        ("--virtual-lidar", options.virtual_lidar_row),
        ("--truth", options.truth),
        ("--seed", options.seed),
    )
    for option, value in named:
        if value is not None:
            # Joined by "=": a topic may begin with a dash.
            yield f"{option}={value}"
    switches = (
        ("--apply-clock-offset", options.apply_clock_offset),
        ("--no-maps", not options.maps),
        ("--no-figures", not options.figures),
        ("--force", options.force),
        ("--overwrite", options.overwrite),
    )
    yield from (switch for switch, is_on in switches if is_on)
