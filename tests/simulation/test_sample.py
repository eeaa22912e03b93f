"""The built-in recording is the scene of its name."""

from pathlib import Path

import numpy as np

from fusion_core.simulation.scenes import find_scene, write_scene

SAMPLES = Path(__file__).parents[2] / "samples"


def test_the_sample_is_what_its_seed_gives(tmp_path):
    kept = dict(np.load(SAMPLES / "furnished_room.truth.npz"))
    scene = find_scene("furnished_room")
    assert kept["seed"] == scene.settings.seed
    assert kept["scan_stamp"].size == 10 * scene.settings.duration_s
    # Each frame draws from its own stream: a shorter recording is the beginning of a longer one.
    short = scene.settings.model_copy(update={"duration_s": 0.4})
    write_scene("furnished_room", tmp_path / "a.mcap", settings=short)
    again = dict(np.load(tmp_path / "a.truth.npz"))
    for key in ("scan_true", "depth_true", "pose"):
        np.testing.assert_allclose(again[key], kept[key][: len(again[key])], 1e-6, err_msg=key)
    for key in ("scan_kind", "depth_kind"):
        # A sine's last bit is the processor's own, and decides where a draw meets its chance.
        assert np.mean(again[key] != kept[key][: len(again[key])]) < 1e-4, key


def test_the_sample_is_small_and_has_every_kind():
    assert (SAMPLES / "furnished_room.mcap").stat().st_size <= 8 * 1024**2
    kept = dict(np.load(SAMPLES / "furnished_room.truth.npz"))
    for key in ("scan_kind", "depth_kind"):
        assert np.unique(kept[key]).tolist() == [0, 1, 2]
