"""The command that is shown, run through the command line's own parser."""

import os
import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.source import RoomChoice
from scanloom import cli
from scanloom.panels.command_line import fuse_command, map_command
from scanloom.state.slam_choices import ESTIMATORS, FUSIONS, MOTIONS, SCANS
from tests.hostile.names import NO_UTF8

# What a shell, a parser or a terminal could take for something else.
AWKWARD = st.sampled_from(
    [
        "a b",
        "$(id)",
        "`id`",
        "a'b",
        'a"b',
        "-x",
        "--force",
        "a\nb",
        "a\\b",
        "*",
        "~",
        "空间",
        "=",
        "#",
    ]
)
TEXT = AWKWARD | st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=20
)
PATHS = TEXT.map(lambda text: Path("/") / "folder" / text.replace("/", "_"))
COUNTS = st.integers(0, 10_000)
ROOMS = st.builds(RoomChoice, session=TEXT, room=TEXT, subsession=st.integers(1, 9))
OPTIONS = st.builds(
    FuseOptions,
    preset=st.sampled_from(["default", "published"]),
    settings_file=st.none() | PATHS,
    room=st.none() | ROOMS,
    virtual_lidar_row=st.none() | COUNTS,
    lidar_topic=st.none() | TEXT,
    depth_topics=st.lists(TEXT, max_size=3).map(tuple),
    pose_topic=st.none() | TEXT,
    extrinsics_file=st.none() | PATHS,
    apply_clock_offset=st.booleans(),
    maps=st.booleans(),
    figures=st.booleans(),
    truth=st.none() | PATHS,
    seed=st.none() | COUNTS,
    force=st.booleans(),
    overwrite=st.booleans(),
).filter(lambda options: options.extrinsics_file is None or options.virtual_lidar_row is None)


class Captured(Exception):
    """What a workflow was asked for."""


def asked_of(workflow: str, command: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, ...]:
    """Recording, output and options that the command line makes of a command."""

    def capture(recording: Path, output: Path, options: object, *rest: object) -> None:
        raise Captured(recording, output, options)

    with monkeypatch.context() as patch:
        patch.setattr(workflow, capture)
        program, *args = shlex.split(command)
        assert program == "scanloom"
        with pytest.raises(Captured) as captured:
            cli.main(args)
    return captured.value.args


@given(recording=PATHS, output=PATHS, options=OPTIONS)
@settings(max_examples=25)
def test_the_command_line_reads_the_same_options(
    recording: Path, output: Path, options: FuseOptions
) -> None:
    command = fuse_command(recording, output, options)
    with pytest.MonkeyPatch.context() as monkeypatch:
        asked = asked_of("fusion_core.workflows.fuse.fuse.fuse", command, monkeypatch)
        # The page works in one process, the command on all cores: the results are the same.
        assert asked == (recording, output, replace(options, workers=None))


def possible(options: MapOptions) -> MapOptions:
    """Visual SLAM takes neither scans nor motion, a fusion no repaired scans."""
    if options.is_visual:
        return replace(options, scan="lidar", motion="recorded", fusion="none")
    return replace(options, fusion="none") if options.scan == "repaired" else options


MAPS = st.builds(
    MapOptions,
    scan=st.sampled_from(SCANS),
    motion=st.sampled_from(MOTIONS),
    slam=st.sampled_from(ESTIMATORS),
    fusion=st.sampled_from(FUSIONS),
    preset=st.sampled_from(["default", "published"]),
    seed=st.none() | COUNTS,
    clock_offset_ms=st.sampled_from([0.0, 40.0, -12.5]),
    settings_file=st.none() | PATHS,
    room=st.none() | ROOMS,
    lidar_topic=st.none() | TEXT,
    force=st.booleans(),
    overwrite=st.booleans(),
).filter(lambda options: options.motion != "none" or options.slam != "none")
MAPS = MAPS.map(possible)


@given(recording=PATHS, output=PATHS, options=MAPS)
@settings(max_examples=25)
def test_the_command_line_reads_the_same_options_of_a_run(
    recording: Path, output: Path, options: MapOptions
) -> None:
    command = map_command(recording, output, options)
    with pytest.MonkeyPatch.context() as monkeypatch:
        asked = asked_of("fusion_core.workflows.map.build_map.build_map", command, monkeypatch)
        # The page works in one process, the command on all cores: the results are the same.
        assert asked == (recording, output, replace(options, workers=None))


def test_a_plain_build_is_a_short_command() -> None:
    command = fuse_command(Path("/data/room.mcap"), Path("/out/room"), FuseOptions())
    assert command == "scanloom fuse /data/room.mcap --output /out/room"


def test_a_shell_runs_nothing_of_a_name(tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    name = f"x; touch {trap}; $(touch {trap}) `touch {trap}`\n'\""
    command = fuse_command(
        Path("/data") / name.replace("/", "_"),
        Path("/out"),
        FuseOptions(lidar_topic=name, depth_topics=(name,)),
    )
    frame_view = subprocess.run(
        ["/bin/sh", "-c", command.replace("scanloom", "printf '%s\\0'", 1)],
        check=True,
        capture_output=True,
    ).stdout.decode()
    assert frame_view.split("\0")[:-1] == shlex.split(command)[1:]
    assert not trap.exists()


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_a_path_that_is_no_utf8_reaches_the_command_as_it_is() -> None:
    recording = Path("/a'b\\c") / f"{NO_UTF8}0.mcap"
    command = fuse_command(recording, Path("/out"), FuseOptions())
    command.encode()
    done = subprocess.run(
        ["bash", "-c", f"printf '%s\\n' {command}"], capture_output=True, check=True, timeout=60
    )
    assert done.stdout.split(b"\n")[2] == os.fsencode(recording)
