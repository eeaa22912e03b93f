"""One colour for each class, and colour maps whose lightness rises: told apart without hue."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import ByteArray
from scanloom.plots.palette import Named, class_color, class_colors, color_map, color_of
from scanloom.plots.theme import DARK, LIGHT, Theme
from scanloom.resources import palette
from tests.app.plots.color_vision import AnyColor, contrast, deuteranope, difference


@pytest.mark.parametrize("noise", NoiseClass)
def test_a_class_has_the_colour_of_the_palette_file(noise: NoiseClass) -> None:
    hexadecimal = "#{:02X}{:02X}{:02X}".format(*class_color(noise))
    assert hexadecimal == palette()[noise.name.lower()]
    assert tuple(class_colors()[noise]) == class_color(noise)


def test_a_sensor_has_the_colour_of_the_palette_file() -> None:
    assert color_of("lidar") == (0xE2, 0x75, 0x04)


@pytest.mark.parametrize("name", ["cividis", "viridis"])
def test_a_colour_map_runs_from_dark_blue_to_light_yellow(name: str) -> None:
    colors = color_map(name).astype(float)
    assert colors.shape == (256, 3)
    luminance = colors @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > -0.8).all()
    assert luminance[-1] > luminance[0] + 150
    assert colors[0, 2] > colors[0, 1]
    assert colors[-1, 0] > 200 > colors[-1, 2]


def test_shared_colours_cannot_be_changed() -> None:
    for colors in (class_colors(), color_map("cividis")):
        with pytest.raises(ValueError, match="read-only"):
            colors[0] = 0


NAMES: tuple[Named, ...] = ("good", "hole", "burr", "conflict", "lidar", "depth")


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_each_colour_stands_out_of_the_page(theme: Theme) -> None:
    ratios = {name: contrast(color_of(name), theme.background) for name in NAMES}
    print({name: round(ratio, 2) for name, ratio in ratios.items()})
    # What WCAG 2.1 asks of graphics.
    assert min(ratios.values()) >= 3.0


@pytest.mark.parametrize("seen", [np.asarray, deuteranope], ids=["all cones", "deuteranopia"])
def test_colours_differ_from_each_other_and_from_the_depth_below_them(
    seen: Callable[[AnyColor], ByteArray],
) -> None:
    colors = {name: seen(color_of(name)) for name in NAMES}
    colors["middle depth"] = seen(color_map("cividis")[128])
    differences = {
        pair: difference(colors[pair[0]], colors[pair[1]]) for pair in combinations(colors, 2)
    }
    for pair in sorted(differences, key=differences.__getitem__):
        print(f"{differences[pair]:5.1f}  {pair[0]}, {pair[1]}")
    # With four classes and two sensors at this contrast, the best that a search found is 24.
    assert min(differences.values()) >= 22.0
