"""What an image says of where a cloud is seen in it: the information that the two share.

Two families, found apart: the intensity's contrast with the grey value's, and depth steps with
image edges. Each is n I(A; B): the log-likelihood ratio, in nats, of n pairs against pairs by
chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from fusion_core.calibration.refinement.beam_neighbours import (
    BeamNeighbours,
    find_beam_neighbours,
    find_depth_steps,
    intensity_contrast,
    turns_full_circle,
)
from fusion_core.calibration.refinement.edge_alignment import (
    blurred,
    gradient_fields,
    grey_contrast,
    orientation_of,
)
from fusion_core.calibration.refinement.hidden_points import visible_points
from fusion_core.calibration.refinement.information_distance import (
    add_pairs,
    equal_groups,
    group_scale,
    joint_information,
    mutual_information,
    normalised_information_distance,
)
from fusion_core.calibration.refinement.rectified_image import RectifiedImage
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.geometry import transform_points

INTENSITY, EDGES = "intensity", "edges"
# Points so far outside the image, in its widths, may come into it.
_MARGIN = 0.1
# A surface is one up to this tangent of the angle of incidence: 84 degrees.
_SLOPE_MAX = 10.0
# Neighbouring points of the ground at that angle differ by so much of their depth in one beam's
# spacing of 0.2 degrees, and three beams lie in a cell of hidden_points.
_HIDDEN_TOLERANCE = 0.1
_CELL_BEAMS = 1.5
# Surroundings of a beam, and of a pixel, in beams.
_SURROUNDINGS_BEAMS = 10.0
# Places without a step to each with one.
_BACKGROUND = 5
_INTENSITY_LABELS, _GREY_GROUPS = 10, 12
# Pixels of a level's image in one standard deviation of its blur.
_BLUR_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledPoints:
    """Points of one family. ``points_in_lidar_m``: (N, 3). ``labels``: (N,) rows of the joint
    counts. ``layers``: (N,) the layer of the image that each looks at. ``blocks``: (N,) which part
    of the image each lies in at first."""

    family: str
    points_in_lidar_m: FloatArray
    labels: IntArray
    layers: IntArray
    blocks: IntArray

    def __post_init__(self) -> None:
        for array in (self.points_in_lidar_m, self.labels, self.layers, self.blocks):
            read_only(array)

    def chosen(self, mask: BoolArray) -> Self:
        return replace(
            self,
            points_in_lidar_m=np.ascontiguousarray(self.points_in_lidar_m[mask]),
            labels=np.ascontiguousarray(self.labels[mask]),
            layers=np.ascontiguousarray(self.layers[mask]),
            blocks=np.ascontiguousarray(self.blocks[mask]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibleCloud:
    """What the camera sees of the cloud from one pose. ``seen_in_lidar_m``: (N, 3) the points in
    the image that nothing hides. ``spacing_rad``: the angle between neighbouring beams."""

    seen_in_lidar_m: FloatArray
    spacing_rad: float
    families: tuple[LabelledPoints, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class EvidenceLevel:
    """The families with the image blurred by ``sigma_rad``, ready to be evaluated at any pose.
    Each point of them stands for ``each`` points of the cloud."""

    sigma_rad: float
    each: int
    pinhole: tuple[float, float, float, float]
    families: tuple[LabelledPoints, ...]
    images: tuple[Float32Array, ...]

    def joint_counts(self, T_camera_lidar: FloatArray) -> list[FloatArray]:
        """For each family the counts of pairs of labels and image groups."""
        counts = []
        for points, image in zip(self.families, self.images, strict=True):
            joint = np.zeros((_labels_of(points), _GREY_GROUPS))
            add_pairs(
                points.points_in_lidar_m,
                points.labels,
                points.layers,
                image,
                self.pinhole,
                T_camera_lidar,
                joint,
            )
            counts.append(joint)
        return counts

    def information(self, T_camera_lidar: FloatArray) -> FloatArray:
        """(families,) n I(A; B) in nats of the n pairs that lie in the image."""
        return np.array(
            [
                self.each
                * sum(kind.sum() * mutual_information(kind) for kind in _kinds(joint, points))
                for points, joint in zip(
                    self.families, self.joint_counts(T_camera_lidar), strict=True
                )
            ]
        )

    def distances(self, T_camera_lidar: FloatArray) -> dict[str, float]:
        """Each family's normalised information distance."""
        counts = self.joint_counts(T_camera_lidar)
        return {
            points.family: normalised_information_distance(joint)
            for points, joint in zip(self.families, counts, strict=True)
        }

    def tables(self, T_camera_lidar: FloatArray) -> list[FloatArray]:
        """For each family the information of each pair of labels and groups at a pose."""
        return [
            np.concatenate([joint_information(kind) for kind in _kinds(joint, points)])
            for points, joint in zip(self.families, self.joint_counts(T_camera_lidar), strict=True)
        ]

    def block_information(
        self, T_camera_lidar: FloatArray, tables: Sequence[FloatArray], blocks: int
    ) -> FloatArray:
        """(families, blocks) nats of the pairs in each block by tables from elsewhere."""
        result = np.zeros((len(self.families), blocks))
        for number, (points, image) in enumerate(zip(self.families, self.images, strict=True)):
            labels = _labels_of(points)
            joint = np.zeros((blocks * labels, _GREY_GROUPS))
            add_pairs(
                points.points_in_lidar_m,
                points.blocks * labels + points.labels,
                points.layers,
                image,
                self.pinhole,
                T_camera_lidar,
                joint,
            )
            of_block = joint.reshape(blocks, labels, _GREY_GROUPS)
            result[number] = self.each * (of_block * tables[number]).sum(axis=(1, 2))
        return result

    def chosen(self, blocks: BoolArray) -> "EvidenceLevel":
        """The same with the points of some blocks alone."""
        return replace(
            self, families=tuple(points.chosen(blocks[points.blocks]) for points in self.families)
        )


