"""The planes of the cloud of a whole turn, and the mounting that both half turns agree on."""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.turning.half_turn_planes import FrameSettings
from fusion_core.calibration.turning.plane_bundle import BundleSolution, solve_bundle
from fusion_core.calibration.turning.plane_members import assign_planes
from fusion_core.calibration.turning.planes import (
    Plane,
    PlaneSettings,
    extract_planes,
    fit_plane,
    oriented,
)
from fusion_core.calibration.turning.turn import Turn
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.progress import Progress
from fusion_core.model.robust import robust_sigma

_ROUNDS = 3
_EXTRACTED_POINTS = 40000
# Of each half turn, on a plane that is used.
_MEMBERS_MIN = 300
_TOLERANCE_LIMITS_M = (0.01, 0.3)
# In standard deviations of the points about their planes.
_TOLERANCE_SIGMAS = 3.5
_GROUP_POINTS_MIN = 100
# How far from a plane its scatter is measured, in tolerances.
_BAND = 4.0
_SAME_COSINE = float(np.cos(np.deg2rad(10.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPlane:
    """A plane in ``rig`` that both half turns see.

    ``name``: where it is, for people. ``points_left``, ``points_right``: used of each half turn.
    ``sigma_m``: scatter of the points about it. ``shares``: (4,) its part, 0 to 1, in what all
    planes say about each of SELF_CALIBRATION_PARAMETERS.
    """

    name: str
    normal: FloatArray
    offset_m: float
    points_left: int
    points_right: int
    sigma_m: float
    shares: FloatArray

    def __post_init__(self) -> None:
        read_only(self.normal)
        read_only(self.shares)


class WholeTurn:
    """Finds the planes of a turn's cloud, starting from an estimate of the mounting, and refines
    both together, with the points chosen anew each round.

    Raises CalibrationFailed where both half turns see none of the planes.
    """

    def __init__(
        self,
        turn: Turn,
        start: FloatArray,
        settings: PlaneSettings,
        rng: np.random.Generator,
        progress: Progress,
    ) -> None:
        self._turn = turn
        self._left = left_half(turn)
        cloud_m = turn.in_rig(start)
        count = min(_EXTRACTED_POINTS, len(cloud_m))
        sample_m = cloud_m[rng.choice(len(cloud_m), count, replace=False)]
        planes = extract_planes(sample_m, settings, rng)
        tolerance_m = _tolerance(_scatter(sample_m, planes, settings.tolerance_m))
        planes = _distinct(planes, tolerance_m)
        parameters = start
        for round_ in range(_ROUNDS):
            progress(round_, _ROUNDS, "mounting and planes")
            planes, plane_of = self._members(turn.in_rig(parameters), planes, tolerance_m)
            self._used = np.flatnonzero(plane_of >= 0)
            self._plane_of = plane_of[self._used]
            self._members_of_turn = turn.subset(self._used)
            self.solution = self._solve(self._members_of_turn, self._plane_of, planes, parameters)
            parameters = self.solution.parameters
            planes = tuple(
                Plane(*oriented(normal, float(offset)), np.zeros(0, dtype=np.int64))
                for normal, offset in zip(
                    self.solution.normals, self.solution.offsets_m, strict=True
                )
            )
            tolerance_m = _tolerance(self.median_sigma_m)
        self._planes = planes

    def groups(self, frames: FrameSettings) -> FloatArray:
        """(G, 4) parameters from every G-th frame of the turn alone, as far as those determine
        them."""
        phase = self._members_of_turn.axis_angles_rad - self._turn.axis_angles_rad.min()
        # Of the frames that there are: an axis that stops for each scan leaves many empty.
        _, frame_of = np.unique(frames.frame_of(phase), return_inverse=True)
        group_of = frame_of % frames.groups
        estimates = []
        for group in range(frames.groups):
            own = np.flatnonzero(group_of == group)
            counts = np.bincount(self._plane_of[own], minlength=len(self._planes))
            kept = np.flatnonzero(counts >= _GROUP_POINTS_MIN)
            own = own[np.isin(self._plane_of[own], kept)]
            if own.size == 0:
                continue
            solution = self._solve(
                self._members_of_turn.subset(own),
                np.searchsorted(kept, self._plane_of[own]),
                tuple(self._planes[index] for index in kept),
                self.solution.parameters,
            )
            if np.isfinite(solution.covariance).all():
                estimates.append(solution.parameters)
        return np.array(estimates).reshape(-1, len(self.solution.parameters))

    def seen_planes(self) -> tuple[SeenPlane, ...]:
        """The planes with their part in the estimate, the one with most points first."""
        left = self._left[self._used]
        total = self.solution.information.sum(axis=0).diagonal()
        seen = [
            SeenPlane(
                name=plane_name(plane.normal, plane.offset_m),
                normal=plane.normal,
                offset_m=plane.offset_m,
                points_left=int((left & (self._plane_of == index)).sum()),
                points_right=int((~left & (self._plane_of == index)).sum()),
                sigma_m=float(self.solution.sigma_m[index]),
                shares=self.solution.information[index].diagonal() / total,
            )
            for index, plane in enumerate(self._planes)
        ]
        return tuple(sorted(seen, key=lambda plane: -plane.points_left - plane.points_right))

    @property
    def median_sigma_m(self) -> float:
        """Scatter of the points about their planes."""
        return float(np.median(self.solution.sigma_m))

    def mismatch_m(self, parameters: FloatArray) -> float:
        """Root mean square over the planes: how far from the plane that one half turn sees the
        points of the other lie, with a mounting of these parameters."""
        cloud_m = self._members_of_turn.in_rig(parameters)
        left = self._left[self._used]
        squares = []
        for index in range(len(self._planes)):
            member = self._plane_of == index
            normal, offset_m = fit_plane(cloud_m[member & left])
            apart_m = cloud_m[member & ~left] @ normal - offset_m
            own_m = cloud_m[member & left] @ normal - offset_m
            # The noise of the points is no mismatch.
            squares.append(max(np.mean(apart_m**2) - np.mean(own_m**2), 0.0))
        return float(np.sqrt(np.mean(squares)))

    def _members(
        self, cloud_m: FloatArray, planes: tuple[Plane, ...], tolerance_m: float
    ) -> tuple[tuple[Plane, ...], IntArray]:
        """The planes that both half turns see, and (N,) the plane of each point, -1 for none."""
        if not planes:
            raise CalibrationFailed(
                "the cloud of the turn has no planes.",
                advice="Scan where walls, floor and ceiling are in view.",
            )
        plane_of = assign_planes(cloud_m, planes, tolerance_m)
        counts = [
            np.bincount(plane_of[(plane_of >= 0) & half], minlength=len(planes))
            for half in (self._left, ~self._left)
        ]
        kept = np.flatnonzero(np.minimum(*counts) >= _MEMBERS_MIN)
        if kept.size == 0:
            raise CalibrationFailed(
                "no plane is seen by both half turns.",
                advice="Turn the axis through 360 degrees, where walls and floor are in view.",
            )
        renamed = np.full(len(planes) + 1, -1)
        renamed[kept] = np.arange(kept.size)
        return tuple(planes[index] for index in kept), renamed[plane_of]

    def _solve(
        self, turn: Turn, plane_of: IntArray, planes: tuple[Plane, ...], start: FloatArray
    ) -> BundleSolution:
        normals = np.stack([plane.normal for plane in planes])
        offsets_m = np.array([plane.offset_m for plane in planes])
        return solve_bundle(turn, plane_of, start, normals, offsets_m)


def _tolerance(sigma_m: float) -> float:
    return float(np.clip(_TOLERANCE_SIGMAS * sigma_m, *_TOLERANCE_LIMITS_M))


def _scatter(points_m: FloatArray, planes: tuple[Plane, ...], tolerance_m: float) -> float:
    """The standard deviation of points about the nearest of the planes, from a wide band: the
    planes' own members end at the tolerance, however much the points scatter."""
    if not planes:
        return tolerance_m / _TOLERANCE_SIGMAS
    normals = np.stack([plane.normal for plane in planes])
    offsets_m = np.array([plane.offset_m for plane in planes])
    distances_m = np.abs(points_m @ normals.T - offsets_m).min(axis=1)
    return robust_sigma(distances_m[distances_m < _BAND * tolerance_m])


def _distinct(planes: tuple[Plane, ...], tolerance_m: float) -> tuple[Plane, ...]:
    """The planes without those that are slices of a better supported one: where points scatter by
    more than was expected, what is left beside a plane looks like another."""
    kept: list[Plane] = []
    for plane in planes:
        is_slice = any(
            plane.normal @ other.normal > _SAME_COSINE
            and abs(plane.offset_m - other.offset_m) < 2.0 * tolerance_m
            for other in kept
        )
        if not is_slice:
            kept.append(plane)
    return tuple(kept)


def left_half(turn: Turn) -> BoolArray:
    """(N,) whether points were measured from 0 to 180 degrees after the start of a turn."""
    phase = np.mod(turn.axis_angles_rad - turn.axis_angles_rad.min(), 2.0 * np.pi)
    left: BoolArray = phase < np.pi
    return left


def plane_name(normal: FloatArray, offset_m: float) -> str:
    """Where a plane is, seen along the axis and about it: ``below, 1.42 m``."""
    if abs(normal[2]) > 0.9:
        return f"{'above' if normal[2] > 0.0 else 'below'}, {offset_m:.2f} m"
    # A whole number from -179 to 180, and 0 without a sign.
    bearing_deg = 180 - round(180.0 - float(np.rad2deg(np.arctan2(normal[1], normal[0])))) % 360
    kind = "upright" if abs(normal[2]) < 0.2 else "sloping"
    return f"{kind} at {bearing_deg} deg, {offset_m:.2f} m"
