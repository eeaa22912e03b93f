"""Projection against the formulas written out, and points that a lens cannot show."""

import numpy as np
import pytest

from fusion_core.lens.projection import inside_image, project_points
from fusion_core.model.sensors import CameraIntrinsics


def _camera(model: str, *distortion: float) -> CameraIntrinsics:
    return CameraIntrinsics(
        width=640,
        height=480,
        fx=500.0,
        fy=510.0,
        cx=320.0,
        cy=240.0,
        distortion_model=model,
        distortion=distortion,
    )


POINTS_M = np.array([[0.3, -0.2, 2.0], [-1.0, 0.5, 3.0], [0.0, 0.0, 1.0]])


def test_a_pinhole() -> None:
    pixels = project_points(POINTS_M, _camera("plumb_bob"))
    assert pixels == pytest.approx(
        np.stack(
            [
                320.0 + 500.0 * POINTS_M[:, 0] / POINTS_M[:, 2],
                240.0 + 510.0 * POINTS_M[:, 1] / POINTS_M[:, 2],
            ],
            axis=1,
        )
    )


def test_radial_and_tangential_distortion() -> None:
    k1, k2, p1, p2, k3 = -0.3, 0.1, 0.002, -0.001, -0.02
    pixels = project_points(POINTS_M, _camera("plumb_bob", k1, k2, p1, p2, k3))
    for pixel, (x, y, z) in zip(pixels, POINTS_M, strict=True):
        a, b = x / z, y / z
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
        v = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
        assert pixel == pytest.approx([320.0 + 500.0 * u, 240.0 + 510.0 * v])


def test_a_fisheye() -> None:
    k = (-0.1, 0.14, -0.15, 0.06)
    pixels = project_points(POINTS_M[:2], _camera("fisheye", *k))
    for pixel, (x, y, z) in zip(pixels, POINTS_M[:2], strict=True):
        r = np.hypot(x, y)
        angle = np.arctan2(r, z)
        bent = angle * (1 + sum(c * angle ** (2 * i + 2) for i, c in enumerate(k)))
        assert pixel == pytest.approx([320.0 + 500.0 * bent * x / r, 240.0 + 510.0 * bent * y / r])


def test_what_is_behind_or_beyond_the_lens_has_no_pixel() -> None:
    behind = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, 0.0]])
    assert np.isnan(project_points(behind, _camera("plumb_bob"))).all()
    # With k1 = -0.35 the distorted radius r (1 - 0.35 r²) falls from r = 0.976 on.
    strong = _camera("plumb_bob", -0.35)
    far_out = np.array([[0.97, 0.0, 1.0], [1.6, 0.0, 1.0]])
    assert np.isnan(project_points(far_out, strong)).all(axis=1).tolist() == [False, True]


def test_inside_counts_whole_pixels() -> None:
    pixels = np.array([[-0.5, 0.0], [639.4, 479.4], [639.5, 10.0], [np.nan, np.nan]])
    assert inside_image(pixels, _camera("plumb_bob")).tolist() == [True, True, False, False]
