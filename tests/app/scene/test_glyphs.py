"""The shapes of the classes: one for each, of one size on the screen, facing the viewer."""

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from scanloom.scene.glyphs import class_glyphs, facing, ring_segments

UP = np.array([0.0, 0.0, 1.0])
EYE = facing(np.array([-3.0, 0.0, 2.0]), np.zeros(3), UP)


def far_apart(codes: list[NoiseClass]) -> tuple[np.ndarray, np.ndarray]:
    points = np.zeros((len(codes), 3), dtype=np.float32)
    points[:, 1] = np.arange(len(codes))
    return points, np.array([int(code) for code in codes])


def test_each_class_has_a_shape_of_its_own():
    shapes = class_glyphs(*far_apart(list(NoiseClass)), EYE)
    counts = {noise: int((shapes.lines_class == noise).sum()) for noise in NoiseClass}
    # A post and: a ring of twelve sides, a cross, a diamond; good is a dot.
    assert counts == {
        NoiseClass.GOOD: 0,
        NoiseClass.HOLE: 13,
        NoiseClass.BURR: 3,
        NoiseClass.CONFLICT: 5,
    }
    np.testing.assert_array_equal(shapes.dots_m, [[0.0, 0.0, 0.0]])
    assert shapes.lines_m.shape == (21, 2, 3)


def test_a_shape_stands_over_the_end_of_its_beam_and_faces_the_viewer():
    points, codes = far_apart([NoiseClass.CONFLICT])
    lines = class_glyphs(points, codes, EYE).lines_m.astype(float)
    post, outline = lines[0], lines[1:].reshape(-1, 3)
    np.testing.assert_allclose(post[0], points[0])
    np.testing.assert_allclose(post[1][:2], points[0][:2])
    middle = 0.5 * (outline.max(axis=0) + outline.min(axis=0))
    assert middle[2] > post[1][2] > 0.0
    towards_eye = np.cross(EYE.right, EYE.up)
    np.testing.assert_allclose((outline - middle) @ towards_eye, 0.0, atol=1e-6)


def test_shapes_are_of_one_size_on_the_screen():
    points = np.array([[0.0, 0.0, 0.0], [7.0, 0.0, 0.0]], dtype=np.float32)
    lines = class_glyphs(points, np.array([1, 1]), EYE).lines_m.astype(float)
    rings = lines[2:14], lines[14:]
    sizes = [np.ptp(ring.reshape(-1, 3) @ EYE.right) for ring in rings]
    distances = [np.linalg.norm(point - EYE.eye_m) for point in points]
    assert sizes[1] / sizes[0] == pytest.approx(distances[1] / distances[0], rel=0.02)
    narrow = facing(EYE.eye_m, np.zeros(3), UP, np.deg2rad(20.0))
    ring = class_glyphs(points[:1], np.array([1]), narrow).lines_m[1:].reshape(-1, 3)
    ratio = np.tan(np.deg2rad(10.0)) / np.tan(np.deg2rad(25.0))
    assert np.ptp(ring @ narrow.right) == pytest.approx(ratio * sizes[0], rel=0.02)


def test_adjacent_shapes_form_no_coil_but_each_has_its_post():
    points = np.zeros((50, 3), dtype=np.float32)
    points[:, 1] = 0.01 * np.arange(50)
    shapes = class_glyphs(points, np.full(50, int(NoiseClass.HOLE)), EYE)
    posts = (shapes.lines_m[:, 0, 2] == 0.0).sum()
    rings = (len(shapes.lines_m) - posts) / 12
    assert posts == 50
    assert 3 <= rings <= 8
    dots = class_glyphs(points, np.zeros(50, dtype=int), EYE).dots_m
    assert 3 <= len(dots) <= 8


def test_nothing_gives_no_shapes():
    shapes = class_glyphs(np.empty((0, 3), np.float32), np.empty(0, int), EYE)
    assert shapes.lines_m.shape == (0, 2, 3)
    assert shapes.dots_m.shape == (0, 3)
    assert ring_segments(np.empty((0, 3), np.float32), EYE, 1.0).shape == (0, 2, 3)


def test_a_viewer_straight_above_has_a_screen_too():
    above = facing(np.array([0.0, 0.0, 5.0]), np.zeros(3), UP)
    axes = np.stack([above.right, above.up])
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)


def test_lifted_points_are_seen_at_the_same_place():
    points = np.array([[1.0, 0.5, 0.0], [4.0, -2.0, 0.0]], dtype=np.float32)
    lifted = EYE.lifted(points, 0.02)
    np.testing.assert_allclose(np.cross(lifted - EYE.eye_m, points - EYE.eye_m), 0.0, atol=1e-5)
    ratio = np.linalg.norm(lifted - EYE.eye_m, axis=1) / np.linalg.norm(points - EYE.eye_m, axis=1)
    np.testing.assert_allclose(ratio, 0.98, rtol=1e-5)
