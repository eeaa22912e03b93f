"""The layers of the scene that can be hidden."""

from typing import Literal, get_args

Layer = Literal["rows", "matched", "curve", "pairs", "repairs", "camera", "floor", "map", "images"]
LAYERS: tuple[Layer, ...] = get_args(Layer)
