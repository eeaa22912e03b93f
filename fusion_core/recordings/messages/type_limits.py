"""Limits on the message types that a file defines, against hostile definitions.

Code is generated for each type, in proportion to its fixed arrays of strings and messages. A
sequence of elements without content could claim any length.
"""

from typing import NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.serde.utils import SIZEMAP

# Set by hand, above the types of real recordings.
_MAX_NESTING = 32
_MAX_ELEMENTS = 100_000
_MAX_FIXED_BYTES = 1 << 26
_COUNT_BYTES = 4
_NO_FIELDS = "structure_needs_at_least_one_member"


class ExcessiveType(ValueError):
    """A type larger than any in a real recording."""


class _Size(NamedTuple):
    """Minimum size of each message of a type; ``elements`` are read one by one."""

    elements: int
    size_bytes: int
    nesting: int


def require_bounded_type(types: Typesdict, name: str) -> None:
    """Raise ExcessiveType for a type beyond the limits, KeyError if a nested type is missing."""
    _measure(types, name, {}, 0)


def _measure(types: Typesdict, name: str, known: dict[str, _Size], depth: int) -> _Size:
    # A recursive type has infinite depth.
    if depth > _MAX_NESTING:
        raise ExcessiveType(f"{name} is nested more than {_MAX_NESTING} deep")
    if name not in known:
        _, fields = types[name]
        sizes = [
            _field_size(types, field, known, depth)
            for label, field in fields
            if label != _NO_FIELDS
        ]
        size = _Size(
            elements=sum(size.elements for size in sizes),
            size_bytes=sum(size.size_bytes for size in sizes),
            nesting=1 + max((size.nesting for size in sizes), default=0),
        )
        if (
            size.elements > _MAX_ELEMENTS
            or size.size_bytes > _MAX_FIXED_BYTES
            or size.nesting > _MAX_NESTING
        ):
            raise ExcessiveType(
                f"{name} has {size.elements} elements, {size.size_bytes} bytes, {size.nesting} deep"
            )
        known[name] = size
    return known[name]


def _field_size(types: Typesdict, field: FieldDesc, known: dict[str, _Size], depth: int) -> _Size:
    if field[0] == Nodetype.NAME:
        return _measure(types, field[1], known, depth + 1)
    if field[0] == Nodetype.BASE:
        name, _ = field[1]
        return _Size(1, _COUNT_BYTES if name == "string" else SIZEMAP[name], 0)
    element_field, count = field[1]
    element = _field_size(types, element_field, known, depth)
    if field[0] == Nodetype.SEQUENCE:
        if element.size_bytes == 0:
            raise ExcessiveType("an array has elements without content")
        return _Size(1, _COUNT_BYTES, element.nesting)
    in_one_piece = element_field[0] == Nodetype.BASE and element_field[1][0] != "string"
    elements = 1 if in_one_piece else count * max(element.elements, 1)
    return _Size(elements, count * element.size_bytes, element.nesting)
