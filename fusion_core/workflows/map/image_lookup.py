"""The images of keyframes, decoded from the recording when they are asked for."""

import numpy as np

from fusion_core.lens.straight_images import StraightImages
from fusion_core.model.conventions import ByteArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import ColorImage
from fusion_core.model.stamps import NO_STAMP
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.map.rgbd_frames import COLOR_GAP_MAX_NS, RgbdFrames, reduce_image
from fusion_core.workflows.map.visual.color_registration import magnify


class ImageLookup:
    """Images of the first depth camera by their stamps, in the size and with the camera matrix
    that visual SLAM uses, their distortion taken off. Safe for threads.

    ``clock_offset_ns``: as ``RgbdFrames``. ``color_zoom``: the run's, of its report. Raises as
    ``RgbdFrames``.
    """

    def __init__(
        self,
        recording: Recording,
        streams: Streams,
        *,
        clock_offset_ns: int = 0,
        color_zoom: float = 1.0,
    ) -> None:
        intrinsics = RgbdFrames(recording, streams).intrinsics
        color = streams.color[0]
        assert color is not None, "RgbdFrames needs it"
        self._recording, self._color = recording, color
        self._clock_offset_ns, self._color_zoom = clock_offset_ns, color_zoom
        self.intrinsics = intrinsics
        self._straight = StraightImages(intrinsics)
        stamps_ns = recording.stamps_ns(color)
        self._index = np.flatnonzero(stamps_ns != NO_STAMP)
        self._stamps_ns = stamps_ns[self._index]

    def at(self, stamp_ns: int) -> ByteArray:
        """(H, W, 3) uint8 RGB: the colour image nearest to a keyframe's stamp.

        Raises MissingStream where none is near, RecordingError for one that cannot be read.
        """
        away_ns = np.abs(self._stamps_ns - (stamp_ns + self._clock_offset_ns))
        nearest = int(away_ns.argmin()) if away_ns.size else -1
        value = None
        if nearest >= 0 and away_ns[nearest] <= COLOR_GAP_MAX_NS:
            value = self._recording.read(self._color, int(self._index[nearest])).value
        if not isinstance(value, ColorImage):
            raise MissingStream(
                f"has no colour image at {stamp_ns * 1e-9:.3f} s.",
                file=self._recording.path,
                advice="The run may be of another recording, or of another clock offset.",
            )
        camera = self.intrinsics
        image = reduce_image(value.rgb, (camera.height, camera.width))
        return self._straight.color(magnify(image, self._color_zoom, camera))
