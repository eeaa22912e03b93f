"""The estimate of visual SLAM while it runs, for display."""

from collections.abc import Callable
from dataclasses import dataclass

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisualSlamView:
    """A snapshot of a run.

    ``stage``: its label. ``stamps_ns``: (N,) of the images placed so far; ``T_map_camera``:
    (N, 4, 4) of the camera's optical frame, as estimated so far. ``keyframe_stamps_ns``: (K,);
    ``T_map_keyframe``: (K, 4, 4). ``loops``: (L, 2) keyframes (indices into K) that loop closing
    has joined. ``points_in_map_m``: (P, 3) a part of the cloud of the keyframes, with ``rgb``:
    (P, 3). ``is_lost``: whether tracking has lost the camera.
    """

    stage: str
    stamps_ns: IntArray
    T_map_camera: FloatArray
    keyframe_stamps_ns: IntArray
    T_map_keyframe: FloatArray
    loops: IntArray
    points_in_map_m: Float32Array
    rgb: ByteArray
    is_lost: bool = False

    def __post_init__(self) -> None:
        for array in (
            self.stamps_ns,
            self.T_map_camera,
            self.keyframe_stamps_ns,
            self.T_map_keyframe,
            self.loops,
            self.points_in_map_m,
            self.rgb,
        ):
            read_only(array)


VisualSlamObserver = Callable[[VisualSlamView], None]
"""Called at each keyframe, on the thread of the run; what it raises ends the run."""


def unobserved(view: VisualSlamView) -> None:
    """Observes nothing."""
