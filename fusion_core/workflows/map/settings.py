"""The settings of ``scanloom map``, and its two presets.

``default`` works best; ``published`` is Li 2022 as far as its text specifies it: clouds by stride
and cropped scans (§2.2), each scan matched with the one before and odometry fused by (6) to (9) as
printed (§3), GMapping as Grisetti 2007 prints it, and, where the mount must be found or scans
repaired, Xu 2024's chain as published. Its pose graph is Cartographer's (Fu 2024): the map is not
refined with the poses. Its grids have the increments of OctoMap and are fused as they are drawn (Fu
2024, Table 3).
"""

from pathlib import Path

from fusion_core.exporting.settings_file import dump_toml
from fusion_core.mapping import grid, virtual_scan
from fusion_core.mapping.grid_misalignment import GridFusionSettings
from fusion_core.mapping.virtual_scan import VirtualScanSettings
from fusion_core.motion import laser
from fusion_core.motion.fusion import FusionSettings
from fusion_core.slam import particle_filter
from fusion_core.slam.joint_refinement import RefinementSettings
from fusion_core.slam.particle_filter import ParticleSettings
from fusion_core.slam.pose_graph_slam import SlamSettings
from fusion_core.slam.surface_adjustment import SurfaceAdjustmentSettings
from fusion_core.workflows.fuse.settings import (
    PRESETS,
    ChainSettings,
    PresetName,
    preset_with_file,
    with_seed,
)
from fusion_core.workflows.map.motion_prior import MotionSettings


class MapSettings(SlamSettings, MotionSettings, ChainSettings):
    """Every stage's settings: of the chain that finds the mount, of motion and of SLAM."""

    virtual_scan: VirtualScanSettings = VirtualScanSettings()
    particles: ParticleSettings = ParticleSettings()
    grid_fusion: GridFusionSettings = GridFusionSettings()


MAP_PRESETS: dict[PresetName, MapSettings] = {
    "default": MapSettings(),
    "published": MapSettings(
        **(dict(PRESETS["published"]) | {"grid": grid.OCTOMAP}),
        virtual_scan=virtual_scan.PUBLISHED,
        laser=laser.PUBLISHED,
        fusion=FusionSettings(method="published"),
        particles=particle_filter.PUBLISHED,
        refinement=RefinementSettings(rounds=0),
        surface_adjustment=SurfaceAdjustmentSettings(rounds=0),
    ),
}


def map_settings(
    preset: PresetName, settings_file: Path | None, seed: int | None = None
) -> tuple[PresetName, MapSettings]:
    """The preset with a file's values over it and, where given, the particles' seed over both.

    A file that names a preset decides on it. Raises SettingsError for what the file has wrong.
    """
    preset, settings = preset_with_file(preset, MAP_PRESETS, settings_file)
    if seed is None:
        return preset, settings
    seeded = with_seed(settings.particles, seed)
    return preset, settings.model_copy(update={"particles": seeded})


def map_settings_toml(settings: MapSettings, preset: PresetName = "default") -> str:
    """The settings file that repeats a run."""
    return dump_toml(settings.stages(), preset)
