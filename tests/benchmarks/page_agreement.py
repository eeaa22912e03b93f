"""Whether all views of a page show one frame: told by the content of the messages alone.

First every frame is shown for itself, and what each part of the page holds is remembered. While
frames are played, each batch of messages, which a page applies between two of its pictures, then
tells which frame every part shows.
"""

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from tests.app.viser_client import Received

# A part of the page: a widget's or a node's property.
Part = tuple[str, str]
# Set by the person, or kept by the browser, and not drawn.
_NO_PARTS = {"value", "disabled", "visible"}


def parts_of(received: Received) -> Iterator[tuple[Part, bytes]]:
    """The parts of the page that a message sets, and a digest of what they hold then."""
    message = received.message
    if received.type in ("GuiUpdateMessage", "SceneNodeUpdateMessage"):
        whose = str(message.get("uuid") or message.get("name"))
        for name, value in message["updates"].items():
            if name not in _NO_PARTS:
                yield (whose, name), _digest(value)
    elif "name" in message and "props" in message:
        # A node that is drawn anew.
        yield (str(message["name"]), received.type), _digest(message["props"])


def _visibility(received: Received) -> tuple[str, bool | None]:
    """Whose visibility a message sets, and to what; None for neither."""
    message = received.message
    if received.type == "SetSceneNodeVisibilityMessage":
        return str(message["name"]), bool(message["visible"])
    whose = str(message.get("uuid") or message.get("name"))
    values = message.get("updates") or message.get("props") or {}
    visible = values.get("visible") if isinstance(values, Mapping) else None
    return whose, visible


def _digest(value: Any) -> bytes:
    digest = hashlib.blake2b(digest_size=12)

    def add(inner: Any) -> None:
        if isinstance(inner, Mapping):
            for name in sorted(inner):
                digest.update(str(name).encode())
                add(inner[name])
        elif isinstance(inner, np.ndarray):
            digest.update(inner.tobytes())
        elif isinstance(inner, bytes):
            digest.update(inner)
        elif isinstance(inner, list | tuple):
            for one in inner:
                add(one)
        else:
            digest.update(repr(inner).encode())

    add(value)
    return digest.digest()


@dataclass(frozen=True, slots=True)
class Agreement:
    """``batches`` with another frame than before, ``parts`` of the page that changed with the
    frames, ``worst``: the greatest difference of frame numbers that were seen at one time,
    ``most_bytes`` and ``most_messages`` of one batch; ``frames``: those that were seen, in order.
    """

    batches: int
    parts: int
    worst: int
    most_bytes: int
    most_messages: int
    frames: tuple[int, ...]


class PageContent:
    """What the parts of a page hold in each frame."""

    def __init__(self) -> None:
        self._now: dict[Part, bytes] = {}
        # Widgets and nodes; what they hold is not seen.
        self._hidden: set[str] = set()
        self._frames: dict[tuple[Part, bytes], set[int]] = defaultdict(set)

    def learn(self, received: Iterable[Received], frame_index: int) -> None:
        """All that was received until one frame was shown completely."""
        self.take(received)
        for part, digest in self._now.items():
            if part[0] not in self._hidden:
                self._frames[part, digest].add(frame_index)

    def judge(self, received: Iterable[Received]) -> Agreement:
        """What was received while frames were played."""
        telling = self._telling_parts()
        worst = most_bytes = most_messages = 0
        frames: list[int] = []
        for _, batch in groupby(received, key=lambda one: one.arrived_s):
            messages = list(batch)
            changed = {part for one in messages for part, _ in parts_of(one)} & telling
            self.take(messages)
            if not changed:
                continue
            most_bytes = max(most_bytes, messages[0].bytes)
            most_messages = max(most_messages, len(messages))
            shown = [
                known
                for part in telling
                if part[0] not in self._hidden
                and (known := self._frames.get((part, self._now[part])))
            ]
            if not shown:
                continue
            common = set.intersection(*shown)
            if common:
                frames.append(min(common))
                continue
            certain = [next(iter(known)) for known in shown if len(known) == 1]
            worst = max(worst, max(certain, default=1) - min(certain, default=0))
            frames.append(max(certain, default=-1))
        distinct = tuple(a for a, _ in groupby(frames))
        return Agreement(
            batches=len(frames),
            parts=len(telling),
            worst=worst,
            most_bytes=most_bytes,
            most_messages=most_messages,
            frames=distinct,
        )

    def take(self, received: Iterable[Received]) -> None:
        """What was received while nobody looked: nothing is learned and nothing judged."""
        for one in received:
            self._now.update(parts_of(one))
            whose, is_visible = _visibility(one)
            if is_visible is True:
                self._hidden.discard(whose)
            elif is_visible is False:
                self._hidden.add(whose)

    def _telling_parts(self) -> set[Part]:
        """Parts whose content tells the frame: it was another one in most of them."""
        contents: dict[Part, int] = defaultdict(int)
        frames: set[int] = set()
        for (part, _), of in self._frames.items():
            contents[part] += 1
            frames |= of
        return {part for part, count in contents.items() if count > 0.5 * len(frames)}
