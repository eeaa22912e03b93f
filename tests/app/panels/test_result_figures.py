"""The figures of a folder of results: the files as they are, chosen by their titles."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import viser

from scanloom.panels.widgets.result_figures import ResultFigures, figures_in


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def figures(server: viser.ViserServer) -> ResultFigures:
    return ResultFigures(server.gui, ("fig9_maps", "map_fused"))


def write(file: Path, shade: int) -> np.ndarray:
    file.parent.mkdir(parents=True, exist_ok=True)
    rgb = np.full((4, 5, 3), shade, dtype=np.uint8)
    assert cv2.imwrite(str(file), rgb)
    return rgb


def test_the_preferred_figure_is_shown_to_the_byte(figures: ResultFigures, tmp_path: Path) -> None:
    write(tmp_path / "map_camera.png", 10)
    rgb = write(tmp_path / "map_fused.png", 20)
    figures.show(tmp_path)
    assert figures.picture.visible
    assert figures._choice.options == ("camera map", "fused map")
    assert figures._choice.value == "fused map"
    assert figures.picture._data == (tmp_path / "map_fused.png").read_bytes()
    np.testing.assert_array_equal(figures.picture.image, rgb)


def test_figures_in_subfolders_and_of_unknown_names_are_offered(tmp_path: Path) -> None:
    write(tmp_path / "figures" / "fig9_maps.png", 1)
    write(tmp_path / "some_thing.png", 2)
    assert list(figures_in(tmp_path)) == ["Fig. 9: maps from the same poses", "some thing"]


def test_a_choice_stays_where_another_folder_has_it_too(
    figures: ResultFigures, tmp_path: Path
) -> None:
    first, second, third = (tmp_path / name for name in "abc")
    for folder, shade in ((first, 30), (second, 40)):
        write(folder / "map_fused.png", shade)
        write(folder / "map_lidar.png", shade + 1)
    write(third / "trajectory.png", 50)
    figures.show(first)
    figures._chosen = "LiDAR map"
    figures.show(first)
    assert (figures.picture.image == 31).all()
    figures.show(second)
    assert (figures.picture.image == 41).all()
    figures.show(third)
    assert figures._choice.value == "trajectory on the map"
    assert (figures.picture.image == 50).all()


def test_without_figures_nothing_is_shown(figures: ResultFigures, tmp_path: Path) -> None:
    write(tmp_path / "a" / "map_fused.png", 60)
    for folder in (None, tmp_path / "gone"):
        figures.show(tmp_path / "a")
        assert figures.picture.visible
        figures.show(folder)
        assert not figures.picture.visible
        assert not figures._choice.visible


@pytest.mark.parametrize("content", [b"", b"no PNG"])
def test_a_file_that_is_no_picture_is_not_shown(
    figures: ResultFigures, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "map_fused.png").write_bytes(content)
    figures.show(tmp_path)
    assert not figures.picture.visible
    write(tmp_path / "map_lidar.png", 70)
    figures.show(None)
    figures.show(tmp_path)
    figures._chosen = "LiDAR map"
    figures.show(tmp_path)
    assert figures.picture.visible
    assert (figures.picture.image == 70).all()
