"""What of the scene can be shown and hidden."""

from typing import Literal, get_args

Layer = Literal["rows", "matched", "curve", "pairs", "repairs", "camera", "floor", "map", "boards"]
LAYERS: tuple[Layer, ...] = get_args(Layer)
