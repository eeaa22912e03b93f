"""What a run shows beside its trajectory: grids with the evidence of a cell, the octree as boxes,
and the list of earlier results."""

import threading
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser

from fusion_core.exporting.octomap_files import write_octree
from fusion_core.mapping.grid_misalignment import GridFusionSettings
from fusion_core.mapping.octree import OctreeBuilder, OctreeSettings
from fusion_core.model.errors import ExportError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map import grid_fusion
from fusion_core.workflows.map.grid_fusion import EVIDENCE_NAME
from fusion_core.workflows.map.octree_boxes import octree_boxes, read_run_octree
from scanloom.jobs.build import results_in
from scanloom.jobs.earlier_runs import earlier_folders, reopen
from scanloom.jobs.slam_run import read_results
from scanloom.panels.earlier_runs import EarlierRunsChoice
from scanloom.panels.grid_layers import GridLayers
from scanloom.panels.octree_layer import OCTREE, OctreeLayer, boxes_text
from scanloom.scene.visual_shapes import Boxes
from scanloom.state.view import View
from tests.app import slam_runs
from tests.app.slam_runs import MapOptions, room
from tests.patience import ENOUGH_S


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


class Session(SimpleNamespace):
    """As much of a session as the layers need."""

    def __init__(self) -> None:
        super().__init__(failures=[], refreshed=0)

    def refresh(self) -> None:
        self.refreshed += 1

    def show_failure(self, error: Exception) -> None:
        self.failures.append(error)

    def batch_updates(self) -> Any:
        return nullcontext()


def run_in(folder: Path, **grids: OccupancyGrid) -> Any:
    """A run with these grids, as far as the layers look at it."""
    files = SimpleNamespace(grid=next(iter(grids.values()), None), report={})
    return SimpleNamespace(folder=folder, grids=grids, files=files)


def fused_run_in(folder: Path, monkeypatch: pytest.MonkeyPatch, **log_odds: float) -> Any:
    """A run that fused grids of these values."""
    results = results_in(folder)
    results.mkdir()
    for figure in ("write_fusion_figure", "write_misalignment_figure"):
        monkeypatch.setattr(grid_fusion, figure, lambda *_: None)
    grids = {name: cells(value) for name, value in log_odds.items()}
    fused = grid_fusion.fuse_named_grids(grids, "table", GridFusionSettings())
    grid_fusion.write_fusion(results, fused, "a room")
    return run_in(folder, **grids, fused=fused.result)


def cells(log_odds: float) -> OccupancyGrid:
    """2 by 2 of one value, at the origin."""
    return OccupancyGrid(resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.full((2, 2), log_odds))


def choose(handle: Any, value: object) -> None:
    """As a person does."""
    handle.value = value
    event = SimpleNamespace(client=SimpleNamespace(), target=handle)
    for callback in handle._impl.update_cb:
        callback(event)


def test_the_fused_grid_comes_first_and_another_may_be_chosen(
    server: viser.ViserServer, tmp_path: Path
) -> None:
    session = Session()
    layers = GridLayers(server.gui, session)  # type: ignore[arg-type]  # as much as it needs
    lidar, camera, fused = room(), room(), room()
    run = run_in(tmp_path, lidar=lidar, camera=camera, fused=fused)
    layers.show(run)
    assert layers._choice.options == ("none", "LiDAR", "camera", "fused")
    assert layers.grid_of(run) is fused
    choose(layers._choice, "LiDAR")
    assert session.refreshed == 1
    assert layers.grid_of(run) is lidar
    choose(layers._choice, "none")
    assert layers.grid_of(run) is None
    # Of another run its own is shown.
    alone = run_in(tmp_path, merged=camera)
    layers.show(alone)
    assert layers.grid_of(alone) is camera
    layers.show(None)
    assert not layers._folder.visible


