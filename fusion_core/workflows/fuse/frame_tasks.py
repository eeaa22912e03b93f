"""Pass 2 as tasks: the images that are fused together, and what fusing them takes.

A task needs no other task's result and no file, so that it can be done anywhere and in any order.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame, fuse_images
from fusion_core.workflows.fuse.frame_labels import PairLabels, SessionLabels, TaskLabels
from fusion_core.workflows.fuse.match_images import split_into_frames
from fusion_core.workflows.fuse.pairing import ImageGrouper, PairedImage, UprightDepth
from fusion_core.workflows.fuse.session import FrameSetup, Session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameTask:
    """An image, or those of a panorama, with their scan.

    ``images``: one of each camera, all with a scan. ``previous``: the image before of some of the
    cameras, as stored. ``labels``: a person's, by camera, None where there is no layer of them.
    """

    images: tuple[PairedImage, ...]
    previous: dict[int, DepthImage]
    labels: dict[int, PairLabels] | None

    def scan_of(self, camera: int) -> LaserScan:
        """The scan of a camera's image."""
        for image in self.images:
            if image.camera == camera and image.window is not None:
                return image.window.scan
        raise KeyError(camera)


def frame_tasks(
    session: Session,
    alignment: RecordingAlignment,
    clock_offset_ms: float = 0.0,
    labels: SessionLabels | None = None,
) -> Iterator[LaserScan | PairedImage | FrameTask]:
    """A pass over the recording: scans as they arrive, tasks, and images without a scan.

    ``labels``: a person's, which overrule the classes.
    """
    cameras = 1 if alignment.panorama is None else len(session.rig.cameras)
    grouper = ImageGrouper(cameras, session.settings.time.max_gap_ms)
    previous: dict[int, DepthImage] = {}
    for entry in session.pairs(clock_offset_ms):
        if isinstance(entry, LaserScan):
            yield entry
            groups = grouper.pass_scan()
        else:
            groups = grouper.push(entry)
        for group in groups:
            yield from _tasks_of(group, previous, session, labels)
    for group in grouper.flush():
        yield from _tasks_of(group, previous, session, labels)


def _tasks_of(
    group: Sequence[PairedImage],
    previous: dict[int, DepthImage],
    session: Session,
    labels: SessionLabels | None,
) -> Iterator[PairedImage | FrameTask]:
    """``previous``: each camera's image before, which is brought up to date."""
    for frame in split_into_frames(group, session.settings):
        paired = tuple(entry for entry in frame if entry.window is not None)
        if not paired:
            yield from frame
            continue
        yield FrameTask(
            images=paired,
            previous={
                entry.camera: previous[entry.camera] for entry in paired if entry.camera in previous
            },
            labels=None if labels is None else _labels_of(paired, labels),
        )
        previous.update({entry.camera: entry.image for entry in paired})


def _labels_of(paired: Sequence[PairedImage], labels: SessionLabels) -> dict[int, PairLabels]:
    return {
        entry.camera: labels.of_pair(entry.window, entry.image, entry.camera)
        for entry in paired
        if entry.window is not None
    }


@dataclass(kw_only=True, eq=False)
class FrameFuser:
    """Does tasks. ``setup``: of the session that they come from."""

    setup: FrameSetup
    alignment: RecordingAlignment
    # Each camera's last image: mostly it is the next task's previous one.
    _last: dict[int, tuple[DepthImage, UprightDepth]] = field(default_factory=dict, init=False)

    def fuse(self, task: FrameTask) -> list[FusedFrame] | None:
        """The fused images of a task, None where they have no peak."""
        pairs = [
            pair
            for entry in task.images
            if (pair := self.setup.frame_pair(entry, self._previous(task, entry.camera)))
            is not None
        ]
        for pair in pairs:
            self._last[pair.camera_index] = (pair.image, pair.upright)
        labels = None
        if task.labels is not None:
            labels = TaskLabels(of_camera=task.labels, views=self.setup.rig.views)
        try:
            return fuse_images(pairs, self.alignment, self.setup.settings, labels)
        except AlignmentFailed:
            return None

    def _previous(self, task: FrameTask, camera: int) -> UprightDepth | None:
        image = task.previous.get(camera)
        if image is None:
            return None
        last = self._last.get(camera)
        if last is not None and last[0] is image:
            return last[1]
        return UprightDepth(
            stamp_ns=image.stamp_ns, depth_m=self.setup.depth_of(camera, image.depth_m)
        )
