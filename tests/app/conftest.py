"""A simulated recording, small enough to be fused in a test."""

from pathlib import Path

import pytest

from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene


@pytest.fixture(scope="session")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 s of the bedroom, with images of half size."""
    path = tmp_path_factory.mktemp("scene") / "small room.mcap"
    own = find_scene("bedroom").settings.model_dump()
    write_scene(
        "bedroom", path, settings=SceneSettings(**own | {"duration_s": 2.0, "image_scale": 0.5})
    )
    return path
