"""``scanloom map``: motion, SLAM and maps of a recording (Li 2022; Fu 2024).

Begin with ``build_map.py``, which holds the whole run on one screen. Its steps:

- Choices: ``options.py`` (of the command line), ``settings.py`` (of every stage, with presets).
- Input: ``map_input.py`` opens what the options choose: the scans (``scan_source.py``; with cameras
  ``virtual_scans.py``, repaired ``repaired_scans.py``) and their odometry (``motion_prior.py``, the
  camera's images in ``rgbd_frames.py``).
- Where the cameras are: ``extrinsics.py`` (from a file, from TF after
  ``recorded_mount_check.py``, or from the alignment), ``floor_alignment.py`` (their height and tilt
  above the floor), ``recorded_sensors.py`` (all of it with the clock offset, as one value).
- SLAM: ``estimators.py`` gives each scan a pose in the map.
- Maps: ``occupancy_maps.py`` builds the grids from the placed scans.
- Output: ``report.py`` (report.json), ``write_results.py`` and ``write_odometry.py`` (the files and
  their figures); ``result_folder.py`` reads them back. ``colors.py`` serves pictures of maps.
"""
