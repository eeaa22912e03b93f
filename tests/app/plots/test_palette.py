"""One colour for each class, and colour maps whose lightness rises: told apart without hue."""

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from scanloom.plots.palette import class_color, class_colors, color_map, color_of
from scanloom.resources import palette


@pytest.mark.parametrize("noise", NoiseClass)
def test_a_class_has_the_colour_of_the_palette_file(noise: NoiseClass) -> None:
    hexadecimal = "#{:02X}{:02X}{:02X}".format(*class_color(noise))
    assert hexadecimal == palette()[noise.name.lower()]
    assert tuple(class_colors()[noise]) == class_color(noise)


def test_a_sensor_has_the_colour_of_the_palette_file() -> None:
    assert color_of("lidar") == (0xE6, 0x9F, 0x00)


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
