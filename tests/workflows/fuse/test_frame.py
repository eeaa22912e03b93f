"""A fused frame: the class of its pairs."""

from types import SimpleNamespace

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.fuse.frame import FusedFrame

GOOD, HOLE, BURR, CONFLICT = NoiseClass
NO_PIXEL = -1


def test_a_pair_has_the_class_of_its_worse_side():
    sides = {
        (GOOD, GOOD): GOOD,
        (HOLE, GOOD): HOLE,
        (GOOD, HOLE): HOLE,
        (HOLE, HOLE): HOLE,
        (BURR, GOOD): BURR,
        (HOLE, BURR): BURR,
        (BURR, HOLE): BURR,
        (BURR, BURR): BURR,
        (CONFLICT, CONFLICT): CONFLICT,
        (GOOD, NO_PIXEL): GOOD,
        (HOLE, NO_PIXEL): HOLE,
        (BURR, NO_PIXEL): BURR,
    }
    lidar_class, depth_class = np.array(list(sides)).T
    classes = SimpleNamespace(lidar_class=lidar_class, depth_class=depth_class)
    frame = FusedFrame(match=None, classes=classes, repair=None, camera_range_m=None)
    assert frame.pair_class.tolist() == list(sides.values())
