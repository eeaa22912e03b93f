"""Several processes give what one gives, byte by byte."""

import hashlib
import multiprocessing
import os
import signal
from pathlib import Path

import pytest

from fusion_core.model.errors import WorkerFailed
from fusion_core.simulation.scenes import SceneSettings, write_scene
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.fuse import fused_results
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("workers") / "room.mcap"
    settings = SceneSettings(seed=21, duration_s=1.0, camera_rate_hz=15.0, image_scale=0.25)
    write_scene("furnished_room", path, settings=settings)
    return path


def digests(folder: Path) -> dict[str, str]:
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def test_two_workers_fuse_to_the_same_bytes(room: Path, tmp_path: Path) -> None:
    for workers in (1, 2):
        fuse(room, tmp_path / str(workers), FuseOptions(workers=workers))
    one, two = digests(tmp_path / "1"), digests(tmp_path / "2")
    assert len(one) > 15
    assert one == two


@pytest.mark.slow
def test_two_workers_map_to_the_same_bytes(room: Path, tmp_path: Path) -> None:
    for workers in (1, 2):
        options = MapOptions(scan="repaired", workers=workers)
        build_map(room, tmp_path / str(workers), options)
    assert digests(tmp_path / "1") == digests(tmp_path / "2")


def test_the_number_of_workers_is_no_part_of_a_run(room: Path, tmp_path: Path) -> None:
    folder = tmp_path / "fused"
    fuse(room, folder, FuseOptions(figures=False, workers=1))
    assert fuse(room, folder, FuseOptions(figures=False, workers=2)).skipped


def test_a_dead_worker_leaves_no_results(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fused_results, "_fuse", _die)
    with pytest.raises(WorkerFailed, match="--workers"):
        fuse(room, tmp_path / "fused", FuseOptions(figures=False, workers=2))
    assert not (tmp_path / "fused").exists()


def _die(work: object) -> object:
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return [[]] * 4


def test_one_worker_starts_no_process() -> None:
    with WorkerPool(1) as pool:
        assert not pool.is_parallel
