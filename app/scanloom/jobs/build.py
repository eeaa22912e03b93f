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
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.progress import Progress
from fusion_core.workflows.calibrate.given_file import write_given_extrinsics
from fusion_core.workflows.fuse.export_clouds import CloudExport, export_clouds
from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.fuse.settings import PRESETS, PresetName, settings_toml
from scanloom.state.view import View

# viser sends a file from memory, in one go.
MAX_DOWNLOAD_BYTES = 50_000_000

_RESULTS, _CLOUDS, _SETTINGS = "results", "clouds", "settings.toml"
_EXTRINSICS = "extrinsics.json"
# Well below the 255 bytes that file systems allow, with a suffix and multi-byte letters.
_MAX_NAME_CHARACTERS = 60
# Rather an error than an endless search.
_MAX_FOLDERS = 10_000
# Per-frame results, about as large as the recording.
_NOT_IN_DOWNLOAD = {"fused.mcap", "samples.parquet"}
# The earliest time that a .zip can hold.
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class Build:
    """A finished build. ``folder`` holds ``results``, ``clouds`` once exported, and a settings file
    if the settings are not those of a preset."""

    view: View
    recording: Path
    folder: Path
    options: FuseOptions
    summary: FuseSummary

    @property
    def results(self) -> Path:
        """The output folder of ``fuse``."""
        return results_in(self.folder)


def results_in(folder: Path) -> Path:
    """The folder of results in a build's folder."""
    return folder / _RESULTS


def extrinsics_in(folder: Path) -> Path:
    """The file of extrinsics in a build's folder, where a person has set them."""
    return folder / _EXTRINSICS


def extrinsics_file(given: GivenExtrinsics | None, folder: Path) -> Path | None:
    """The file of given extrinsics: their own, or one in a build's folder; None without any."""
    return None if given is None else given.file or extrinsics_in(folder)


def write_extrinsics_in(folder: Path, given: GivenExtrinsics | None) -> None:
    """Write extrinsics that have no file of their own. Raises ExportError."""
    if given is not None and given.file is None:
        write_given_extrinsics(extrinsics_in(folder), given)


def settings_in(folder: Path) -> Path:
    """The settings file in a build's folder."""
    return folder / _SETTINGS


def fuse_options(
    view: View,
    settings_file: Path,
    *,
    figures: bool = True,
    given: GivenExtrinsics | None = None,
) -> FuseOptions:
    """The options of ``fuse`` for a view; ``settings_file`` is used unless a preset suffices.
    ``given``: extrinsics, in their own file or in one beside the settings."""
    preset = base_preset(view)
    is_preset = view.settings == PRESETS[preset]
    return FuseOptions(
        preset=preset,
        settings_file=None if is_preset else settings_file,
        virtual_lidar_row=view.virtual_row,
        lidar_topic=view.lidar_topic,
        depth_topics=view.depth_topics,
        extrinsics_file=extrinsics_file(given, settings_file.parent),
        apply_clock_offset=view.apply_clock_offset,
        figures=figures,
    )


def base_preset(view: View) -> PresetName:
    """The preset that a view's settings file overrides.

    A settings file cannot change the pairing: if the view did, it is the preset of that pairing.
    """
    if PRESETS[view.preset].pairing == view.settings.pairing:
        return view.preset
    return next(name for name, preset in PRESETS.items() if preset.pairing == view.settings.pairing)


def folder_name(recording: str) -> str:
    """A safe folder name for the results of a recording: letters, digits, and ``-_.`` within.

    Whatever the recording is called, the result names a direct child of the output root.
    """
    letters = unicodedata.normalize("NFC", recording)
    plain = "".join(c if c.isalnum() or c in "-_." else "_" for c in letters)
    return plain[:_MAX_NAME_CHARACTERS].strip("._-") or "recording"


def free_folder(root: Path, recording: Path) -> Path:
    """The folder below ``root`` for the next build of a recording, not yet created.

    Raises ExportError if all numbers are taken.
    """
    name = folder_name(recording.stem if recording.is_file() else recording.name)
    for number in range(1, _MAX_FOLDERS):
        folder = root / (name if number == 1 else f"{name}-{number}")
        # A dangling symbolic link counts as taken.
        if not (folder.exists() or folder.is_symlink()):
            return folder
    raise ExportError("every number is taken.", file=root / name, advice="Remove old results.")


def build(
    view: View,
    recording: Path,
    root: Path,
    progress: Progress,
    *,
    figures: bool = True,
    given: GivenExtrinsics | None = None,
) -> Build:
    """Fuse a recording with the settings of a view and ``given`` extrinsics. A failed or cancelled
    build leaves no files.

    Raises ExportError for the folder, and what ``fuse`` raises.
    """
    with new_folder(root, recording) as folder:
        options = fuse_options(view, settings_in(folder), figures=figures, given=given)
        write_extrinsics_in(folder, given)
        if options.settings_file is not None:
            text = settings_toml(base_preset(view), view.settings)
            options.settings_file.write_text(text, encoding="utf-8")
        summary = fuse(recording, results_in(folder), options, progress)
        # The last figure is drawn after its report: check for cancellation once more.
        progress(1, 1, "done")
    return Build(view=view, recording=recording, folder=folder, options=options, summary=summary)


def export(built: Build, voxel_m: float, progress: Progress) -> CloudExport:
    """Export the point clouds of a build beside its results. Raises as ``export_clouds``."""
    return export_clouds(
        built.recording,
        built.results,
        built.folder / _CLOUDS,
        built.options,
        voxel_m=voxel_m,
        progress=progress,
    )


def zipped(built: Build) -> bytes:
    """A .zip of a build's results. Raises as ``zip_folder``."""
    return zip_folder(built.results, built.folder.name)


def zip_folder(results: Path, name: str) -> bytes:
    """A folder of results, without the per-frame files, as a reproducible .zip.

    ``name``: the folder within the .zip. Raises ExportError if the files exceed MAX_DOWNLOAD_BYTES
    or are missing.
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
    """Create a new folder below ``root``; it is removed if the block raises."""
    while True:
        folder = free_folder(root, recording)
        try:
            root.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
            break
        except FileExistsError:
            # Another session took this number meanwhile.
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
