"""Results that earlier runs of a recording have left in the output folder, read back."""

import json
import shutil
from pathlib import Path

from pydantic import ValidationError

from fusion_core.model.errors import ExportError
from fusion_core.workflows.map.options import MapOptions
from scanloom.jobs.build import folder_name, results_in
from scanloom.jobs.slam_run import SlamRun, read_results
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.view import View

# More would be no list to choose from.
_MAX_LISTED = 50
_REPORT = "report.json"
_CHOICES = {"scan": "scan", "motion": "motion", "slam": "estimator", "fusion": "fusion"}


def earlier_folders(root: Path, recording: Path) -> list[Path]:
    """The folders below ``root`` in which runs of a recording of this name were saved, the latest
    first; the command line's, whose results lie in the folder itself, too."""
    name = folder_name(recording.stem if recording.is_file() else recording.name)
    try:
        beside = [
            folder
            for folder in root.iterdir()
            if _is_numbered(folder.name, name) and _results_of(folder) is not None
        ]
        beside.sort(key=lambda folder: (-folder.stat().st_mtime_ns, folder.name))
    except OSError:
        # There is no such folder yet.
        return []
    return beside[:_MAX_LISTED]


def reopen(folder: Path, into: Path, number: int, view: View) -> SlamRun:
    """A run as it was saved, copied to a new folder below ``into``, which the page may delete.

    Raises ExportError where it cannot be read.
    """
    results = _results_of(folder)
    if results is None:
        raise ExportError("holds no results of a map.", file=folder, advice="Choose another one.")
    copy = into / f"run-{number}"
    try:
        shutil.copytree(results, results_in(copy))
        files, visual, grids = read_results(results_in(copy))
        view = view.model_copy(update={"slam": _choices(files.report)})
        return SlamRun(
            number=number,
            view=view,
            folder=copy,
            options=MapOptions(
                slam=view.slam.estimator,
                scan=view.slam.scan,
                motion=view.slam.motion,
                fusion=view.slam.fusion,
            ),
            summary=None,
            files=files,
            visual=visual,
            grids=grids,
            saved_as=folder.name,
        )
    except (OSError, ValueError, KeyError, ExportError) as error:
        shutil.rmtree(copy, ignore_errors=True)
        if isinstance(error, ExportError):
            raise
        raise ExportError(
            f"cannot be read back: {type(error).__name__}: {error}.",
            file=folder,
            advice="Choose another one.",
        ) from error


def _choices(report: object) -> SlamChoices:
    """What a run was asked for. Raises ValueError where the report does not tell."""
    if not isinstance(report, dict):
        raise ValueError("its report is no table")
    told = {own: report[name] for name, own in _CHOICES.items() if name in report}
    try:
        return SlamChoices.model_validate(told)
    except ValidationError as error:
        raise ValueError("its report names choices that there are not") from error


def _is_numbered(folder: str, name: str) -> bool:
    """Whether a folder is called as one for results of that name, as ``free_folder`` does."""
    rest = folder.removeprefix(name)
    return folder.startswith(name) and (not rest or (rest[0] == "-" and rest[1:].isdecimal()))


def _results_of(folder: Path) -> Path | None:
    """Where in a saved folder the results of a map lie, None for none."""
    for results in (results_in(folder), folder):
        try:
            report = json.loads((results / _REPORT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(report, dict) and "slam" in report:
            return results
    return None
