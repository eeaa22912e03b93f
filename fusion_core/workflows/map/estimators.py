"""The estimators of ``scanloom map``: each places the scans of a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.model.planar_poses import PosePrior, interpolate_pose
from fusion_core.model.progress import Progress
from fusion_core.model.slam_view import SlamObserver
from fusion_core.model.stamps import find_neighbours
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.slam.particle_filter_slam import ParticleResult, particle_filter_slam
from fusion_core.slam.pose_graph_slam import SlamResult, pose_graph_slam
from fusion_core.workflows.map.scan_source import ScanSource
from fusion_core.workflows.map.settings import MapSettings

SlamKind = Literal["none", "particle-filter", "pose-graph"]

# A robot's speed changes within a second: across a longer gap interpolation is unreliable.
_POSE_GAP_MAX_NS = NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedScans:
    """N scans with a pose.

    ``poses_map_scan``: (N, 3) x, y, yaw. ``trusted``: (N,) whether each pose is. ``graph``,
    ``particles``: the result of the estimator that was used. ``seconds``: wall-clock time of each
    stage. ``notes``: for people.
    """

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray
    seconds: Mapping[str, float]
    graph: SlamResult | None = None
    particles: ParticleResult | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.stamps_ns, self.poses_map_scan, self.trusted):
            read_only(array)

    def pose_at(self, stamp_ns: int) -> FloatArray | None:
        """(3,) the pose at an instant, interpolated; None outside and in gaps."""
        neighbours = find_neighbours(self.stamps_ns, stamp_ns)
        if neighbours is None or neighbours.gap_ns > _POSE_GAP_MAX_NS:
            return None
        before, after, _, fraction = neighbours
        if before == after:
            exact: FloatArray = self.poses_map_scan[after]
            return exact
        return interpolate_pose(self.poses_map_scan[before], self.poses_map_scan[after], fraction)


def place_scans(
    scans: ScanSource,
    prior: PosePrior | None,
    slam: SlamKind,
    settings: MapSettings,
    progress: Progress,
    observer: SlamObserver,
    odometries: Sequence[OdometryTrajectory] = (),
) -> PlacedScans:
    """Place the scans; without SLAM by ``prior`` only. ``odometries``: see ``pose_graph_slam``.

    Raises MappingFailed where no scan can be placed.
    """
    if slam == "pose-graph":
        graph = pose_graph_slam(scans, prior, settings, progress, observer, odometries)
        return PlacedScans(
            stamps_ns=graph.stamps_ns,
            poses_map_scan=graph.poses_map_scan,
            trusted=graph.trusted,
            seconds=graph.seconds,
            graph=graph,
        )
    if slam == "particle-filter":
        particles = particle_filter_slam(scans, prior, settings.particles, progress, observer)
        return PlacedScans(
            stamps_ns=particles.stamps_ns,
            poses_map_scan=particles.poses_map_scan,
            trusted=particles.trusted,
            seconds=particles.seconds,
            particles=particles,
        )
    if prior is None:
        raise MappingFailed("without SLAM and without motion there are no poses.")
    return _place_by_prior(scans, prior)


def _place_by_prior(scans: ScanSource, prior: PosePrior) -> PlacedScans:
    stamps_ns = []
    found = []
    for scan in scans:
        stamps_ns.append(scan.stamp_ns)
        found.append(prior(scan.stamp_ns))
    poses = [pose for pose in found if pose is not None]
    if not poses:
        raise MappingFailed("the motion has no pose for any scan.")
    known = np.array([pose is not None for pose in found])
    notes: tuple[str, ...] = ()
    if not known.all():
        notes = (f"{np.count_nonzero(~known)} scans have no pose and are left out.",)
    return PlacedScans(
        stamps_ns=np.array(stamps_ns, dtype=np.int64)[known],
        poses_map_scan=np.array(poses),
        trusted=np.ones(len(poses), dtype=np.bool_),
        seconds={},
        notes=notes,
    )
