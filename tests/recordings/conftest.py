"""Fixtures of the tests of all readers; the recordings themselves are built in ``samples``."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.recordings import carmen_logs as carmen_logs_module
from tests.recordings import robot_at_home_trees as robot_at_home_trees_module
from tests.recordings.samples.formats import SAMPLE_BUILDERS
from tests.recordings.samples.sample import Sample, same


@pytest.fixture(params=list(SAMPLE_BUILDERS))
def sample(request: pytest.FixtureRequest, tmp_path: Path) -> Sample:
    """One recording in each format."""
    return SAMPLE_BUILDERS[request.param](tmp_path)


@pytest.fixture
def build(tmp_path: Path) -> Callable[[str], Sample]:
    """Build a recording of a format by its name in SAMPLE_BUILDERS."""
    return lambda name: SAMPLE_BUILDERS[name](tmp_path)


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
