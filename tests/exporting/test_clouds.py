"""Point clouds, read back."""

from pathlib import Path

import numpy as np
import pytest

from fusion_core.exporting.clouds import write_cloud
from fusion_core.model.errors import ExportError
from fusion_core.recordings.clouds.formats import read_cloud

POINTS_M = np.random.default_rng(3).normal(size=(50, 3))


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("with_color", [False, True])
@pytest.mark.parametrize("with_intensity", [False, True])
def test_round_trip_and_same_bytes(
    tmp_path: Path, suffix: str, with_color: bool, with_intensity: bool
) -> None:
    import open3d as o3d

    rgb = np.random.default_rng(4).integers(0, 256, (50, 3), dtype=np.uint8)
    intensity = np.random.default_rng(5).uniform(0.0, 255.0, 50).astype(np.float32)
    intensity[7] = np.nan
    paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for path in paths:
        write_cloud(
            path,
            POINTS_M,
            rgb if with_color else None,
            intensity if with_intensity else None,
        )
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert sorted(tmp_path.iterdir()) == paths
    cloud = o3d.io.read_point_cloud(paths[0])
    assert np.allclose(np.asarray(cloud.points), POINTS_M, atol=1e-6)
    if with_color:
        assert np.array_equal(np.round(np.asarray(cloud.colors) * 255), rgb)
    ours = read_cloud(paths[0])
    assert np.allclose(ours.xyz_m, POINTS_M, atol=1e-6)
    if with_intensity:
        theirs = o3d.t.io.read_point_cloud(str(paths[0])).point.intensity.numpy()[:, 0]
        assert np.array_equal(theirs, intensity, equal_nan=True)
        assert np.array_equal(ours.intensity, intensity, equal_nan=True)
    else:
        assert ours.intensity is None


@pytest.mark.parametrize(
    ("name", "points_m", "words"),
    [("a.xyz", POINTS_M, "not a point cloud format"), ("a.ply", np.empty((0, 3)), "no points")],
)
def test_an_empty_cloud_or_unknown_suffix_is_refused(
    tmp_path: Path, name: str, points_m: np.ndarray, words: str
) -> None:
    with pytest.raises(ExportError, match=words):
        write_cloud(tmp_path / name, points_m)
    with pytest.raises(ValueError, match="finite"):
        write_cloud(tmp_path / "b.ply", np.full((1, 3), np.nan))
    with pytest.raises(ValueError, match="rgb must be"):
        write_cloud(tmp_path / "b.ply", POINTS_M, np.zeros((49, 3), np.uint8))
    with pytest.raises(ValueError, match="intensity must be"):
        write_cloud(tmp_path / "b.ply", POINTS_M, None, np.zeros((50, 1), np.float32))
    assert list(tmp_path.iterdir()) == []
