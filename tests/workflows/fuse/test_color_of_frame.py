"""The colour image of a frame: the nearest one, turned as the depth image is."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_core.alignment.upright import upright_view
from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import CameraIntrinsics, ColorImage
from fusion_core.workflows.fuse.color_of_frame import nearest_color_image, remap_color


@pytest.mark.parametrize(
    "up", [(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)], ids=["0", "1", "2", "3"]
)
@pytest.mark.parametrize("distortion", [(), (0.05, -0.02, 0.0, 0.0, 0.0)], ids=["plain", "lens"])
def test_a_colour_image_is_turned_as_the_depth_image_is(
    up: tuple[float, float], distortion: tuple[float, ...]
) -> None:
    lens = CameraIntrinsics(
        width=6, height=4, fx=6.0, fy=6.0, cx=2.5, cy=1.5, distortion=distortion
    )
    view = upright_view(lens, np.array([*up, 0.0]))
    values = np.arange(1, 25, dtype=np.uint8).reshape(4, 6)
    rgb = np.repeat(values[:, :, np.newaxis], 3, axis=2)
    seen = np.nan_to_num(view.remap(values.astype(np.float32)), nan=0.0)
    turned = remap_color(rgb, view)
    for channel in range(3):
        np.testing.assert_array_equal(turned[:, :, channel], seen)


@pytest.mark.parametrize("up", [(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)])
def test_a_colour_image_of_another_size_is_turned_too(up: tuple[float, float]) -> None:
    lens = CameraIntrinsics(width=6, height=4, fx=6.0, fy=6.0, cx=2.5, cy=1.5)
    view = upright_view(lens, np.array([*up, 0.0]))
    values = np.arange(24, dtype=np.uint8).reshape(4, 6)
    large = values.repeat(2, axis=0).repeat(2, axis=1)
    turned = remap_color(np.repeat(large[:, :, np.newaxis], 3, axis=2), view)
    np.testing.assert_array_equal(turned[::2, ::2, 0], view.remap(values.astype(np.float32)))


class ColorLog:
    """A recording of colour images alone, logged every 100 ns in the order of ``stamps_ns``."""

    def __init__(self, stamps_ns: list[int | None]) -> None:
        self._stamps_ns = stamps_ns
        self.decoded = 0

    def received_ns(self, topic: str) -> np.ndarray:
        return 100 * np.arange(len(self._stamps_ns))

    def read(self, topic: str, index: int) -> Any:
        self.decoded += 1
        stamp_ns = self._stamps_ns[index]
        if stamp_ns is None:
            raise RecordingError("is damaged.")
        rgb = np.zeros((1, 1, 3), dtype=np.uint8)
        return SimpleNamespace(
            value=ColorImage(stamp_ns=stamp_ns, received_ns=100 * index, frame_id="", rgb=rgb)
        )


def color_near(log: ColorLog, stamp_ns: int, received_ns: int | None, topic: str | None) -> Any:
    session: Any = SimpleNamespace(
        streams=SimpleNamespace(depth=("/other", "/depth"), color=("/none", topic)),
        rig=SimpleNamespace(cameras=[SimpleNamespace(topic="/depth")]),
        recording=log,
    )
    pair = SimpleNamespace(camera_index=0, image=SimpleNamespace(received_ns=received_ns))
    shown: Any = SimpleNamespace(match=SimpleNamespace(stamp_ns=stamp_ns, pair=pair))
    return nearest_color_image(session, shown)


def test_the_colour_image_is_the_nearest_in_stamp_and_few_are_decoded() -> None:
    # The log has the images out of the order of their stamps, and 40 ns late.
    stamps_ns: list[int | None] = [100 * i - 40 for i in range(1000)]
    stamps_ns[500], stamps_ns[501] = stamps_ns[501], stamps_ns[500]
    log = ColorLog(stamps_ns)
    assert color_near(log, 50_055, 50_100, "/color").stamp_ns == 50_060
    assert log.decoded <= 6


def test_a_damaged_colour_image_is_passed_over() -> None:
    log = ColorLog([0, None, 200])
    assert color_near(log, 110, 110, "/color").stamp_ns == 200
    assert color_near(ColorLog([None]), 0, 0, "/color") is None


def test_without_a_log_stamps_find_the_colour_image() -> None:
    assert color_near(ColorLog([0, 100, 200]), 90, None, "/color").stamp_ns == 100


def test_a_camera_without_colour_has_no_colour_image() -> None:
    assert color_near(ColorLog([0]), 0, 0, None) is None
