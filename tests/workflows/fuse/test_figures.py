"""The figures of a run: which frame is shown, Table 1, and what is left out with a reason."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from fusion_core.alignment.search import Peak
from fusion_core.exporting.figures import format_stamp
from fusion_core.model.progress import Progress
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.scenes import SceneSettings, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse import figures, fuse
from fusion_core.workflows.fuse import session as sessions
from fusion_core.workflows.fuse.figure_collector import FigureCollector
from fusion_core.workflows.fuse.figures import (
    printable,
    write_figures,
)
from fusion_core.workflows.fuse.frame_result import rank_of
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.fuse.table_1 import score_range, table_1_row, write_table_1

PICTURES = {
    f"fig{number}_{name}.png"
    for number, name in (
        (3, "aligned"),
        (4, "similarity"),
        (4, "similarity_cosine"),
        (5, "pairs"),
        (6, "recall"),
        (7, "repair"),
        (8, "fused_depth"),
        (9, "maps"),
    )
}


def peak(score: float, overlap: float = 1.0) -> Peak:
    return Peak(
        u=1.0, v=1.0, score=score, ratio=1.1, overlap=overlap, runner_up_u=8.0, runner_up_v=1.0
    )


@pytest.mark.parametrize(
    ("found", "column"),
    [
        (None, "missing"),
        (peak(-0.2), "not_positive"),
        (peak(0.0), "not_positive"),
        (peak(1e-6), "low"),
        (peak(0.3), "low"),
        (peak(0.30001), "middle"),
        (peak(0.6), "middle"),
        (peak(0.60001), "high"),
        (peak(1.0), "high"),
    ],
)
def test_table_1_has_the_papers_half_open_ranges(found: Peak | None, column: str) -> None:
    assert score_range(found) == column


def frame(
    repaired: int, *, overlap: float | None = 0.9, registered: bool = True, alone: float = 0.7
) -> Any:
    """What the rank of a frame is made of: ``repaired`` samples, half of them of each sensor."""
    source = np.zeros(40, dtype=np.int64)
    source[: repaired // 2] = 1
    other = np.full(40, 3)
    other[: repaired - repaired // 2] = 2
    return SimpleNamespace(
        match=SimpleNamespace(
            search=SimpleNamespace(
                peaks={} if overlap is None else {"euclidean": peak(0.8, overlap)},
                peaks_without_prior={"pearson": peak(alone)},
            ),
            registration=object() if registered else None,
        ),
        repair=SimpleNamespace(lidar_source=source, depth_source=other),
    )


def showcase_of(*frames: Any) -> Any:
    """The one that is shown of frames that are a task each."""
    alignment: Any = SimpleNamespace(metric="euclidean")
    collector = FigureCollector()
    for shown in frames:
        shown.match.pair = SimpleNamespace(camera_index=0)
        result = SimpleNamespace(rank=rank_of(shown, alignment), camera=0, score_range=None)
        entry: Any = SimpleNamespace(task=shown, results=(result,))
        collector.add(entry)
    return collector.showcase(lambda task: [task])  # type: ignore[list-item]  # a stand-in


def test_the_showcase_has_most_repaired_samples_and_ties_go_to_the_earliest() -> None:
    frames = [frame(3), frame(7), frame(7), frame(5)]
    assert showcase_of(*frames) is frames[1]


@pytest.mark.parametrize(
    "unsound",
    [frame(30, overlap=0.49), frame(30, overlap=None), frame(30, registered=False)],
    ids=["overlap", "no peak", "no registration"],
)
def test_an_unsound_frame_is_shown_only_where_no_other_is(unsound: Any) -> None:
    sound = frame(0, overlap=0.5)
    assert showcase_of(unsound, sound) is sound
    assert showcase_of(sound, unsound) is sound
    assert showcase_of(unsound) is unsound


def test_no_frame_is_shown_where_there_is_none() -> None:
    assert showcase_of() is None


def test_table_1_counts_an_image_once_and_a_panorama_once() -> None:
    collector = FigureCollector()
    for columns in (("low",), ("high", None, None), ("high",), ("missing",)):
        results = tuple(
            SimpleNamespace(rank=(False, 0), camera=camera, score_range=column)
            for camera, column in enumerate(columns)
        )
        entry: Any = SimpleNamespace(task=None, results=results)
        collector.add(entry)
    assert collector.scores == {"low": 1, "middle": 0, "high": 2, "not_positive": 0, "missing": 1}


def test_names_are_written_in_the_letters_of_the_font() -> None:
    assert printable("Küche_1") == "Küche_1"
    assert printable("客厅 1") == "?? 1"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A short recording, fused, with what write_figures was called with."""
    called: dict[str, Any] = {}

    drawn: list[tuple[int, int | None]] = []

    def write_and_remember(
        folder: Path, data: figures.FigureData, pool: WorkerPool, progress: Progress
    ) -> list[str]:
        called.update(data=data)
        return write_figures(folder, data, pool, progress)

    def count(done: int, total: int | None, what: str) -> None:
        if what == "drawing figures":
            drawn.append((done, total))

    folder = tmp_path_factory.mktemp("figures")
    recording = folder / "room.mcap"
    settings = SceneSettings(seed=173, duration_s=2.0, camera_rate_hz=10.0, image_scale=0.5)
    write_scene("furnished_room", recording, settings=settings)
    truth = truth_path(recording)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fuse, "write_figures", write_and_remember)
        summary = fuse.fuse(recording, folder / "fused", sessions.FuseOptions(truth=truth), count)
    return SimpleNamespace(
        recording=recording,
        truth=truth,
        output=folder / "fused",
        summary=summary,
        drawn=drawn,
        **called,
    )


