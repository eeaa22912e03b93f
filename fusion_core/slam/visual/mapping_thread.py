"""What tracking does not wait for: local mapping and loop closing of the newest keyframe.

ORB-SLAM2 gives each of the two a thread of its own, and what tracking sees of them depends on the
machine's speed. Here they follow each other on one, and tracking takes over what they have made of
a keyframe when it decides to: the result is the same with a second thread and without one.
"""

from concurrent.futures import Executor, Future

import numpy as np

from fusion_core.model.conventions import IntArray
from fusion_core.slam.visual.local_mapping import LocalMapping
from fusion_core.slam.visual.loop_closing import LoopCloser
from fusion_core.slam.visual.stage_times import StageTimes
from fusion_core.slam.visual.visual_map import VisualMap

# Rows of culled landmarks are given back once they are more than this part.
_CULLED_MAX = 0.5


class MappingThread:
    """Maps one keyframe at a time. ``is_running``: from its start until its results are awaited;
    meanwhile nothing else may change the map."""

    def __init__(
        self,
        visual_map: VisualMap,
        mapping: LocalMapping,
        loops: LoopCloser,
        times: StageTimes,
        executor: Executor | None,
    ) -> None:
        self._map, self._mapping, self._loops = visual_map, mapping, loops
        self._times, self._executor = times, executor
        self._job: Future[None] | None = None
        self.is_running = False

    def start(self, keyframe: int, made: tuple[int, int]) -> None:
        """Map a new keyframe that has made the landmarks ``made[0]`` to ``made[1]`` - 1."""
        self.is_running = True
        if self._executor is None:
            self._map_keyframe(keyframe, made)
        else:
            self._job = self._executor.submit(self._map_keyframe, keyframe, made)

    def _map_keyframe(self, keyframe: int, made: tuple[int, int]) -> None:
        with self._times.measure("mapping"):
            self._mapping.include(self._map, keyframe, made)
            self._loops.add(keyframe)

    def wait(self) -> None:
        """Until the keyframe is mapped; raises what mapping raised."""
        if self._job is not None:
            self._job.result()
        self._job, self.is_running = None, False

    def drop_culled_landmarks(self) -> IntArray | None:
        """Give the rows of culled landmarks back, unless most are kept: their new rows, by
        ``VisualMap.drop_culled_landmarks``. Not while it runs."""
        is_culled = self._map.is_landmark_culled
        if np.count_nonzero(is_culled) <= _CULLED_MAX * len(is_culled):
            return None
        rows = self._map.drop_culled_landmarks()
        self._mapping.follow_rows(rows)
        return rows
