"""The workflows of commands and workbench: the only folder that composes readers, stages, files.

- ``fuse/``, ``map/``, ``evaluate/``, ``labels/``: a folder for each large command; its docstring is
  its guide.
- ``batch/``: any of info, fuse, map and evaluate over many recordings, on Dask.
- ``info.py``, ``convert.py``, ``sample.py``, ``scan_matching.py``: the small commands.
- ``source.py``: opens the recording, or the room of a data set, that a command works on.
- What several commands read of a recording: ``stamp_filter.py`` (drops messages stamped out of
  order), ``sensor_geometry.py`` (drops those of another sensor geometry), ``stream_gaps.py``,
  ``recorded_transforms.py`` (frames; ``timed_transforms.py`` drops their outliers) and
  ``recorded_poses.py`` (where the LiDAR was).
"""
