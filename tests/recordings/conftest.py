"""Fixtures of the tests of all readers; the recordings themselves are built in ``samples``."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.recordings import carmen_logs as carmen_logs_module
from tests.recordings import robot_at_home_trees as robot_at_home_trees_module
from tests.recordings.samples.formats import SAMPLE_BUILDERS
from tests.recordings.samples.sample import Sample, same

NewSample = Callable[[str, Path], Sample]


@pytest.fixture(scope="session")
def new_sample(tmp_path_factory: pytest.TempPathFactory) -> NewSample:
    """Put a recording of a format, by its name in SAMPLE_BUILDERS, into an empty folder.

    Each is built once and copied.
    """

    @cache
    def built(name: str) -> tuple[Path, Sample]:
        folder = tmp_path_factory.mktemp("sample")
        return folder, SAMPLE_BUILDERS[name](folder)

    def copied(name: str, folder: Path) -> Sample:
        source, sample = built(name)
        shutil.copytree(source, folder, dirs_exist_ok=True)
        return replace(sample, path=folder / sample.path.relative_to(source))

    return copied


@pytest.fixture(params=list(SAMPLE_BUILDERS))
def sample(request: pytest.FixtureRequest, new_sample: NewSample, tmp_path: Path) -> Sample:
    """One recording in each format."""
    return new_sample(request.param, tmp_path)


@pytest.fixture
def build(new_sample: NewSample, tmp_path: Path) -> Callable[[str], Sample]:
    """Build a recording of a format by its name in SAMPLE_BUILDERS."""
    return lambda name: new_sample(name, tmp_path)


@pytest.fixture
def robot_at_home_trees() -> Any:
    """The writers of both versions of Robot@Home."""
    return robot_at_home_trees_module


@pytest.fixture
def carmen_logs() -> Any:
    """The writer of a CARMEN log with every kind of line."""
    return carmen_logs_module


@pytest.fixture
def same_value() -> Callable[[object, object], bool]:
    """Equality of frozen values that hold arrays; NaN equals NaN."""
    return same