def see_cloud(
    points_in_lidar_m: FloatArray,
    intensity: FloatArray | None,
    image: RectifiedImage,
    T_camera_lidar: FloatArray,
    block_grid: tuple[int, int],
) -> VisibleCloud:
    """Labels of the points that the camera sees from a pose; no intensity family without an
    intensity that differs among them. ``block_grid``: columns and rows of blocks."""
    pixels = image.project(transform_points(T_camera_lidar, points_in_lidar_m))
    near_image = image.inside(pixels, _MARGIN)
    points, pixels = points_in_lidar_m[near_image], pixels[near_image]
    near = find_beam_neighbours(points)
    depth_m = transform_points(T_camera_lidar, points)[:, 2]
    cell_px = max(1.0, _CELL_BEAMS * near.spacing_rad * image.pinhole[0])
    seen = visible_points(pixels, depth_m, cell_px=cell_px, tolerance=_HIDDEN_TOLERANCE)
    blocks = _blocks(pixels, image, block_grid)
    families = []
    if intensity is not None:
        contrast = intensity_contrast(
            near,
            intensity[near_image],
            radius_rad=_SURROUNDINGS_BEAMS * near.spacing_rad,
            slope_max=_SLOPE_MAX,
        )
        use = seen & np.isfinite(contrast)
        if use.any() and np.ptp(contrast[use]) > 0.0:
            families.append(_intensity_points(near, contrast, blocks, use))
    families.append(_edge_points(points_in_lidar_m, near, T_camera_lidar, image, blocks, seen))
    return VisibleCloud(
        seen_in_lidar_m=points[seen & image.inside(pixels)],
        spacing_rad=near.spacing_rad,
        families=tuple(family for family in families if family.labels.size),
    )


