"""What is drawn stands out from what lies behind it, for the colour-blind too."""

from collections.abc import Iterator

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from scanloom.plots.palette import Color, class_color, color_map, color_of
from scanloom.scene.stage_colors import DARK, HOLLOW, LIGHT, OUTLINE, StageColors

# WCAG 2.1 asks for it of graphics.
LEAST_CONTRAST = 3.0
MID_CIVIDIS: Color = tuple(int(value) for value in color_map("cividis")[128])  # type: ignore[assignment]
# Machado et al. 2009, deuteranopia of severity 1, on linear RGB.
DEUTERANOPIA = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)
EYES = {"usual": np.eye(3), "deuteranope": DEUTERANOPIA}


def luminance(color: Color, eye: np.ndarray) -> float:
    srgb = np.array(color) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(eye @ linear, 0.0, 1.0)
    return float(seen @ [0.2126, 0.7152, 0.0722])


def contrast(one: Color, other: Color, eye: np.ndarray) -> float:
    dark, bright = sorted((luminance(one, eye), luminance(other, eye)))
    return (bright + 0.05) / (dark + 0.05)


def grounds() -> Iterator[tuple[str, Color]]:
    yield "light", LIGHT.background
    yield "dark", DARK.background
    yield "surface by depth", MID_CIVIDIS
    for name, colors in (("light", LIGHT), ("dark", DARK)):
        for brightness in colors.surface:
            yield f"muted surface, {name}", (int(brightness),) * 3


OUTLINED: dict[str, Color] = {
    "LiDAR curve": color_of("lidar"),
    "depth at the beams": color_of("depth"),
    "hollow dots": HOLLOW,
    **{noise.name: class_color(noise) for noise in NoiseClass},
}


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
@pytest.mark.parametrize(("ground", "behind"), list(grounds()))
@pytest.mark.parametrize("name", OUTLINED)
def test_a_colour_or_its_outline_stands_out(name, ground, behind, eye):
    best = max(contrast(OUTLINED[name], behind, eye), contrast(OUTLINE, behind, eye))
    assert best >= LEAST_CONTRAST, f"{name} on {ground}: {best:.2f}"


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
@pytest.mark.parametrize("name", OUTLINED)
def test_a_colour_stands_out_from_its_outline(name, eye):
    assert contrast(OUTLINED[name], OUTLINE, eye) >= LEAST_CONTRAST


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES.keys())
@pytest.mark.parametrize("colors", [LIGHT, DARK], ids=["light", "dark"])
def test_what_has_no_outline_stands_out_from_the_ground(colors: StageColors, eye):
    for color in (colors.ink, colors.camera):
        assert contrast(color, colors.background, eye) >= LEAST_CONTRAST


@pytest.mark.parametrize("colors", [LIGHT, DARK], ids=["light", "dark"])
def test_what_helps_only_is_faint_but_seen(colors: StageColors):
    for color in (colors.ray, colors.cell, colors.section):
        assert 1.1 < contrast(color, colors.background, np.eye(3)) < LEAST_CONTRAST
