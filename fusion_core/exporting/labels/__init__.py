"""Labels as files that others read, and back.

They stand here and not beside the journal: they are written as every other result is, by the tables
and the output folder of ``exporting``, and know no more of labels than ``model`` says.

Begin with ``formats.py``, the table of formats. ``label_file.py`` says what all of them carry: the
layer, the recording with its digest, the version. ``label_runs.py`` is the one table of runs that
``csv_file.py``, ``jsonl_file.py`` and ``parquet_file.py`` hold. ``coco.py`` holds masks, packed by
``run_length.py``. ``capture_folder.py`` is a folder of a file for each capture, with an index:
``semantic_kitti.py`` for scans, ``png_masks.py`` for depth images.
"""