def blur_evidence(
    cloud: VisibleCloud, image: RectifiedImage, T_camera_lidar: FloatArray, sigma_rad: float
) -> EvidenceLevel:
    """The evidence at one level; the image's groups hold equal counts of pixels of the points as
    they lie at ``T_camera_lidar``. Where the blur is wider than the beams are apart, some of them
    say as much as all."""
    spacing_px = cloud.spacing_rad * image.pinhole[0]
    sigma_px = sigma_rad * image.pinhole[0]
    shrink = min(1.0, _BLUR_PX / sigma_px)
    each = max(1, int(0.5 * sigma_rad / cloud.spacing_rad))
    images = []
    for points in cloud.families:
        if points.family == INTENSITY:
            layers = grey_contrast(image.grey, surroundings_px=_SURROUNDINGS_BEAMS * spacing_px)[
                np.newaxis
            ]
        else:
            layers = gradient_fields(image.grey, surroundings_px=_SURROUNDINGS_BEAMS * spacing_px)
        images.append([_shrunk(layer, shrink, sigma_px) for layer in layers])
    height, width = images[0][0].shape
    x, y = width / image.size_px[0], height / image.size_px[1]
    fx, fy, cx, cy = image.pinhole
    pinhole = (fx * x, fy * y, (cx + 0.5) * x - 0.5, (cy + 0.5) * y - 0.5)
    known = cv2.resize(image.known.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    small = RectifiedImage(grey=images[0][0], known=known > 0, pinhole=pinhole)
    return EvidenceLevel(
        sigma_rad=sigma_rad,
        pinhole=pinhole,
        each=each,
        families=tuple(_thinned(points, each) for points in cloud.families),
        images=tuple(
            _grouped(np.stack(layers), points, small, T_camera_lidar)
            for layers, points in zip(images, cloud.families, strict=True)
        ),
    )


def _intensity_points(
    near: BeamNeighbours, contrast: FloatArray, blocks: IntArray, use: BoolArray
) -> LabelledPoints:
    return LabelledPoints(
        family=INTENSITY,
        points_in_lidar_m=np.ascontiguousarray(near.points_in_lidar_m[use]),
        labels=equal_groups(contrast[use], _INTENSITY_LABELS),
        layers=np.zeros(int(use.sum()), dtype=np.int64),
        blocks=blocks[use],
    )


def _edge_points(
    all_points_in_lidar_m: FloatArray,
    near: BeamNeighbours,
    T_camera_lidar: FloatArray,
    image: RectifiedImage,
    blocks: IntArray,
    seen: BoolArray,
) -> LabelledPoints:
    steps = find_depth_steps(
        near,
        slope_min=_SLOPE_MAX,
        sideways_gaps_are_sky=turns_full_circle(all_points_in_lidar_m),
    )
    ahead_m = near.spacing_rad * near.range_m[steps.beam, np.newaxis] * steps.towards
    here = image.project(transform_points(T_camera_lidar, steps.points_in_lidar_m))
    there = image.project(transform_points(T_camera_lidar, steps.points_in_lidar_m + ahead_m))
    use = seen[steps.beam] & np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
    use &= _background(steps.is_step & use)
    sideways = np.abs(np.einsum("ni,ni->n", steps.towards, near.tangents[steps.beam, 0])) > 0.5
    labels = 2 * (~sideways).astype(np.int64) + steps.is_step
    return LabelledPoints(
        family=EDGES,
        points_in_lidar_m=np.ascontiguousarray(steps.points_in_lidar_m[use]),
        labels=labels[use],
        layers=orientation_of((there - here)[use]),
        blocks=blocks[steps.beam[use]],
    )


def _background(is_step: BoolArray) -> BoolArray:
    """The steps, and every few of the others: how gradients are spread elsewhere is as well known
    from some times as many."""
    others = is_step.size - is_step.sum()
    every = max(1, int(others // max(1, _BACKGROUND * is_step.sum())))
    chosen = is_step.copy()
    chosen[np.flatnonzero(~is_step)[::every]] = True
    return chosen


def _kinds(joint: FloatArray, points: LabelledPoints) -> list[FloatArray]:
    """The joint counts of pairs of each kind: steps to the side and steps up or down are told of
    apart, since an image has more edges of one kind."""
    return np.split(joint, 1 if points.family == INTENSITY else 2)


def _labels_of(points: LabelledPoints) -> int:
    return _INTENSITY_LABELS if points.family == INTENSITY else 4


def _blocks(pixels: FloatArray, image: RectifiedImage, grid: tuple[int, int]) -> IntArray:
    """(N,) numbers of blocks: columns of equal width, each cut where half its points lie above."""
    columns, rows = grid
    width = image.size_px[0]
    column = np.clip((pixels[:, 0] + 0.5) * columns / width, 0, columns - 1).astype(np.int64)
    row = np.zeros(column.size, dtype=np.int64)
    for number in range(columns):
        inside = column == number
        if inside.any():
            row[inside] = equal_groups(pixels[inside, 1], rows)
    return row * columns + column


def _thinned(points: LabelledPoints, each: int) -> LabelledPoints:
    """One of ``each`` points, without order: every second of a ring might be every second ring."""
    if each == 1:
        return points
    drawn = np.random.default_rng(each).random(points.labels.size)
    return points.chosen(drawn < 1.0 / each)


def _shrunk(layer: Float32Array, shrink: float, sigma_px: float) -> Float32Array:
    if shrink < 1.0:
        size = (round(layer.shape[1] * shrink), round(layer.shape[0] * shrink))
        size = (max(2, size[0]), max(2, size[1]))
        layer = np.asarray(cv2.resize(layer, size, interpolation=cv2.INTER_AREA), np.float32)
        # Averages over squares are a blur already.
        sigma_px = np.sqrt(max(0.0, (sigma_px * shrink) ** 2 - 1.0 / 12.0))
    return blurred(layer, sigma_px)


def _grouped(
    layers: Float32Array, points: LabelledPoints, image: RectifiedImage, T_camera_lidar: FloatArray
) -> Float32Array:
    """Each layer's values as groups, NaN where the image is not known."""
    pixels = image.project(transform_points(T_camera_lidar, points.points_in_lidar_m))
    inside = image.inside(pixels)
    nearest = np.round(pixels[inside]).astype(np.int64)
    limit = np.array(image.size_px) - 1
    nearest = np.clip(nearest, 0, limit)
    for number in range(len(layers)):
        looks = points.layers[inside] == number
        if looks.any():
            samples = layers[number][nearest[looks, 1], nearest[looks, 0]]
            layers[number] = group_scale(layers[number], samples, _GREY_GROUPS)
        layers[number][~image.known] = np.nan
    return np.ascontiguousarray(layers)
