"""What holds a scan in its place: the map, or odometry for a while, or nothing.

A scan that fits its submap in one place alone is held. One that fits along a whole corridor is
held by odometry; without any, the length of the corridor is a guess. One that does not fit, or sees
nothing, is carried on by odometry for as long as that is good. When the doubt has grown too far, or
scan after scan contradicts the map, the way is broken: what follows is a map of its own, until a
loop says where it belongs.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray

# After fewer lost scans the next may well fit again.
_LOST_MIN = 3
# Blind, a robot may be so much farther off before it needs a new map.
_BLIND = 3.0


class Hold:
    """Follows scan after scan; ``part`` counts the breaks.

    ``is_told``: odometry told each step since a scan was held by the map.
    """

    def __init__(self, lost_m: float, lost_scans: int) -> None:
        self._lost_m, self._lost_scans = lost_m, lost_scans
        self._doubt = np.zeros(2)
        self._contradicting = 0
        self._lost = 0
        self.part = 0
        self.breaks = False
        self.contradicts = False
        self.is_adrift = False
        self.is_told = True

    @property
    def misses(self) -> int:
        """Scans in a row, up to now, that did not fit."""
        return self._lost

    @property
    def is_doubtful(self) -> bool:
        """Whether something was guessed or missed since a scan was held by the map."""
        return self.is_adrift or bool(self._doubt.any())

    def matched(self, doubt: FloatArray, *, is_held: bool, is_measured: bool) -> None:
        """The scan fits. ``doubt``: (2,) of the step without it, in metres and radians.

        ``is_held``: it fits in one place alone; ``is_measured``: odometry told the step.
        """
        self.breaks = self.contradicts = False
        self._contradicting = self._lost = 0
        if is_held:
            self._doubt[:] = 0.0
            self.is_adrift = False
            self.is_told = True
            return
        self.is_told &= is_measured
        if not is_measured:
            self._doubt[0] += doubt[0]
        self._doubt[1] = 0.0
        self._break_beyond(self._lost_m)

    def missed(self, doubt: FloatArray, *, contradicts: bool, is_measured: bool) -> None:
        """The scan has points and does not fit; ``contradicts``: all of a sudden."""
        self.breaks = False
        self.contradicts = contradicts
        self.is_told &= is_measured
        self._doubt += doubt
        self._lost += 1
        if contradicts:
            self._contradicting += 1
        if self._contradicting >= self._lost_scans:
            self._begin_part()
            self._doubt[:] = 0.0
        elif self._lost >= _LOST_MIN:
            self._break_beyond(self._lost_m)

    def carried(self, doubt: FloatArray, *, is_lost: bool, is_measured: bool) -> None:
        """The scan has no points, or there is no map yet; ``is_lost`` if there was one."""
        self.breaks = self.contradicts = False
        self.is_told &= is_measured
        if is_lost:
            self._doubt += doubt
            # The next that has some finds its place again, unless it is too far from there.
            self._break_beyond(_BLIND * self._lost_m)

    def _break_beyond(self, doubt_max: float) -> None:
        if not self.is_adrift and (self._doubt > doubt_max).any():
            self._begin_part()
            self.is_adrift = True

    def _begin_part(self) -> None:
        self.part += 1
        self.breaks = True
        self.contradicts = False
        self._contradicting = self._lost = 0
