"""The cloud over the image."""

import cv2
import numpy as np
import pytest

from fusion_core.exporting.figures_calibration import CloudOverImage, write_cloud_over_image

GREY = np.full((60, 80), 128, dtype=np.uint8)


def cloud(left):
    u, v = np.meshgrid(np.arange(left, left + 20.0), np.arange(20.0, 40.0))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    return CloudOverImage(
        pixels=pixels, range_m=np.linspace(5.0, 50.0, len(pixels)), title=f"from {left}"
    )


def test_points_are_coloured_where_they_appear_and_the_bytes_do_not_change(tmp_path):
    first, second = tmp_path / "first.png", tmp_path / "second.png"
    write_cloud_over_image(first, "before and after", GREY, [cloud(5), cloud(50)])
    write_cloud_over_image(second, "before and after", GREY, [cloud(5), cloud(50)])
    assert first.read_bytes() == second.read_bytes()
    picture = cv2.imread(str(first)).astype(int)
    coloured = np.ptp(picture, axis=2) > 60
    rows = np.flatnonzero(coloured.any(axis=1))
    above = coloured[: rows.mean().astype(int)]
    middle = np.flatnonzero(above.any(axis=0)).mean() / picture.shape[1]
    assert middle < 0.35


def test_an_image_without_points_is_drawn(tmp_path):
    empty = CloudOverImage(pixels=np.empty((0, 2)), range_m=np.empty(0), title="none")
    write_cloud_over_image(tmp_path / "none.png", "no points", GREY, [empty])
    assert (tmp_path / "none.png").stat().st_size > 0


def test_points_and_ranges_must_agree():
    with pytest.raises(ValueError, match=r"\(N, 2\)"):
        CloudOverImage(pixels=np.zeros((3, 2)), range_m=np.zeros(4), title="")
