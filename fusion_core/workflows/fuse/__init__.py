"""``scanloom fuse``: Xu 2024's chain. Start in ``fuse.py``; the other files by what they do:

opening a recording
    settings.py         every stage's settings, the presets, and which settings each stage reads
    session.py          ``Session``: an opened recording with its streams, rig and settings
    camera_rig.py       ``CameraRig``: upright cameras on one frame, and the recorded mount
pairs of scan and depth image
    pairing.py          ``FramePair``: image and scan of one frame; pairs streamed in time order,
                        images of several cameras put together
    pairing_gaps.py     how far in time each image of a recording lies from its scan
    frame_reader.py     any frame by its number, without a pass over the recording
the two passes
    align.py            pass 1: (u, v), mount and noise scale of the recording
    frame.py            pass 2: match, classify and repair an image, or the images of a panorama
    match_images.py     the matching within ``frame.py``: offset, pairs and A
    frame_match.py      ``FrameMatch``: what it gives for each image
    captures.py         the recorded scan and image of a frame, and its beams and pixels in them
    offset_search.py    a frame's own (u, v), within ``match_images.py``
    row_search.py       the fields of a scan's curve over an image's rows
    frame_labels.py     a person's labels of a frame, which overrule its classes
    cached_chain.py     pass 2 for one frame at a time, with caches, for the workbench
what is written
    result_writer.py    tables, repaired recording and maps, as frames come
    tables.py           rows of frames.csv and samples.parquet, and alignment.json
    scan_queue.py       each scan once, with the repairs of all images paired with it
    sensor_maps.py      LiDAR, camera and fused map from the same poses
    figures.py          the paper's figures, of one frame and of the recording
    table_1.py          the paper's Table 1: frames by their score
    summary.py          what a run reports
    rooms.py            the chain over every room of a data set
    result_folder.py    a folder of results, read again
    export_clouds.py    point clouds of a folder of results
what the workbench shows of a frame
    epsilon.py          the threshold epsilon in its three units
    registration_details.py   RANSAC's pairs, draws and residuals
    recall.py           Fig. 6 for the current settings
"""
