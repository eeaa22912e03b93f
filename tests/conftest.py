"""What all tests share: reproducible examples, and the recordings of SCANLOOM_TEST_DATA."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in each run, and no clock: a slow machine is no failure.
settings.register_profile("scanloom", deadline=None, derandomize=True)
settings.load_profile("scanloom")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder that holds rooms/ and real/. Tests that use it are marked ``data``."""
    folder = os.environ.get("SCANLOOM_TEST_DATA")
    if not folder:
        pytest.skip("SCANLOOM_TEST_DATA names no folder with rooms/ and real/")
    path = Path(folder)
    if not (path / "rooms").is_dir():
        pytest.fail(f"SCANLOOM_TEST_DATA={folder} has no folder rooms/")
    return path


@pytest.fixture(scope="session", params=["room_1", "room_2.bag", "room_3"])
def room_path(request: pytest.FixtureRequest, data_folder: Path) -> Path:
    """Each of the three rooms' recordings in turn."""
    return data_folder / "rooms" / str(request.param)


@pytest.fixture(scope="session")
def room_truth_path(room_path: Path) -> Path:
    """The truth of ``room_path``."""
    return room_path.with_name(f"{room_path.stem}.truth.npz")
