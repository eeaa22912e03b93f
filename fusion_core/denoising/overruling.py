"""Between classes and repair: what a person says of a sample takes the place of its class.

The person is certain: the confidence becomes 1, and no guard of the repair holds against them. What
each label does to a sample:

========  ======================================================================================
good      kept as it is, and others are repaired from it; without a value it stays without one
conflict  kept as it is, on both sides
hole      its value is dropped; filled where there is a source, else missing
burr      the same under its own name
unsure    decides nothing
========  ======================================================================================

What a person rejects, as a hole or a burr, is no evidence either: no gap is left open because of
it, and nothing is repaired from it.
"""

from dataclasses import replace

import numpy as np

from fusion_core.denoising.noise import Classification
from fusion_core.model.classes import NoiseClass, is_one_of
from fusion_core.model.conventions import BoolArray, IntArray
from fusion_core.model.labels import Label


def overrule(classes: Classification, lidar: IntArray, depth: IntArray) -> Classification:
    """The classes with a person's labels over them.

    ``lidar``, ``depth``: (B,) codes of Label of the pairs' beams and pixels, NO_LABEL for none. A
    pixel that a beam does not have has no class.
    """
    lidar_decided = _decides(lidar)
    depth_decided = _decides(depth) & (classes.depth_class >= 0)
    return replace(
        classes,
        lidar_class=np.where(lidar_decided, lidar, classes.lidar_class),
        depth_class=np.where(depth_decided, depth, classes.depth_class),
        lidar_confidence=np.where(lidar_decided, 1.0, classes.lidar_confidence),
        depth_confidence=np.where(depth_decided, 1.0, classes.depth_confidence),
        lidar_decided=lidar_decided,
        depth_decided=depth_decided,
    )


def is_rejected(label: IntArray) -> BoolArray:
    """Of codes of Label, which say that a value is none."""
    return is_one_of(label, Label.HOLE, Label.BURR)


def _decides(label: IntArray) -> BoolArray:
    return np.isin(label, list(NoiseClass))
