"""What a test recording is: a file, and the messages that reading it must give."""

from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path

import numpy as np

from fusion_core.model.sensors import SensorValue, TransformBatch

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


@dataclass(frozen=True)
class Written:
    """A message as it goes into a file, in the order of writing."""

    topic: str
    received_ns: int
    value: SensorValue

    @property
    def stamp_ns(self) -> int:
        if isinstance(self.value, TransformBatch):
            return self.value.transforms[0].stamp_ns
        return self.value.stamp_ns


@dataclass(frozen=True)
class Sample:
    """A file and what must come out of it. ``received`` is None where a format has no log.

    ``nominal``: the format has no clock, and its stamps are made from frame numbers.
    ``warnings``: what reading all of it must say.
    """

    path: Path
    written: list[Written]
    has_log: bool = True
    types: dict[str, str] = field(default_factory=dict)
    nominal: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def expected(self) -> list[Written]:
        return sorted(self.written, key=lambda message: message.received_ns)


def same(a: object, b: object) -> bool:
    """Equality of frozen values that hold arrays; NaN equals NaN."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape:
            return False
        if a.shape == (4, 4):
            # A pose through a quaternion keeps its numbers to rounding.
            return np.allclose(a, b, rtol=0.0, atol=1e-12)
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if is_dataclass(a) and type(a) is type(b):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b
