"""The Map panel: a build from the button to the files, and one that is cancelled."""

import re
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from playwright.sync_api import expect

from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
from fusion_core.workflows.fuse.session import FuseOptions
from scanloom.jobs.build import Build, build
from scanloom.server.workbench import Workbench
from scanloom.state.view import View
from tests.app.browser.person import Person, decoded
from tests.patience import ENOUGH_S

VOXEL_M = 0.1


@pytest.fixture(scope="module")
def fused(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> FuseSummary:
    """What the command makes of the recording."""
    output = tmp_path_factory.mktemp("fused") / "results"
    return fuse(small_scene, output, FuseOptions(figures=False))


def test_a_build_shows_its_maps_and_exports_its_clouds(
    person: Person, fused: FuseSummary, output_root: Path
) -> None:
    begin_build(person)
    expect(person.button("Download .zip")).to_be_visible()
    expect(person.button("Cancel")).to_have_count(0)
    # The panel's picture is the file that was written.
    person.wait_for_figure(picture_in(fused.output, "map_fused"))
    person.choose("Figure", "difference of the maps")
    person.wait_for_figure(picture_in(fused.output, "map_difference"))
    # But for the last, which names the folder.
    for line in fused.lines()[:-1]:
        expect(person.text(line.replace("+-", "±"))).to_be_visible()

    person.page.get_by_label("Voxel (m)", exact=True).fill(str(VOXEL_M))
    person.press("Export clouds (PLY, PCD)")
    folder = Path(person.page.locator("textarea[readonly]").first.input_value())
    assert folder.resolve().parent == output_root.resolve()
    pattern = rf"lidar ([\d,]+) points, depth ([\d,]+) points, in {re.escape(str(folder))}/clouds\."
    lidar, depth = person.read("Clouds: lidar", pattern)
    clouds = clouds_in(folder / "clouds")
    assert {name: len(points_m) for name, points_m in clouds.items()} == {
        f"{name}.{suffix}": int(count.replace(",", ""))
        for name, count in (("lidar", lidar), ("depth", depth))
        for suffix in ("ply", "pcd")
    }
    for name in ("lidar", "depth"):
        points_m = clouds[f"{name}.ply"]
        assert np.isfinite(points_m).all()
        assert np.allclose(points_m, clouds[f"{name}.pcd"], atol=1e-5)
        assert len(np.unique(np.floor(points_m / VOXEL_M), axis=0)) == len(points_m)
    # Heights count from the LiDAR's plane.
    assert np.abs(clouds["lidar.ply"][:, 2]).max() < 1e-9
    assert np.ptp(clouds["depth.ply"][:, 2]) > 1.0


def picture_in(folder: Path, name: str) -> np.ndarray:
    """(H, W, 3) RGB: a figure as the command writes it."""
    return decoded((folder / f"{name}.png").read_bytes())[..., ::-1]


def clouds_in(folder: Path) -> dict[str, np.ndarray]:
    """(N, 3) points by the name of their file."""
    return {
        path.name: np.asarray(o3d.io.read_point_cloud(path).points)
        for path in sorted(folder.iterdir())
        if path.suffix in (".ply", ".pcd")
    }


def begin_build(person: Person) -> None:
    # The scene's views have a button of that name, too.
    person.open_step("Map")
    person.page.get_by_label("Figures", exact=True).uncheck()
    person.press("Build")


def test_a_cancelled_build_leaves_nothing_and_a_reload_finds_the_same_state(
    person: Person, workbench: Workbench, output_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, cancelled = Event(), Event()

    def build_slowly(
        view: View, recording: Path, root: Path, progress: Progress, **how: Any
    ) -> Build:
        """The build, which waits at its fifth frame until it is cancelled."""

        def report(done: int, total: int | None, what: str) -> None:
            progress(done, total, what)
            if (what, done) == ("fusing", 5):
                begun.set()
                assert cancelled.wait(ENOUGH_S), "nobody cancelled"

        return build(view, recording, root, report, **how)

    monkeypatch.setattr("scanloom.panels.map.build", build_slowly)
    view = person.session.view.with_setting("noise", "epsilon", 1.5).changed(frame_index=11)
    person.look_at(view)
    before = sorted(output_root.rglob("*"))
    begin_build(person)
    count = len(person.frame_view.open_recording.frames)
    # What follows on another within a fifth of a second is not shown.
    expect(person.text(re.compile(rf"Fusing, [1-5] of {count}"))).to_be_visible()
    person.wait_until(begun.is_set)
    assert sorted(output_root.rglob("*")) != before
    expect(person.button("Build")).to_be_disabled()
    person.press("Cancel")
    expect(person.text("Stopping at the next step")).to_be_visible()
    cancelled.set()
    expect(person.text("Cancelled; nothing was saved.")).to_be_visible()
    expect(person.button("Build")).to_be_enabled()
    assert sorted(output_root.rglob("*")) == before

    person.reload(workbench)
    assert person.session.view == view.changed(panel="Map")
    expect(person.text(f"Frame 12 of {count}")).to_be_visible()
    expect(person.text("with noise.epsilon = 1.5")).to_be_visible()
    expect(person.button("Build")).to_be_enabled()
    assert sorted(output_root.rglob("*")) == before
