"""The sample under the pointer, which every view of the page lights up."""

from dataclasses import dataclass
from typing import Literal

Source = Literal["depth", "similarity", "profile", "time", "scene"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Hover:
    """What the pointer is on; what the view that it is on does not know is None.

    ``source``: that view, None where the pointer is on none. ``beam``: index in the scan; ``row``,
    ``column``: of the upright depth image; ``u`` (samples), ``v`` (row): an offset in the
    similarity field; ``frame_index``: of a frame of the recording.
    """

    source: Source | None = None
    beam: int | None = None
    row: int | None = None
    column: int | None = None
    u: float | None = None
    v: float | None = None
    frame_index: int | None = None