@pytest.mark.slow
def test_figures_are_counted_as_they_are_drawn(run: SimpleNamespace) -> None:
    pictures = list((run.output / "figures").glob("*.png"))
    assert run.drawn == [(number, len(pictures)) for number in range(1, len(pictures) + 1)]


def test_drawing_ends_where_progress_raises(run: SimpleNamespace, tmp_path: Path) -> None:
    def cancel(done: int, total: int | None, what: str) -> None:
        if done == 2:
            raise InterruptedError

    with opened(run) as session:
        data = replace(run.data, session=session)
        with pytest.raises(InterruptedError):
            write_figures(tmp_path / "figures", data, WorkerPool(1), cancel)
    written = {path.name for path in (tmp_path / "figures").glob("*.png")}
    assert written == {"fig4_similarity.png"}


@contextmanager
def opened(
    run: SimpleNamespace, options: sessions.FuseOptions | None = None
) -> Iterator[sessions.Session]:
    with open_recording(run.recording) as recording:
        yield sessions.open_session(recording, options or sessions.FuseOptions(), ChainSettings())


def test_every_figure_is_written_and_listed(run: SimpleNamespace) -> None:
    written = {path.name for path in (run.output / "figures").iterdir()}
    assert written == PICTURES | {"fig6_recall.csv", "table1.csv"}
    manifest = (run.output / "manifest.json").read_text(encoding="utf-8")
    assert all(f"figures/{name}" in manifest for name in written)


def test_maps_stand_beside_the_map_of_the_true_ranges(run: SimpleNamespace) -> None:
    assert set(run.data.grids) == {"lidar", "camera", "fused", "reference"}
    assert not (run.output / "map_reference.yaml").exists()


def test_no_picture_is_large(run: SimpleNamespace) -> None:
    sizes = {path.name: path.stat().st_size for path in (run.output / "figures").iterdir()}
    assert max(sizes.values()) < 330 * 1024, sizes


def test_nothing_is_cut_at_the_edge_of_a_sheet(run: SimpleNamespace) -> None:
    for name in PICTURES:
        picture = cv2.imread(str(run.output / "figures" / name))
        assert picture is not None
        edge = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
        assert (edge == 255).all(), name


def test_table_1_counts_every_paired_frame_once(run: SimpleNamespace) -> None:
    with (run.output / "figures" / "table1.csv").open(encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert row["room"] == "room.mcap"
    counts = {name: int(row[name]) for name in ("low", "middle", "high", "not_positive", "missing")}
    assert sum(counts.values()) == run.summary.paired
    scored = counts["low"] + counts["middle"] + counts["high"]
    assert float(row["high_percent"]) == pytest.approx(100 * counts["high"] / scored, abs=0.005)


def test_table_1_leaves_the_share_open_where_nothing_is_scored(tmp_path: Path) -> None:
    scores = {"low": 0, "middle": 0, "high": 0, "not_positive": 2, "missing": 1}
    write_table_1(tmp_path / "t.csv", [table_1_row("room", scores)])
    assert (tmp_path / "t.csv").read_text().splitlines()[1] == "room,0,0,0,,2,1"


def test_the_recall_table_is_what_evaluate_measures(run: SimpleNamespace) -> None:
    over = evaluate.noise(run.output, run.truth)["over_epsilon"]
    with (run.output / "figures" / "fig6_recall.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for name in ("epsilon_over_E", "xi", "eta"):
        assert [float(row[name]) for row in rows] == over[name]


@pytest.mark.slow
def test_a_truth_without_a_mount_leaves_out_only_its_figure(
    run: SimpleNamespace, tmp_path: Path
) -> None:
    with np.load(run.truth) as arrays:
        without_mount = {name: arrays[name] for name in arrays.files if name != "T_lidar_camera"}
    truth = tmp_path / "truth.npz"
    np.savez(truth, **without_mount)
    with opened(run) as session:
        data = replace(
            run.data,
            session=session,
            showcase=None,
            grids={},
            fuse_dir=run.output,
            truth=truth,
        )
        notes = write_figures(tmp_path / "figures", data, WorkerPool(1))
    assert [note.split(":")[0] for note in notes] == ["No frame to show", "Fig. 6 is left out"]
    assert "no mount" in notes[1]
    assert str(tmp_path) not in notes[1]
    written = {path.name for path in (tmp_path / "figures").iterdir()}
    assert written == {"fig4_similarity.png", "fig4_similarity_cosine.png", "table1.csv"}


def test_the_headings_say_preset_frame_and_virtual_lidar(
    run: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    headings = []

    def note_heading(path: Path, heading: str, *args: Any, **named: Any) -> None:
        headings.append(heading)

    for name in (
        "write_aligned",
        "write_similarity",
        "write_pairs",
        "write_repair",
        "write_fused_depth",
        "write_maps",
    ):
        monkeypatch.setattr(figures, name, note_heading)
    with opened(run, sessions.FuseOptions(virtual_lidar_row=60)) as session:
        data = replace(run.data, session=session, preset="published", truth=None)
        write_figures(tmp_path / "figures", data, WorkerPool(1))
    assert len(headings) == 7
    for heading in headings:
        assert "room.mcap, preset published, virtual LiDAR, row 60" in heading
    assert (
        sum(format_stamp(run.data.showcase.match.stamp_ns) in heading for heading in headings) == 6
    )
