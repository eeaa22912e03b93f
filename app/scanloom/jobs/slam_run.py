"""A run of odometry and SLAM: ``build_map`` into a new folder, observed while it runs."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fusion_core.model.errors import ExportError, MappingFailed, ScanLoomError
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.model.slam_view import SlamObserver, SlamView
from fusion_core.model.visual_slam_view import VisualSlamObserver, VisualSlamView, unobserved
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.report import MapSummary
from fusion_core.workflows.map.result_folder import MapResults, read_map_results, read_maps
from fusion_core.workflows.map.settings import MAP_PRESETS, MapSettings, map_settings_toml
from fusion_core.workflows.map.visual_result_folder import (
    VisualResults,
    has_visual_results,
    read_visual_map,
    read_visual_results,
)
from scanloom.jobs.build import (
    base_preset,
    extrinsics_file,
    extrinsics_in,
    new_folder,
    results_in,
    settings_in,
    write_extrinsics_in,
)
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.view import View


@dataclass(frozen=True, kw_only=True, eq=False)
class SlamRun:
    """A finished run. ``folder`` holds its results, and its settings file if it has one.

    ``problem``: why the result is unreliable, else None. ``summary`` is None if the run failed
    after it had written its results. ``visual``: the keyframes and the cloud of visual SLAM, None
    of any other. ``grids``: every map that it wrote, by name. ``saved_as``: the folder that it was
    read back from, empty where this page has run it.
    """

    number: int
    view: View
    folder: Path
    options: MapOptions
    summary: MapSummary | None
    files: MapResults
    problem: ScanLoomError | None = None
    visual: VisualResults | None = None
    grids: Mapping[str, OccupancyGrid] = field(default_factory=dict)
    saved_as: str = ""

    @property
    def recording(self) -> str:
        """The recording's name in the library."""
        return self.view.recording

    @property
    def choices(self) -> SlamChoices:
        """The chosen inputs and estimator."""
        return self.view.slam

    @property
    def name(self) -> str:
        """The run's label in lists."""
        preset = "" if self.options.preset == "default" else f", {self.options.preset}"
        saved = f"from {self.saved_as}, " if self.saved_as else ""
        return f"{self.number}: {saved}{self.choices.label}{preset}"


def settings_of(view: View) -> MapSettings:
    """The settings of ``map`` for a view: those of its chain, and the number of particles."""
    base = MAP_PRESETS[base_preset(view)]
    particles = base.particles
    if view.slam.estimator == "particle-filter":
        particles = particles.model_copy(update={"particles": view.slam.particles})
    return base.model_copy(update=view.settings.stages() | {"particles": particles})


def map_options(
    view: View,
    settings_file: Path,
    clock_offset_ms: float = 0.0,
    given: GivenExtrinsics | None = None,
) -> MapOptions:
    """The options of ``map`` for a view; ``settings_file`` is used unless a preset suffices.
    ``given``: extrinsics, where a camera takes part; in their own file or in one beside the
    settings."""
    choices, preset = view.slam, base_preset(view)
    if choices.is_visual:
        # It has settings of its own, and takes the images as they are.
        return MapOptions(
            slam=choices.estimator,
            clock_offset_ms=clock_offset_ms,
            lidar_topic=view.lidar_topic,
            extrinsics_file=extrinsics_file(given, settings_file.parent),
        )
    options = MapOptions(
        scan=choices.scan,
        motion=choices.motion,
        slam=choices.estimator,
        fusion=choices.fusion,
        preset=preset,
        settings_file=None if settings_of(view) == MAP_PRESETS[preset] else settings_file,
        clock_offset_ms=clock_offset_ms,
        lidar_topic=view.lidar_topic,
    )
    if not options.needs_extrinsics:
        return options
    return replace(options, extrinsics_file=extrinsics_file(given, settings_file.parent))


def resampling_at(view: View) -> float:
    """The effective number of particles below which the particle filter resamples."""
    return settings_of(view).particles.resample_fraction * view.slam.particles


@dataclass(frozen=True, kw_only=True)
class SlamRequest:
    """What to run: the options of ``view`` on ``recording`` with ``given`` extrinsics.
    ``number``: unique in the session."""

    number: int
    view: View
    recording: Path
    clock_offset_ms: float = 0.0
    given: GivenExtrinsics | None = None


def run_slam(
    request: SlamRequest,
    root: Path,
    progress: Progress,
    observer: SlamObserver,
    visual_observer: VisualSlamObserver = unobserved,
) -> SlamRun:
    """Run what a view asks for, into a new folder below ``root``.

    A run that fails or is cancelled leaves no files. One whose scans do not fit the map is kept, to
    be inspected. An exception of ``progress`` also ends the run at the next call of ``observer``.
    Raises what ``build_map`` raises.
    """
    last: list[tuple[int, int | None, str]] = []

    def advance(done: int, total: int | None, what: str) -> None:
        last[:] = [(done, total, what)]
        progress(done, total, what)

    def check() -> None:
        # The last report again: it raises if the run was cancelled.
        for step in last:
            progress(*step)

    def observe(seen: SlamView) -> None:
        check()
        observer(seen)

    def observe_visual(seen: VisualSlamView) -> None:
        check()
        visual_observer(seen)

    with new_folder(root, Path(f"run-{request.number}")) as folder:
        settings_file = settings_in(folder)
        options = map_options(request.view, settings_file, request.clock_offset_ms, request.given)
        if options.extrinsics_file is not None:
            write_extrinsics_in(folder, request.given)
        if options.settings_file is not None:
            text = map_settings_toml(settings_of(request.view), options.preset)
            settings_file.write_text(text, encoding="utf-8")
        summary: MapSummary | None = None
        problem: ScanLoomError | None = None
        try:
            summary = build_map(
                request.recording,
                results_in(folder),
                options,
                advance,
                observe,
                observe_visual,
            )
        except MappingFailed as error:
            # Most of its scans do not fit, but the results were written.
            if not (results_in(folder) / "trajectory.tum").exists():
                raise
            problem = error
        progress(1, 1, "reading the results")
        files, visual, grids = read_results(results_in(folder))
    return SlamRun(
        number=request.number,
        view=request.view,
        folder=folder,
        options=options,
        summary=summary,
        files=files,
        problem=problem,
        visual=visual,
        grids=grids,
    )


def read_results(
    folder: Path,
) -> tuple[MapResults, VisualResults | None, Mapping[str, OccupancyGrid]]:
    """What a run wrote, with the keyframes of visual SLAM and every map by name. Raises ExportError
    or RecordingError where a file is not as it was written."""
    grids = read_maps(folder)
    if not has_visual_results(folder):
        return read_map_results(folder), None, grids
    visual = read_visual_results(folder)
    return read_visual_map(folder, visual), visual, grids


def keep(run: SlamRun, recording: Path, root: Path) -> Path:
    """Copy a run's results and settings into a new folder below ``root``, and return that.

    Raises ExportError where it cannot be written.
    """
    with new_folder(root, recording) as folder:
        try:
            shutil.copytree(results_in(run.folder), results_in(folder))
            for place in (settings_in, extrinsics_in):
                if place(run.folder).exists():
                    shutil.copy(place(run.folder), place(folder))
        except OSError as error:
            raise ExportError(
                f"cannot be written: {error.strerror or error}.",
                file=folder,
                advice="Free space, or start the workbench with another output folder.",
            ) from error
    return folder
