"""What the views show of the review in the displayed frame: labels, and what is selected."""

from dataclasses import dataclass, fields

from fusion_core.model.conventions import BoolArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReviewOverlay:
    """``beam_labels``: (N,) codes of Label of the scan's beams, NO_LABEL where there is none;
    ``pixel_labels``: (H', W') the same of the upright depth image. ``selected_beams``: (N,) and
    ``selected_pixels``: (H', W'), what the next answer is about. ``is_blind``: whether the
    automatic classes are hidden.
    """

    beam_labels: IntArray
    pixel_labels: IntArray
    selected_beams: BoolArray
    selected_pixels: BoolArray
    is_blind: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "is_blind":
                read_only(getattr(self, field.name))
