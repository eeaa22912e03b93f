"""The options of ``scanloom map``."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fusion_core.model.errors import MissingStream, SettingsError
from fusion_core.model.labels import LabelLayer
from fusion_core.workflows.fuse.settings import PresetName
from fusion_core.workflows.map.estimators import SlamKind
from fusion_core.workflows.map.motion_prior import MotionKind
from fusion_core.workflows.map.scan_source import ScanKind
from fusion_core.workflows.source import RoomChoice

FusionKind = Literal["none", "table", "bayes"]
MapSlamKind = SlamKind | Literal["visual"]
"""The estimators that place scans, and visual SLAM, which places images."""


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """The choices of a run.

    ``scan``: which scans are mapped. ``motion``: the odometry that predicts them, or that places
    them where there is no SLAM. ``slam``: the estimator. ``fusion``: how the LiDAR's own grid and
    the camera's own are fused cell by cell, "none" for not at all. ``seed``: of the particle
    filter; it overrides the settings'. ``clock_offset_ms``: camera stamp - LiDAR stamp of one
    instant, which is subtracted from the camera's stamps. ``labels``: a person's, which
    overrule the classes of the repair. ``workers``: processes that share in the repair, None for
    one a core; the results are the same for each number.
    """

    scan: ScanKind = "lidar"
    motion: MotionKind = "recorded"
    slam: MapSlamKind = "pose-graph"
    fusion: FusionKind = "none"
    preset: PresetName = "default"
    settings_file: Path | None = None
    seed: int | None = None
    extrinsics_file: Path | None = None
    clock_offset_ms: float = 0.0
    room: RoomChoice | None = None
    lidar_topic: str | None = None
    pose_topic: str | None = None
    labels: LabelLayer | None = None
    workers: int | None = 1
    force: bool = False
    overwrite: bool = False

    @property
    def choices(self) -> dict[str, str]:
        """The choices that report.json states, by name."""
        if self.is_visual:
            # The camera is all that is mapped; its motion is a part of the SLAM.
            return {
                "scan": "camera",
                "motion": "none",
                "slam": self.slam,
                "fusion": self.fusion,
            }
        return {
            "scan": self.scan,
            "motion": self.motion,
            "slam": self.slam,
            "fusion": self.fusion,
        }

    @property
    def is_visual(self) -> bool:
        """Whether the images are mapped, and no scans."""
        return self.slam == "visual"

    @property
    def has_virtual_scans(self) -> bool:
        """Whether the scans are cut from depth images."""
        return self.scan in ("camera", "merged")

    @property
    def shown_map(self) -> str:
        """The map that is the result, by its name."""
        return shown_map(self.choices)

    @property
    def draws_camera(self) -> bool:
        """Whether scans of the depth images go into a map."""
        return self.has_virtual_scans or self.fusion != "none"

    @property
    def needs_extrinsics(self) -> bool:
        """Whether the cameras' extrinsics are used."""
        uses_images = self.draws_camera or self.motion in ("visual", "visual-slam", "fused")
        return uses_images or self.scan == "repaired"

    def identity(self) -> str:
        """The options that determine the results, besides settings and input files, as JSON."""
        identity: dict[str, str | None] = {
            **self.choices,
            "lidar": self.lidar_topic,
            "pose": self.pose_topic,
            "clock_offset_ms": repr(self.clock_offset_ms),
        }
        if self.room is not None:
            identity["room"] = str(self.room)
        return json.dumps(identity)

    def require_consistent(self, recording: Path) -> None:
        """Raise MissingStream without any source of poses, SettingsError for unused extrinsics or
        labels, and for what visual SLAM has no use for."""
        if self.is_visual:
            self._require_visual()
            return
        if self.slam == "none" and self.motion == "none":
            raise MissingStream(
                "without SLAM and without motion there are no poses.",
                file=recording,
                advice="Choose a --slam, or a --motion.",
            )
        if self.fusion != "none" and self.scan == "repaired":
            raise SettingsError(
                f"--fusion {self.fusion} takes two independent grids, and repaired scans hold the "
                "camera's ranges: they would count twice.",
                advice="Use --scan lidar or merged, or --fusion none.",
            )
        if self.labels is not None and self.scan != "repaired":
            raise SettingsError(
                f"--scan {self.scan} takes no labels: they overrule the classes of the repair.",
                advice="Leave --labels out, or use --scan repaired.",
            )
        if self.extrinsics_file is not None and not self.needs_extrinsics:
            raise SettingsError(
                f"--scan {self.scan} with --motion {self.motion} takes no extrinsics.",
                file=self.extrinsics_file,
                advice="Leave --extrinsics out, or use --scan merged, camera or repaired, "
                "--motion visual or --fusion table.",
            )

    def _require_visual(self) -> None:
        defaults = MapOptions()
        for name, is_given in (
            (f"--scan {self.scan}", self.scan != defaults.scan),
            (f"--motion {self.motion}", self.motion != defaults.motion),
            (f"--preset {self.preset}", self.preset != defaults.preset),
            ("--seed", self.seed is not None),
            ("--labels", self.labels is not None),
            ("--pose", self.pose_topic is not None),
        ):
            if is_given:
                raise SettingsError(
                    f"--slam visual takes no {name}: it maps the camera's images as they are.",
                    advice="Leave it out.",
                )


def shown_map(choices: Mapping[str, Any]) -> str:
    """The map that is the result of a run with these choices, by its name ("fused" for map_fused).

    Runs of versions without a fusion have no such choice.
    """
    return str(choices["scan"]) if choices.get("fusion", "none") == "none" else "fused"
