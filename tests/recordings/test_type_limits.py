"""Excessive definitions are refused before they take memory or time, and lose their topic."""

import pytest

from fusion_core.recordings.containers import Channel
from fusion_core.recordings.messages.types import UnreadableType, require_type_store

LINE = "=" * 80 + "\n"
NOTHING = LINE + "MSG: std_msgs/Empty\n"


def chain(length: int) -> str:
    """A type of ``length`` levels."""
    parts = [f"MSG: lab/T{i}\nlab/T{i + 1} next\n" for i in range(1, length - 1)]
    return LINE.join(["lab/T1 next\n", *parts, f"MSG: lab/T{length - 1}\nint8 x\n"])


def store(definition: str) -> object:
    return require_type_store(
        Channel(topic="/t", message_type="lab/msg/T", serialization="ros1", definition=definition)
    )


@pytest.mark.parametrize(
    "definition",
    [
        "lab/T t\n",
        f"lab/U u\n{LINE}MSG: lab/U\nlab/T[] t\n",
        chain(33),
        "string[4000000000] names\n",
        "float64[4000000000] values\n",
        f"lab/U[1000] u\n{LINE}MSG: lab/U\nlab/V[1000] v\n{LINE}MSG: lab/V\nint8 x\n",
        f"std_msgs/Empty[] nothing\n{NOTHING}",
        f"std_msgs/Empty[4000000000] nothing\n{NOTHING}",
    ],
)
def test_definitions_beyond_the_limits(definition: str) -> None:
    with pytest.raises(UnreadableType, match="out of all bounds"):
        store(definition)


@pytest.mark.parametrize(
    "definition",
    [
        chain(32),
        "string[100] names\nfloat64[36] covariance\nuint8[1048576] image\n",
        f"std_msgs/Empty nothing\n{NOTHING}",
        f"lab/U[] u\n{LINE}MSG: lab/U\nfloat64[3] x\nstring name\n",
    ],
)
def test_definitions_within_the_limits(definition: str) -> None:
    assert store(definition)
