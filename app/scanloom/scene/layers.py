"""The layers of the scene: what each shows, and in which steps."""

from dataclasses import dataclass

from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.state.view import PANELS, Layer, PanelName


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerInfo:
    """A layer of the scene. ``steps``: those that show it unless it is switched off."""

    label: str
    help: str
    steps: frozenset[PanelName]


def _layer(label: str, text: str, *steps: PanelName) -> LayerInfo:
    return LayerInfo(label=label, help=text, steps=frozenset(steps or PANELS))


LAYERS: dict[Layer, LayerInfo] = {
    "surface": _layer(
        "Depth surface",
        "What the depth camera measures, in the colours of its colour image where it has one, "
        "else dark where near and bright where far",
        "Recording",
        "Match",
        "Register",
        "Repair",
        "Review",
        "Calibrate",
    ),
    "curve": _layer(
        "LiDAR curve",
        "The ends of the LiDAR's beams, joined; broken where there is no return",
    ),
    "rays": _layer("LiDAR beams", "Some of the beams, from the LiDAR", "Recording", "Match"),
    "matched": _layer(
        "Depth at the beams",
        "What the depth camera measures where the LiDAR's beams end: compared with the LiDAR curve",
        "Match",
        "Register",
    ),
    "rows": _layer("Image rows", "Every k-th row of the depth image, in space", "Match"),
    "pairs": _layer(
        "Pairs", "From the end of each beam to the point that the camera measures there", "Register"
    ),
    "classes": _layer(
        "Classes",
        "Good, hole, burr or conflict, standing where the beam ends. Hole: a sensor has no value. "
        "Burr: a value that lies on no surface. Conflict: the sensors see different surfaces",
        "Repair",
        "Review",
    ),
    "repairs": _layer(
        "Repairs",
        "Arrows from a value to its repair; hollow dots where a value was missing",
        "Repair",
    ),
    "sensors": _layer(
        "Sensors",
        "The LiDAR, and the depth camera with its field of view",
        "Recording",
        "Map",
        "Calibrate",
    ),
    "labels": _layer("Labels", "What is what", "Match", "Register", "Repair", "Review"),
    "floor": _layer(
        "Floor grid",
        "Squares of 1 m at the height of the lowest point seen",
        "Recording",
        "Match",
        "Register",
        "Repair",
        "Review",
        "Calibrate",
    ),
    "map": _layer("Map", "The map, at the height of the LiDAR, and the trajectory", "Map"),
    "cloud": _layer(
        "Cloud",
        "What visual SLAM has mapped, in its own colours, or as boxes of its octree. At most "
        "200,000 points are sent at a time, most of them where you look",
        "Map",
    ),
    "keyframes": _layer(
        "Keyframes",
        "Where the camera was when it saw something new; click one to see its image",
        "Map",
    ),
    "loops": _layer("Loops", "Lines between keyframes that have seen the same place again", "Map"),
}
OF_VISUAL_MAP: frozenset[Layer] = frozenset({"map", "cloud", "keyframes", "loops"})
"""What is shown of a map of visual SLAM, instead of the frame."""


# What only a depth camera, and what only a LiDAR gives.
_OF_CAMERA: frozenset[Layer] = frozenset(
    {"surface", "rows", "matched", "pairs", "classes", "repairs"}
)
_OF_LIDAR: frozenset[Layer] = frozenset({"curve", "rays", "matched", "pairs"})
_OF_VISUAL_ALONE = OF_VISUAL_MAP - {"map"}


def absent_layers(frame: FrameGeometry) -> frozenset[Layer]:
    """The layers that a recording has nothing for, by one of its frames."""
    absent = _OF_VISUAL_ALONE
    if frame.frustum is None:
        absent |= _OF_CAMERA
    return absent if frame.body == "LiDAR" else absent | _OF_LIDAR


def layers_of_step(step: PanelName, hidden: frozenset[Layer]) -> frozenset[Layer]:
    """The layers that a step shows, without those that are switched off."""
    return frozenset(name for name, info in LAYERS.items() if step in info.steps) - hidden
