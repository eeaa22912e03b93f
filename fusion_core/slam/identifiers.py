"""Identifiers of local SLAM's keyframes and submaps, which are the pose graph's nodes."""

from typing import NewType

NodeId = NewType("NodeId", int)
"""Number of a keyframe, a node of the pose graph, in the order of time."""

SubmapId = NewType("SubmapId", int)
"""Number of a submap, in the order of the first keyframes."""