def test_a_cell_tells_its_states_or_its_evidence(
    server: viser.ViserServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session()
    layers = GridLayers(server.gui, session)  # type: ignore[arg-type]  # as much as it needs
    run = run_in(tmp_path, lidar=room(), camera=room())
    layers.show(run)
    assert "Click the map" in layers._cell.content
    layers.tell(np.array([0.0, 0.0]))
    assert "free" in layers._cell.content
    assert "log odds" not in layers._cell.content
    layers.show(fused_run_in(tmp_path, monkeypatch, lidar=-1.0, camera=2.5))
    layers.tell(np.array([0.02, 0.02]))
    for words in ("LiDAR", "camera", "-1.00", "+2.50", "+1.50", "by Table 3", "by (10)"):
        assert words in layers._cell.content, words
    layers.tell(np.array([9.0, 9.0]))
    assert "occupied" not in layers._cell.content
    assert not session.failures


def test_the_cells_where_the_rules_differ_are_gone_through(
    server: viser.ViserServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outlined: list[list[float]] = []
    layers = GridLayers(
        server.gui,
        Session(),  # type: ignore[arg-type]  # as much as it needs
        lambda place_m: outlined.append(np.round(place_m, 3).tolist()),
    )
    # By Table 3 the obstacle stays, by (10) the cell is free.
    run = fused_run_in(tmp_path, monkeypatch, lidar=-3.0, camera=2.0)
    layers.show(run)
    middles_m = [[0.025, 0.025], [0.075, 0.025], [0.025, 0.075], [0.075, 0.075]]
    assert np.round(layers.differing_m(run), 3).tolist() == middles_m
    assert "4 cells are another by Table 3" in layers._differing.content
    for _ in range(5):
        layers._go_on.value = True
        assert "The rules differ" in layers._cell.content
    assert outlined == [*middles_m, middles_m[0]]
    alone = run_in(tmp_path / "alone", lidar=room())
    layers.show(alone)
    assert not len(layers.differing_m(alone))
    assert not layers._go_on.visible


def test_rules_that_agree_offer_no_cell(
    server: viser.ViserServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layers = GridLayers(server.gui, Session())  # type: ignore[arg-type]  # as much as it needs
    layers.show(fused_run_in(tmp_path, monkeypatch, lidar=-1.0, camera=2.5))
    assert not layers._differing.visible
    assert not layers._go_on.visible


def test_spoilt_evidence_is_reported(server: viser.ViserServer, tmp_path: Path) -> None:
    session = Session()
    layers = GridLayers(server.gui, session)  # type: ignore[arg-type]  # as much as it needs
    results_in(tmp_path).mkdir()
    (results_in(tmp_path) / EVIDENCE_NAME).write_bytes(b"no archive")
    layers.show(run_in(tmp_path, lidar=room()))
    layers.tell(np.array([0.0, 0.0]))
    assert len(session.failures) == 1


def wall() -> OctreeBuilder:
    """A wall of 1 m by 1 m, seen from 2 m."""
    builder = OctreeBuilder(OctreeSettings(resolution_m=0.1))
    across, up = np.meshgrid(np.arange(0.05, 1.0, 0.1), np.arange(0.05, 1.0, 0.1))
    points_m = np.column_stack([np.full(across.size, 2.05), across.ravel(), up.ravel()])
    builder.add(points_m, np.zeros(3))
    return builder


class Stage(SimpleNamespace):
    """Takes boxes."""

    def __init__(self) -> None:
        super().__init__(boxes=[])
        self.drawn = threading.Event()

    def draw_boxes(self, boxes: Boxes | None) -> None:
        self.boxes.append(boxes)
        if boxes is not None:
            self.drawn.set()


def test_an_octree_is_drawn_as_boxes_at_a_depth(server: viser.ViserServer, tmp_path: Path) -> None:
    session, stage = Session(), Stage()
    layer = OctreeLayer(server.gui, session, stage)  # type: ignore[arg-type]  # as much as it needs
    run = run_in(tmp_path)
    layer.show(run)
    assert not layer._kind.visible
    results_in(tmp_path).mkdir()
    write_octree(results_in(tmp_path) / "octree.ot", wall().build())
    other = run_in(tmp_path)
    layer.show(other)
    assert layer._kind.visible
    assert not layer._depth.visible
    choose(layer._kind, OCTREE)
    assert stage.drawn.wait(ENOUGH_S)
    assert layer._depth.visible
    (finest,) = [boxes for boxes in stage.boxes if boxes is not None]
    octree = read_run_octree(results_in(tmp_path))
    assert octree is not None
    np.testing.assert_array_equal(finest.middles_m, octree_boxes(octree, 16).centres_in_map_m)
    # The wall is there, and each box on it.
    np.testing.assert_allclose(finest.middles_m[:, 0], 2.05, atol=1e-5)
    assert len(finest.middles_m) == 100
    stage.drawn.clear()
    choose(layer._depth, 15)
    assert stage.drawn.wait(ENOUGH_S)
    coarser = stage.boxes[-1]
    np.testing.assert_allclose(coarser.sizes_m, 0.2, atol=1e-6)
    assert len(coarser.middles_m) < 100
    layer.close()


def test_what_is_said_of_boxes() -> None:
    octree = wall().build()
    assert boxes_text(octree_boxes(octree, 16), 16) == "100 boxes of 0.1 m."
    cut = boxes_text(octree_boxes(octree, 16, boxes_max=40), 16)
    assert "Depth 16 has too many to be drawn: it is cut at depth" in cut


def test_earlier_results_are_listed_and_opened(tmp_path: Path) -> None:
    recording = Path("a room.mcap")
    root, into = tmp_path / "out", tmp_path / "page"
    assert earlier_folders(root, recording) == []
    options = MapOptions(slam="pose-graph")
    saved = root / "a_room.mcap-2"
    for folder in (saved / "results", root / "a_room.mcap", root / "a_room.mcapx"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        slam_runs.write_results(folder, options)
    (root / "a_room.mcap-3").mkdir()
    (root / "a_room.mcap-4").write_text("no folder")
    found = earlier_folders(root, recording)
    assert set(found) == {saved, root / "a_room.mcap"}
    view = View(recording=recording.name)
    run = reopen(saved, into, 7, view)
    assert run.name == "7: from a_room.mcap-2, lidar, recorded, pose-graph"
    assert set(run.grids) == {"lidar"}
    assert run.folder == into / "run-7"
    assert run.files.report == read_results(saved / "results")[0].report
    # The page deletes its copy alone.
    assert run.folder not in saved.parents


@pytest.mark.parametrize(
    "spoil",
    [
        lambda results: (results / "trajectory.tum").unlink(),
        lambda results: (results / "report.json").write_text('{"slam": "magic", "scan": 3}'),
        lambda results: (results / "report.json").write_text("["),
    ],
    ids=["no trajectory", "unknown choices", "no report"],
)
def test_results_that_cannot_be_read_leave_nothing(tmp_path: Path, spoil: Any) -> None:
    folder = tmp_path / "room"
    folder.mkdir()
    slam_runs.write_results(folder / "results", MapOptions())
    spoil(folder / "results")
    with pytest.raises(ExportError, match=r"cannot be read back|holds no results"):
        reopen(folder, tmp_path / "page", 1, View(recording="room.mcap"))
    assert not (tmp_path / "page" / "run-1").exists()


def test_a_hostile_folder_is_a_name_in_the_list(server: viser.ViserServer) -> None:
    opened: list[Path] = []
    choice = EarlierRunsChoice(server.gui, opened.append)
    hostile = Path("/out/room\u202e<b>\n")
    choice.offer([hostile], is_at_work=False)
    (_, name) = choice._choice.options
    assert name == "room\\u202e<b>\\n"
    choose(choice._choice, name)
    assert opened == [hostile]
    choose(choice._choice, "elsewhere")
    assert opened == [hostile]
    choice.offer([], is_at_work=False)
    assert not choice._choice.visible
