"""A build: ``fuse`` over a whole recording into a new folder below the output root."""

import io
import shutil
import unicodedata
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import ExportError
from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.export_clouds import CloudExport, export_clouds
from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.fuse.settings import PRESETS, PresetName, settings_toml
from scanloom.state.view import View

MAX_DOWNLOAD_BYTES = 50_000_000

_RESULTS, _CLOUDS, _SETTINGS = "results", "clouds", "settings.toml"
_MOST_NAME_CHARACTERS = 60
_MOST_FOLDERS = 10_000
# Frame by frame, and so as large as the recording.
_NOT_IN_DOWNLOAD = {"fused.mcap", "samples.parquet"}
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class Build:
    """What was built: ``folder`` holds ``results``, ``clouds`` once they are asked for, and the
    settings file where no preset says it all."""

    view: View
    recording: Path
    folder: Path
    options: FuseOptions
    summary: FuseSummary

    @property
    def results(self) -> Path:
        """What ``fuse`` wrote."""
        return results_in(self.folder)


def results_in(folder: Path) -> Path:
    """Where in a build's folder the results of ``fuse`` are."""
    return folder / _RESULTS


def settings_in(folder: Path) -> Path:
    """Where in a build's folder the settings file is."""
    return folder / _SETTINGS


def fuse_options(view: View, settings_file: Path, *, figures: bool = True) -> FuseOptions:
    """What a view asks of ``fuse``. ``settings_file`` is named where no preset says it all."""
    preset = preset_below(view)
    is_preset = view.settings == PRESETS[preset]
    return FuseOptions(
        preset=preset,
        settings_file=None if is_preset else settings_file,
        virtual_lidar_row=view.virtual_row,
        lidar_topic=view.lidar_topic,
        depth_topics=view.depth_topics,
        apply_clock_offset=view.apply_clock_offset,
        figures=figures,
    )


def preset_below(view: View) -> PresetName:
    """The preset that a view's settings file starts from.

    A file says every setting but how frames are paired: where that was changed, it starts from the
    preset that pairs so.
    """
    if PRESETS[view.preset].pairing == view.settings.pairing:
        return view.preset
    return next(name for name, preset in PRESETS.items() if preset.pairing == view.settings.pairing)


def folder_name(recording: str) -> str:
    """A plain name for the results of a recording: letters, digits and, within, ``-_.``.

    Whatever the name of a recording is, that of its folder names a child of the output root.
    """
    letters = unicodedata.normalize("NFC", recording)
    plain = "".join(c if c.isalnum() or c in "-_." else "_" for c in letters)
    return plain[:_MOST_NAME_CHARACTERS].strip("._-") or "recording"


def free_folder(root: Path, recording: Path) -> Path:
    """The folder below ``root`` that the next build of a recording goes to; not made yet.

    Raises ExportError where every number is taken.
    """
    name = folder_name(recording.stem if recording.is_file() else recording.name)
    for number in range(1, _MOST_FOLDERS):
        folder = root / (name if number == 1 else f"{name}-{number}")
        # A link that leads nowhere is taken, too.
        if not (folder.exists() or folder.is_symlink()):
            return folder
    raise ExportError("every number is taken.", file=root / name, advice="Remove old results.")


def build(
    view: View, recording: Path, root: Path, progress: Progress, *, figures: bool = True
) -> Build:
    """Fuse a recording with the settings of a view. A build that fails or is cancelled leaves
    nothing behind.

    Raises ExportError for the folder, and what ``fuse`` raises.
    """
    with new_folder(root, recording) as folder:
        options = fuse_options(view, settings_in(folder), figures=figures)
        if options.settings_file is not None:
            text = settings_toml(preset_below(view), view.settings)
            options.settings_file.write_text(text, encoding="utf-8")
        summary = fuse(recording, results_in(folder), options, progress)
        # The last chance to be cancelled: while figures are drawn, nobody asks.
        progress(1, 1, "done")
    return Build(view=view, recording=recording, folder=folder, options=options, summary=summary)


def export(built: Build, voxel_m: float, progress: Progress) -> CloudExport:
    """Write the clouds of a build beside its results. Raises as ``export_clouds``."""
    return export_clouds(
        built.recording,
        built.results,
        built.folder / _CLOUDS,
        built.options,
        voxel_m=voxel_m,
        progress=progress,
    )


def zipped(built: Build) -> bytes:
    """The results of a build but for those of each frame. Raises as ``zip_of``."""
    return zip_of(built.results, built.folder.name)


def zip_of(results: Path, name: str) -> bytes:
    """A folder of results but for those of each frame, as a .zip of the same bytes each time; its
    files lie in a folder ``name``.

    Raises ExportError where they exceed MAX_DOWNLOAD_BYTES, or are not there any more.
    """
    packed = io.BytesIO()
    try:
        files = sorted(
            file
            for file in results.rglob("*")
            if file.is_file() and file.name not in _NOT_IN_DOWNLOAD
        )
        size = sum(file.stat().st_size for file in files)
        if size > MAX_DOWNLOAD_BYTES or not files:
            raise ExportError(
                f"holds {size / 1e6:.0f} MB to download; at most {MAX_DOWNLOAD_BYTES / 1e6:.0f} MB "
                "go through the browser.",
                file=results,
                advice="Copy the folder on the server.",
            )
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in files:
                entry_name = f"{name}/{file.relative_to(results).as_posix()}"
                entry = zipfile.ZipInfo(entry_name, _ZIP_EPOCH)
                archive.writestr(entry, file.read_bytes(), zipfile.ZIP_DEFLATED)
    except OSError as error:
        raise ExportError(f"cannot be read: {error.strerror}.", file=results) from error
    return packed.getvalue()


@contextmanager
def new_folder(root: Path, recording: Path) -> Iterator[Path]:
    """A folder of one's own below ``root``, removed when the block raises."""
    while True:
        folder = free_folder(root, recording)
        try:
            root.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
            break
        except FileExistsError:
            # Another browser was quicker, and has this number now.
            if not folder.is_dir():
                raise ExportError("is not a folder.", file=root) from None
        except OSError as error:
            raise ExportError(
                f"cannot be made: {error.strerror}.",
                file=folder,
                advice="Start the workbench with another output folder.",
            ) from error
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
