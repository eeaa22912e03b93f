"""Which keyframes may show the place of the newest one: those that look like it, time after time.

As in ORB-SLAM (2015, §VII-A) a candidate stands for the keyframes that see the same landmarks, and
is believed when the keyframes before the newest one have led to the same group.
"""

from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.place_recognition import PlaceIndex, PlaceSettings
from fusion_core.slam.visual.visual_map import VisualMap

# Keyframes that see the same landmarks and stand together for a place; ORB-SLAM takes ten.
_GROUP_MAX = 10
# The best of the index that are gathered to groups; bounds the time.
_LOOKED_AT_MAX = 30


class LoopCandidateSettings(StageSettings):
    """Candidates for loops."""

    candidates_max: int = setting(3, "Groups of keyframes that are tried", ge=1, le=100)
    consistent_min: int = setting(
        3,
        "Keyframes in a row that must lead to the same group, the newest counted",
        unit="keyframes",
        ge=1,
        le=100,
    )
    gap_keyframes: int = setting(
        10,
        "Keyframes that must lie between the two of a loop",
        unit="keyframes",
        ge=1,
        le=100_000,
    )
    score_ratio_min: float = setting(
        0.4, "Least score of a group as a part of the best one's", ge=0.0, le=1.0
    )


def group_candidates(
    visual_map: VisualMap,
    index: PlaceIndex,
    features: FrameFeatures,
    excluded: set[int],
    candidates_max: int,
    score_ratio_min: float,
) -> list[tuple[int, set[int]]]:
    """The keyframes most like an image, each the best of its group, with the group.

    A group's score is the sum of its members' (ORB-SLAM 2015, §III-E).
    """
    found = index.query(features.descriptors)
    scores = {
        image: score
        for image, score in zip(found.images.tolist(), found.scores.tolist(), strict=True)
        if image not in excluded and not visual_map.keyframes[image].is_culled
    }
    groups = []
    for image in list(scores)[:_LOOKED_AT_MAX]:
        group = {image, *visual_map.covisible(image)[0][:_GROUP_MAX].tolist()}
        total = sum(scores.get(member, 0.0) for member in group)
        groups.append((total, image, group))
    groups.sort(key=lambda entry: (-entry[0], entry[1]))
    chosen: list[tuple[int, set[int]]] = []
    taken: set[int] = set()
    for total, _, group in groups:
        if len(chosen) == candidates_max or total < score_ratio_min * groups[0][0]:
            break
        best = max(group & scores.keys(), key=lambda member: (scores[member], -member))
        if best not in taken:
            chosen.append((best, group))
            taken |= group
    return chosen


class LoopCandidates:
    """Finds candidates keyframe by keyframe."""

    def __init__(
        self, visual_map: VisualMap, places: PlaceSettings, settings: LoopCandidateSettings
    ) -> None:
        self._map, self._settings = visual_map, settings
        self.index = PlaceIndex(places)
        # The groups of the last keyframe, and how many keyframes in a row have led to each.
        self._groups: list[tuple[set[int], int]] = []

    def add(self, keyframe: int) -> list[int]:
        """Candidates for a keyframe, best first; then it is itself in the index, and what has been
        culled is not."""
        for image in self.index.images:
            if self._map.keyframes[image].is_culled:
                self.index.remove(image)
        features = self._map.keyframes[keyframe].features
        near = set(range(keyframe - self._settings.gap_keyframes, keyframe))
        excluded = near | set(self._map.covisible(keyframe)[0].tolist())
        groups = group_candidates(
            self._map,
            self.index,
            features,
            excluded,
            self._settings.candidates_max,
            self._settings.score_ratio_min,
        )
        self.index.add(keyframe, features.descriptors)
        counted = []
        for best, group in groups:
            before = [count for other, count in self._groups if other & group]
            counted.append((best, group, 1 + max(before, default=0)))
        self._groups = [(group, count) for _, group, count in counted]
        return [best for best, _, count in counted if count >= self._settings.consistent_min]

    def clear_groups(self) -> None:
        """Forget what earlier keyframes have led to: a loop was closed."""
        self._groups = []
