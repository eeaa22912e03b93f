"""Impossible camera intrinsics are refused."""

import pytest

from fusion_core.model.sensors import CameraIntrinsics


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"fx": 1e-300}, "focal length fx 1e-300"),
        ({"fy": 1e300}, r"focal length fy 1e\+300"),
        ({"cx": -1e300}, r"centre cx -1e\+300"),
        ({"cy": 1e300}, r"centre cy 1e\+300"),
        ({"distortion": (0.0, -1e300)}, r"distortion coefficient -1e\+300"),
        ({"fx": float("nan")}, "must be finite"),
    ],
)
def test_impossible_intrinsics_are_refused_by_name(change: dict, named: str) -> None:
    values = {"width": 64, "height": 48, "fx": 55.0, "fy": 57.0, "cx": 30.2, "cy": 25.1}
    assert CameraIntrinsics(**values)
    with pytest.raises(ValueError, match=named):
        CameraIntrinsics(**{**values, **change})
