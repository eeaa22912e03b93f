"""The descriptor by which a landmark is looked for: that of the view most like all others."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import IntArray
from fusion_core.slam.visual.projection_matching import descriptor_words, hamming
from fusion_core.slam.visual.visual_map import VisualMap

# More views than this add nothing to the choice, whose cost is their number squared.
_VIEWS_MAX = 12


def update_descriptors(visual_map: VisualMap, landmarks: IntArray) -> None:
    """Choose for each of (N,) landmarks the descriptor with the least median distance to those of
    its other views (ORB-SLAM, Mur-Artal 2015, §III-C)."""
    starts, views = [0], []
    for landmark in landmarks.tolist():
        newest = list(visual_map.observers_of(landmark).items())[-_VIEWS_MAX:]
        views += [visual_map.keyframes[k].features.descriptors[f] for k, f in newest]
        starts.append(len(views))
    if not views:
        return
    descriptors = np.stack(views)
    chosen = _most_central(descriptor_words(descriptors), np.array(starts, np.int64))
    known = chosen >= 0
    visual_map.landmark_descriptors[landmarks[known]] = descriptors[chosen[known]]


@compiled(nogil=True)
def _most_central(words: np.ndarray, starts: IntArray) -> IntArray:
    count = len(starts) - 1
    chosen = np.full(count, -1, np.int64)
    for i in range(count):
        first, size = starts[i], starts[i + 1] - starts[i]
        best = 1 << 30
        for a in range(size):
            distances = np.empty(size, np.int64)
            for b in range(size):
                distances[b] = hamming(words[first + a], words[first + b])
            distances.sort()
            median = distances[(size - 1) // 2]
            if median < best:
                best = median
                chosen[i] = first + a
    return chosen
