"""``scanloom evaluate``: results measured against a truth, a reference or relations.

- ``evaluate.py``: a function for each measure: alignment, noise and repair of a folder that
  ``fuse`` wrote, trajectories, relations, and maps against the outlines of a world.
- ``odometry.py``: the drift of every odometry in a folder that ``map`` wrote.
- ``map_alignment.py``: where a map lies in the world, before it is measured.

The measures themselves, with their papers and equations, are in ``fusion_core.evaluation``.
"""
