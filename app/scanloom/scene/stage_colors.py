"""The colours of the scene that are no sensor's and no class's, on a light and a dark ground."""

from dataclasses import dataclass

from scanloom.plots.palette import Color, color_of

# The edge of whatever has a colour of its own. On a bright surface the edge stands out, on a dark
# ground the colour itself does.
OUTLINE: Color = (20, 24, 31)
# The inside of hollow shapes, for both grounds: a shape must look the same on both.
HOLLOW: Color = (255, 255, 255)


@dataclass(frozen=True, slots=True, kw_only=True)
class StageColors:
    """Colours on one ground. ``background``: the browser's own, which the scene does not set.

    ``ink``: lines that are read (the trajectory, the marked beam). ``camera``: the frustum.
    ``surface``: least and greatest brightness of the depth surface under the classes.
    """

    background: Color
    ink: Color
    camera: Color
    ray: Color
    row: Color
    cell: Color
    section: Color
    lidar_body: Color
    surface: tuple[float, float]


LIGHT = StageColors(
    background=(255, 255, 255),
    ink=(20, 24, 31),
    camera=color_of("depth"),
    ray=(222, 190, 118),
    row=(90, 100, 114),
    cell=(232, 234, 238),
    section=(206, 211, 217),
    lidar_body=(52, 56, 62),
    surface=(150.0, 214.0),
)
DARK = StageColors(
    background=(20, 20, 20),
    ink=(240, 243, 247),
    camera=(86, 170, 226),
    ray=(120, 92, 34),
    row=(176, 184, 194),
    cell=(42, 45, 50),
    section=(64, 69, 76),
    lidar_body=(150, 156, 164),
    surface=(108.0, 170.0),
)


def stage_colors(is_dark: bool) -> StageColors:
    """The colours of the scene on a light or a dark ground."""
    return DARK if is_dark else LIGHT
