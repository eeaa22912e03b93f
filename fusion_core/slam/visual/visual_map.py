"""The map of visual SLAM: keyframes with ORB features, and the landmarks that they see.

Landmarks are held as columns of arrays, one row each; a feature points to its landmark by row.
Numbers of keyframes stay what they are: what is culled is marked, not moved. So it is with
landmarks until ``VisualMap.drop_culled_landmarks``.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from fusion_core.model.conventions import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.geometry import invert_transform
from fusion_core.slam.visual.frame_features import FrameFeatures, no_features
from fusion_core.slam.visual.keyframes import NO_LANDMARK, DepthAlignment, Keyframe, LoopClosure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """O sightings of landmarks: of ``keyframes[o]`` by its feature ``features[o]``.

    ``keyframes``, ``features``, ``landmarks``: (O,), ordered by keyframe, then by feature.
    ``pixels``: (O, 2). ``depths_m``: (O,), NaN where missing. ``octaves``: (O,).
    """

    keyframes: IntArray
    features: IntArray
    landmarks: IntArray
    pixels: FloatArray
    depths_m: FloatArray
    octaves: IntArray

    def __post_init__(self) -> None:
        for array in (
            self.keyframes,
            self.features,
            self.landmarks,
            self.pixels,
            self.depths_m,
            self.octaves,
        ):
            read_only(array)

    def __len__(self) -> int:
        return len(self.landmarks)


@dataclass(slots=True, eq=False)
class VisualMap:
    """Keyframes and landmarks.

    ``positions_in_map_m``: (M, 3) of the landmarks. ``landmark_descriptors``: (M, 32).
    ``is_landmark_culled``: (M,). ``expected_counts``, ``found_counts``: (M,) how many new keyframes
    should have shown each by their poses, and how many did. ``loops``: in the order in which they
    were closed. Which feature sees which landmark is changed by the methods alone.
    """

    keyframes: list[Keyframe] = field(default_factory=list)
    loops: list[LoopClosure] = field(default_factory=list)
    alignments: list[DepthAlignment] = field(default_factory=list)
    # With room for more rows than are used: rows are appended often.
    _positions: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    _descriptors: ByteArray = field(default_factory=lambda: np.empty((0, 32), np.uint8))
    _is_culled: BoolArray = field(default_factory=lambda: np.empty(0, np.bool_))
    _expected: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    _found: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    # Of each landmark: the feature by which each keyframe sees it.
    _observers: list[dict[int, int]] = field(default_factory=list)

    @property
    def positions_in_map_m(self) -> FloatArray:
        """(M, 3) of the landmarks, a view: writing to it moves them."""
        return self._positions[: len(self._observers)]

    @property
    def landmark_descriptors(self) -> ByteArray:
        """(M, 32), a view: writing to it changes them."""
        return self._descriptors[: len(self._observers)]

    @property
    def is_landmark_culled(self) -> BoolArray:
        """(M,), a view."""
        return self._is_culled[: len(self._observers)]

    @property
    def expected_counts(self) -> IntArray:
        """(M,), a view: writing to it changes them."""
        return self._expected[: len(self._observers)]

    @property
    def found_counts(self) -> IntArray:
        """(M,), a view: writing to it changes them."""
        return self._found[: len(self._observers)]

    @property
    def kept_keyframes(self) -> list[Keyframe]:
        """Those that are not culled, in order."""
        return [keyframe for keyframe in self.keyframes if not keyframe.is_culled]

    def add_keyframe(
        self,
        stamp_ns: int,
        features: FrameFeatures,
        T_map_camera: FloatArray,
        landmarks: IntArray,
        parent: int | None = None,
        reduced_depth_m: Float32Array | None = None,
    ) -> Keyframe:
        """A new keyframe whose features see ``landmarks``, (F,) with NO_LANDMARK for none.

        Where two features are given one landmark, the first keeps it.
        """
        keyframe = Keyframe(
            index=len(self.keyframes),
            stamp_ns=stamp_ns,
            features=features,
            T_map_camera=np.array(T_map_camera, dtype=np.float64),
            landmarks=np.full(len(features), NO_LANDMARK, dtype=np.int64),
            parent=parent,
            reduced_depth_m=reduced_depth_m,
        )
        self.keyframes.append(keyframe)
        seen = np.flatnonzero(landmarks != NO_LANDMARK)
        self.observe(keyframe.index, seen, landmarks[seen])
        return keyframe

    def add_landmarks(self, positions_in_map_m: FloatArray, descriptors: ByteArray) -> IntArray:
        """(N,) rows of N new landmarks, which no keyframe sees yet; (N, 3) and (N, 32)."""
        first, count = len(self._observers), len(positions_in_map_m)
        rows = np.arange(first, first + count)
        if first + count > len(self._positions):
            room = max(1024, 2 * len(self._positions), first + count) - len(self._positions)
            self._positions = np.concatenate([self._positions, np.zeros((room, 3))])
            self._descriptors = np.concatenate([self._descriptors, np.zeros((room, 32), np.uint8)])
            self._is_culled = np.concatenate([self._is_culled, np.zeros(room, np.bool_)])
            self._expected = np.concatenate([self._expected, np.zeros(room, np.int64)])
            self._found = np.concatenate([self._found, np.zeros(room, np.int64)])
        self._positions[rows] = positions_in_map_m
        self._descriptors[rows] = descriptors
        self._observers += [{} for _ in range(count)]
        return rows

    def observe(self, keyframe: int, features: IntArray, landmarks: IntArray) -> None:
        """Let features, (N,), of a keyframe see landmarks, (N,).

        A feature that sees another landmark leaves it; a landmark that the keyframe sees by another
        feature keeps that one.
        """
        row = self.keyframes[keyframe].landmarks
        for feature, landmark in zip(features.tolist(), landmarks.tolist(), strict=True):
            observers = self._observers[landmark]
            if keyframe in observers or self._is_culled[landmark]:
                continue
            if row[feature] != NO_LANDMARK:
                self._observers[row[feature]].pop(keyframe, None)
            row[feature] = landmark
            observers[keyframe] = feature

    def forget(self, keyframe: int, features: IntArray) -> None:
        """Let features, (N,), of a keyframe see nothing; a landmark that nobody sees is culled."""
        row = self.keyframes[keyframe].landmarks
        for feature in features.tolist():
            landmark = int(row[feature])
            if landmark == NO_LANDMARK:
                continue
            row[feature] = NO_LANDMARK
            self._observers[landmark].pop(keyframe, None)
            if not self._observers[landmark]:
                self._is_culled[landmark] = True

    def observers_of(self, landmark: int) -> dict[int, int]:
        """The feature by which each keyframe sees it."""
        return dict(self._observers[landmark])

    def observer_counts(self, landmarks: IntArray) -> IntArray:
        """(N,) how many keyframes see each of (N,) landmarks."""
        observers = self._observers
        return np.array([len(observers[row]) for row in landmarks.tolist()], dtype=np.int64)

    def landmarks_of(self, keyframes: Iterable[int]) -> IntArray:
        """(L,) the landmarks that any of the keyframes sees, ascending."""
        rows = [self.keyframes[index].landmarks for index in keyframes]
        if not rows:
            return np.empty(0, np.int64)
        seen: IntArray = np.unique(np.concatenate(rows))
        kept: IntArray = seen[seen != NO_LANDMARK]
        return kept

    def covisible(self, keyframe: int, shared_min: int = 15) -> tuple[IntArray, IntArray]:
        """(C,) the keyframes that share at least ``shared_min`` landmarks with one, most first,
        and (C,) how many. ORB-SLAM2 takes 15."""
        row = self.keyframes[keyframe].landmarks
        return self._most_sharing(row[row != NO_LANDMARK], shared_min, keyframe)

    def sharing(self, landmarks: IntArray, shared_min: int = 1) -> tuple[IntArray, IntArray]:
        """(C,) the keyframes that see at least ``shared_min`` of (N,) landmarks, most first, and
        (C,) how many."""
        return self._most_sharing(landmarks, shared_min, None)

    def _most_sharing(
        self, landmarks: IntArray, shared_min: int, without: int | None
    ) -> tuple[IntArray, IntArray]:
        observers = self._observers
        counts = Counter(chain.from_iterable(observers[row] for row in landmarks.tolist()))
        if without is not None:
            counts.pop(without, None)
        # Of equal counts the newer keyframe first, so that the order is one and the same.
        ordered = sorted(
            ((count, index) for index, count in counts.items() if count >= shared_min),
            reverse=True,
        )
        return (
            np.array([index for _, index in ordered], dtype=np.int64),
            np.array([count for count, _ in ordered], dtype=np.int64),
        )

    def observations(self, keyframes: Iterable[int] | None = None) -> Observations:
        """The sightings by some keyframes, or by all that are kept."""
        if keyframes is None:
            keyframes = [keyframe.index for keyframe in self.kept_keyframes]
        indices = sorted(keyframes)
        seen = [np.flatnonzero(self.keyframes[i].landmarks != NO_LANDMARK) for i in indices]
        of = [(self.keyframes[i], rows) for i, rows in zip(indices, seen, strict=True)]
        if not of:
            none = np.empty(0, np.int64)
            return Observations(
                keyframes=none,
                features=none,
                landmarks=none,
                pixels=np.empty((0, 2)),
                depths_m=np.empty(0),
                octaves=none,
            )
        return Observations(
            keyframes=np.concatenate([np.full(len(rows), k.index) for k, rows in of]),
            features=np.concatenate(seen),
            landmarks=np.concatenate([k.landmarks[rows] for k, rows in of]),
            pixels=np.concatenate([k.features.pixels[rows] for k, rows in of]),
            depths_m=np.concatenate([k.features.depths_m[rows] for k, rows in of]),
            octaves=np.concatenate([k.features.octaves[rows] for k, rows in of]),
        )

    def alignments_between(self, keyframes: IntArray) -> tuple[DepthAlignment, ...]:
        """Those of (K,) keyframes, ascending, with each other; by their places among them."""
        place = {index: k for k, index in enumerate(keyframes.tolist())}
        return tuple(
            replace(a, first=place[a.first], second=place[a.second])
            for a in self.alignments
            if a.first in place and a.second in place
        )

    def merge_landmarks(self, kept: int, merged: int) -> None:
        """Let what sees ``merged`` see ``kept``; ``merged`` is culled.

        Nothing, if they are one, or if either is culled already.
        """
        if kept == merged or self._is_culled[kept] or self._is_culled[merged]:
            return
        for keyframe, feature in self._observers[merged].items():
            row = self.keyframes[keyframe].landmarks
            if keyframe in self._observers[kept]:
                row[feature] = NO_LANDMARK
            else:
                row[feature] = kept
                self._observers[kept][keyframe] = feature
        self._observers[merged] = {}
        self._is_culled[merged] = True

    def cull_landmarks(self, landmarks: IntArray) -> None:
        """Let no feature see (N,) landmarks any more."""
        for landmark in landmarks.tolist():
            for keyframe, feature in self._observers[landmark].items():
                self.keyframes[keyframe].landmarks[feature] = NO_LANDMARK
            self._observers[landmark] = {}
            self._is_culled[landmark] = True

    def drop_culled_landmarks(self) -> IntArray:
        """Give the memory of culled landmarks back; the others close up in their order.

        (M + 1,) the new row of each former one, NO_LANDMARK for a culled one. The last is
        NO_LANDMARK too, so that what saw nothing still does.
        """
        kept = np.flatnonzero(~self.is_landmark_culled)
        rows = np.full(len(self._observers) + 1, NO_LANDMARK, np.int64)
        rows[kept] = np.arange(len(kept))
        self._positions, self._descriptors = self._positions[kept], self._descriptors[kept]
        self._expected, self._found = self._expected[kept], self._found[kept]
        self._is_culled = np.zeros(len(kept), np.bool_)
        self._observers = [self._observers[row] for row in kept.tolist()]
        for keyframe in self.keyframes:
            keyframe.landmarks = rows[keyframe.landmarks]
        return rows

    def cull_keyframe(self, index: int) -> None:
        """Leave out a keyframe that has a parent; its children go to that parent."""
        keyframe = self.keyframes[index]
        if keyframe.is_culled:
            return
        if keyframe.parent is None:
            raise ValueError("the first keyframe of a map cannot be culled")
        self.forget(index, np.flatnonzero(keyframe.landmarks != NO_LANDMARK))
        T_parent_map = invert_transform(self.keyframes[keyframe.parent].T_map_camera)
        keyframe.T_parent_camera = T_parent_map @ keyframe.T_map_camera
        keyframe.is_culled = True
        keyframe.features, keyframe.reduced_depth_m = no_features(), None
        keyframe.landmarks = np.empty(0, np.int64)
        self.alignments = [a for a in self.alignments if index not in (a.first, a.second)]
        for child in self.keyframes:
            if child.parent == index:
                child.parent = keyframe.parent
                if child.T_parent_camera is not None:
                    child.T_parent_camera = keyframe.T_parent_camera @ child.T_parent_camera

    def pose_of(self, index: int) -> FloatArray:
        """(4, 4) T_map_camera of a keyframe; of a culled one as its parent carries it."""
        keyframe = self.keyframes[index]
        if keyframe.T_parent_camera is None or keyframe.parent is None:
            return keyframe.T_map_camera
        return self.pose_of(keyframe.parent) @ keyframe.T_parent_camera

    def nearest_keyframe(self, T_map_camera: FloatArray) -> int:
        """The kept keyframe whose camera stands nearest, a radian of turn counted as a metre."""
        kept = self.kept_keyframes
        T_camera_keyframe = invert_transform(T_map_camera) @ np.stack(
            [k.T_map_camera for k in kept]
        )
        cosines = 0.5 * (np.trace(T_camera_keyframe[:, :3, :3], axis1=1, axis2=2) - 1.0)
        far = np.linalg.norm(T_camera_keyframe[:, :3, 3], axis=1)
        far += np.arccos(np.clip(cosines, -1, 1))
        return kept[int(np.argmin(far))].index
