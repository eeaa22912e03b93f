"""Extrinsics that a person gives: from a file, or set by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import rigid_fault


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPose:
    """A camera's given pose. ``T_camera_lidar``: (4, 4), to the optical frame of its stored images.
    ``covariance``: (6, 6) of POSE_PARAMETERS, NaN in the row and column of what is not observable;
    None where nothing is known of it."""

    T_camera_lidar: FloatArray
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        if fault := rigid_fault(self.T_camera_lidar):
            raise ValueError(f"T_camera_lidar is no rigid transform: {fault}")
        read_only(self.T_camera_lidar)
        if self.covariance is not None:
            if self.covariance.shape != (6, 6):
                raise ValueError(f"covariance must be (6, 6), got {self.covariance.shape}")
            read_only(self.covariance)


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenExtrinsics:
    """Where a person says that the LiDAR is, by the topic of each depth camera; None is the key of
    the only camera. ``source``: for people, such as the name of the file. ``file``: that file."""

    source: str
    cameras: Mapping[str | None, CameraPose] = field(repr=False)
    file: Path | None = None

    def of_topics(self, topics: Sequence[str]) -> dict[str, CameraPose]:
        """The poses of those of a recording's depth topics that have one, in the topics' order.

        Raises SettingsError where none has one, and for one pose without topic for several cameras.
        """
        if None in self.cameras:
            if len(topics) != 1:
                raise SettingsError(
                    f"holds one transform for {len(topics)} depth cameras.",
                    file=self.file,
                    advice=f'Name one with --depth, or write a table cameras."{topics[0]}".',
                )
            return {topics[0]: self.cameras[None]}
        known = {topic: self.cameras[topic] for topic in topics if topic in self.cameras}
        if not known:
            raise SettingsError(
                f"names none of the depth topics {', '.join(topics)}.",
                file=self.file,
                advice="Write a table with one of these names, or a transform without a topic.",
            )
        return known
