"""What a person chooses of the review: which runs, in which order, and what is told of them."""

from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import Label

QueueOrder = Literal["time", "least confident", "disagreement"]
QUEUE_ORDERS: tuple[QueueOrder, ...] = get_args(QueueOrder)
QueueSensor = Literal["both", "lidar", "depth"]
QUEUE_SENSORS: tuple[QueueSensor, ...] = get_args(QueueSensor)
Tool = Literal["point", "box", "brush"]
TOOLS: tuple[Tool, ...] = get_args(Tool)
Answer = Label | Literal["accept", "reject", "clear"]
"""What a person says: a label, that the automatic class is right or wrong, or no label."""
NOISE = frozenset(NoiseClass) - {NoiseClass.GOOD}
# A layer's name is as long at most.
_MAX_LAYER_CHARACTERS = 80


class ReviewChoices(BaseModel):
    """How one browser reviews. ``gold_layer``: its labels are the known answers that are mixed in,
    empty for none."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    order: QueueOrder = "time"
    classes: frozenset[NoiseClass] = NOISE
    sensor: QueueSensor = "both"
    only_open: bool = Field(True, description="Only runs that are not labelled yet")
    auto_advance: bool = Field(True, description="Go to the next run after each answer")
    blind: bool = Field(False, description="Hide the automatic classes")
    gold_layer: str = Field("", max_length=_MAX_LAYER_CHARACTERS)
    tool: Tool = "point"
    brush_px: int = Field(6, ge=1, le=100, description="Radius of the brush, in pixels")
