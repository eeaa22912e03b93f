"""One simulated recording fused end to end: every result, against the recording itself."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.errors import AlignmentFailed, ExportError, MissingStream, SettingsError
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions

TOPIC = "/camera/depth/image_raw"
MAPS = ("map_lidar", "map_camera", "map_fused")
FILES = {
    "frames.csv",
    "samples.parquet",
    "alignment.json",
    "fused.mcap",
    "map_difference.png",
    "settings.toml",
    "manifest.json",
    "summary.json",
    *(f"{name}.{suffix}" for name in MAPS for suffix in ("pgm", "yaml", "png")),
}
FRAME_NUMBERS = ("stamp_ns", "scan_stamp_ns", "gap_ms", "sigma_m", "epsilon_m")
PEAK_NUMBERS = ("u", "v", "score", "overlap")
FIT_NUMBERS = ("inliers", "mean_error_m")
COUNTS = [f"{s}_{c.name.lower()}" for s in ("lidar", "depth") for c in NoiseClass]
COUNTS += ["repaired_lidar", "repaired_depth"]
SAMPLE_TYPES = {
    "stamp_ns": pa.types.is_int64,
    "scan_stamp_ns": pa.types.is_int64,
    "lidar_beam": pa.types.is_integer,
    "depth_row": pa.types.is_integer,
    "depth_column": pa.types.is_integer,
    "lidar_class": pa.types.is_integer,
    "depth_class": pa.types.is_integer,
    "lidar_confidence": pa.types.is_floating,
    "depth_confidence": pa.types.is_floating,
    "residual_m": pa.types.is_floating,
    "lidar_raw_m": pa.types.is_float64,
    "lidar_repaired_m": pa.types.is_float64,
    "lidar_source": pa.types.is_dictionary,
    "depth_raw_m": pa.types.is_float64,
    "depth_repaired_m": pa.types.is_float64,
    "depth_source": pa.types.is_dictionary,
}
MOUNT = ("yaw_rad", "delta_z_m", "forward_m", "left_m", "pitch_rad", "clock_offset_ms")
METRICS = {"pearson", "cosine", "inverse_cosine", "euclidean"}


def frames_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "frames.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def samples_of(folder: Path) -> dict[str, np.ndarray]:
    """Columns of samples.parquet; stamps exact, other numbers as floats with NaN for null."""
    table = pq.read_table(folder / "samples.parquet")
    columns = {
        name: column.to_numpy()
        for name, column in zip(table.column_names, table.columns, strict=True)
    }
    for name, values in columns.items():
        if values.dtype not in (object, np.int64):
            columns[name] = values.astype(np.float64)
    return columns


def document_of(folder: Path):
    return json.loads((folder / "alignment.json").read_text(encoding="utf-8"))


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture(scope="module")
def recorded(bedroom):
    """Scans and depth images of the recording, by stamp."""
    with open_recording(bedroom.recording) as recording:
        values = [message.value for message in recording.messages(["/scan", TOPIC])]
    return (
        {value.stamp_ns: value for value in values if isinstance(value, LaserScan)},
        {value.stamp_ns: value for value in values if isinstance(value, DepthImage)},
    )


@pytest.fixture(scope="module")
def samples(bedroom):
    return samples_of(bedroom.folder)


@pytest.fixture(scope="module")
def frames(bedroom):
    return frames_of(bedroom.folder)


def test_every_result_is_there_and_nothing_else(bedroom):
    assert bytes_of(bedroom.folder).keys() == FILES
    manifest = json.loads((bedroom.folder / "manifest.json").read_text())
    assert manifest["files"].keys() == FILES - {"manifest.json"}


def test_no_result_tells_of_this_machine(bedroom):
    for name, content in bytes_of(bedroom.folder).items():
        assert str(bedroom.folder.parent).encode() not in content, name
        assert str(bedroom.recording.parent).encode() not in content, name


def test_there_is_a_row_for_each_image_with_every_column(frames, recorded, bedroom):
    scans, images = recorded
    assert [int(frame["stamp_ns"]) for frame in frames] == list(images)
    assert bedroom.summary.frames == bedroom.summary.paired == len(images)
    for frame in frames:
        assert frame["row_model"] in ("curve", "row")
        assert all(np.isfinite(float(frame[name])) for name in FRAME_NUMBERS)
        assert all(int(frame[name]) >= 0 for name in COUNTS)
        for group in (PEAK_NUMBERS, FIT_NUMBERS):
            assert len({frame[name] == "" for name in group}) == 1
            assert all(frame[name] == "" or np.isfinite(float(frame[name])) for name in group)
        assert {"peak_ratio", "u_alone"} <= frame.keys()
        nearest = min(scans, key=lambda stamp, f=frame: abs(stamp - int(f["stamp_ns"])))
        assert int(frame["scan_stamp_ns"]) == nearest
        assert float(frame["gap_ms"]) == pytest.approx((int(frame["stamp_ns"]) - nearest) / 1e6)


def test_the_offset_of_a_frame_stays_by_the_recordings(frames):
    offsets = [float(frame["u"]) for frame in frames if frame["u"]]
    assert len(offsets) > 0.8 * len(frames)
    # Two samples to either side, and half a sample of the parabola at each end.
    assert max(offsets) - min(offsets) <= 5.0
    alone = [float(frame["u_alone"]) for frame in frames if frame["u_alone"]]
    assert max(alone) - min(alone) > 5.0


def test_samples_have_every_column_with_its_type(bedroom):
    schema = pq.read_schema(bedroom.folder / "samples.parquet")
    for name, is_right in SAMPLE_TYPES.items():
        assert is_right(schema.field(name).type), name
    for name in ("lidar_source", "depth_source"):
        assert pa.types.is_string(schema.field(name).type.value_type)


def test_raw_values_are_the_recordings_own(samples, recorded):
    scans, images = recorded
    lidar_raw = [
        scans[stamp].ranges_m[int(beam)]
        for stamp, beam in zip(samples["scan_stamp_ns"], samples["lidar_beam"], strict=True)
    ]
    np.testing.assert_array_equal(samples["lidar_raw_m"], lidar_raw)
    inside = np.isfinite(samples["depth_row"])
    assert inside.mean() > 0.5
    depth_raw = [
        images[stamp].depth_m[int(row), int(column)]
        for stamp, row, column in zip(
            samples["stamp_ns"][inside],
            samples["depth_row"][inside],
            samples["depth_column"][inside],
            strict=True,
        )
    ]
    np.testing.assert_array_equal(samples["depth_raw_m"][inside], depth_raw)
    for name in ("depth_column", "depth_class", "depth_confidence", "depth_repaired_m"):
        assert np.isnan(samples[name][~inside]).all(), name
    assert set(samples["depth_source"][~inside]) <= {"none"}


def test_each_beam_comes_once_a_frame(samples):
    rows = np.stack([samples["stamp_ns"], samples["lidar_beam"].astype(np.int64)])
    assert np.unique(rows, axis=1).shape == rows.shape


@pytest.mark.parametrize("sensor", ["lidar", "depth"])
def test_untouched_means_repaired_is_raw(samples, sensor):
    raw, repaired = samples[f"{sensor}_raw_m"], samples[f"{sensor}_repaired_m"]
    source, noise = samples[f"{sensor}_source"], samples[f"{sensor}_class"]
    assert set(source) <= {entry.name.lower() for entry in RepairSource}
    untouched = np.isin(source, ("raw", "none"))
    np.testing.assert_array_equal(repaired[untouched], raw[untouched])
    np.testing.assert_array_equal(np.isnan(repaired), source == "none")
    mended = ~untouched
    assert mended.sum() > 50
    assert np.isfinite(repaired[mended]).all()
    assert np.isin(noise[mended], (NoiseClass.HOLE, NoiseClass.BURR)).all()
    np.testing.assert_array_equal(noise == NoiseClass.HOLE, np.isnan(raw) & ~np.isnan(noise))


def test_counts_of_a_frame_are_those_of_its_samples(samples, frames):
    for frame in frames:
        own = samples["stamp_ns"] == int(frame["stamp_ns"])
        for sensor in ("lidar", "depth"):
            for noise in NoiseClass:
                count = int((samples[f"{sensor}_class"][own] == noise).sum())
                assert int(frame[f"{sensor}_{noise.name.lower()}"]) == count
            mended = np.isin(samples[f"{sensor}_source"][own], ("other_sensor", "neighbours"))
            assert int(frame[f"repaired_{sensor}"]) == mended.sum()


def test_the_summary_counts_what_the_frames_count(bedroom, frames):
    for noise, count in bedroom.summary.lidar_counts.items():
        assert count == sum(int(frame[f"lidar_{noise}"]) for frame in frames)


def test_alignment_says_every_value_or_that_it_is_not_observable(bedroom):
    document = document_of(bedroom.folder)
    assert document == bedroom.summary.document
    assert document["preset"] == "default"
    assert document["virtual_lidar"] is False
    assert {"u", "v", "score", "peak_ratio"} <= document.keys()
    for name in MOUNT:
        assert (document[name] is None) == (document[f"{name}_sd"] is None)
    assert document["by_metric"].keys() == METRICS
    for peak in document["by_metric"].values():
        assert peak.keys() == {"u", "v", "score", "peak_ratio"}
    assert document["by_metric"][document["metric"]]["u"] == document["u"]


def messages_of(path: Path):
    """(log time, topic, message) of every message, by rosbags."""
    typestore = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=typestore) as reader:
        return [
            (stamp, connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, stamp, data in reader.messages()
        ]


def stamp_of(message) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def test_fused_mcap_has_one_repaired_scan_for_each(bedroom, recorded, samples):
    scans, _ = recorded
    found = [m for _, topic, m in messages_of(bedroom.folder / "fused.mcap") if topic == "/scan"]
    assert [stamp_of(message) for message in found] == list(scans)
    changed = 0
    for message in found:
        raw = scans[stamp_of(message)]
        assert message.angle_min == pytest.approx(raw.angle_min_rad, abs=1e-6)
        assert message.angle_increment == pytest.approx(raw.angle_increment_rad, abs=1e-9)
        own = samples["scan_stamp_ns"] == raw.stamp_ns
        beam = samples["lidar_beam"][own].astype(int)
        gap_ns = np.abs(samples["stamp_ns"][own] - raw.stamp_ns)
        expected = raw.ranges_m.astype(np.float32)
        codes = np.where(np.isnan(raw.ranges_m), 1.0, 0.0)
        # The image nearest in time has the last word.
        for index in np.argsort(-gap_ns, kind="stable"):
            expected[beam[index]] = samples["lidar_repaired_m"][own][index]
            codes[beam[index]] = samples["lidar_class"][own][index]
        np.testing.assert_array_equal(message.ranges, expected)
        np.testing.assert_array_equal(message.intensities, codes)
        changed += int((expected != raw.ranges_m.astype(np.float32)).sum())
    assert changed > 50


def test_fused_mcap_has_each_image_and_only_repaired_pixels_differ(bedroom, recorded, samples):
    _, images = recorded
    found = [m for _, topic, m in messages_of(bedroom.folder / "fused.mcap") if topic == TOPIC]
    assert [stamp_of(message) for message in found] == list(images)
    changed = 0
    for message in found:
        raw = images[stamp_of(message)]
        assert message.encoding == raw.encoding == "16UC1"
        repaired_mm = message.data.view("<u2").reshape(message.height, message.width)
        raw_mm = np.rint(np.nan_to_num(raw.depth_m, nan=0.0) * 1000.0).astype(int)
        own = (samples["stamp_ns"] == raw.stamp_ns) & np.isin(
            samples["depth_source"], ("other_sensor", "neighbours")
        )
        allowed: dict[tuple[int, int], set[int]] = {}
        for row, column, value in zip(
            samples["depth_row"][own],
            samples["depth_column"][own],
            samples["depth_repaired_m"][own],
            strict=True,
        ):
            allowed.setdefault((int(row), int(column)), set()).add(round(value * 1000.0))
        rows, columns = np.nonzero(repaired_mm != raw_mm)
        for row, column in zip(rows, columns, strict=True):
            values = allowed[int(row), int(column)]
            assert min(abs(int(repaired_mm[row, column]) - value) for value in values) <= 1
        for (row, column), values in allowed.items():
            assert min(abs(int(repaired_mm[row, column]) - value) for value in values) <= 1
        changed += rows.size
    assert changed > 50


def test_fused_mcap_opens_with_mcaps_own_reader(bedroom, recorded):
    scans, images = recorded
    with (bedroom.folder / "fused.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    counts = {
        channel.topic: summary.statistics.channel_message_counts[number]
        for number, channel in summary.channels.items()
    }
    assert counts == {"/scan": len(scans), TOPIC: len(images), "/map_fused": 1}
    schemas = {channel.topic: channel.schema_id for channel in summary.channels.values()}
    assert {topic: summary.schemas[number].name for topic, number in schemas.items()} == {
        "/scan": "sensor_msgs/msg/LaserScan",
        TOPIC: "sensor_msgs/msg/Image",
        "/map_fused": "nav_msgs/msg/OccupancyGrid",
    }


def test_our_own_reader_opens_the_fused_recording(bedroom, recorded):
    scans, images = recorded
    with open_recording(bedroom.folder / "fused.mcap") as recording:
        roles = {topic.name: (topic.role, topic.count) for topic in recording.topics}
    assert roles["/scan"] == ("lidar", len(scans))
    assert roles[TOPIC] == ("depth", len(images))


def test_maps_are_readable_and_the_recordings_is_the_fused_one(bedroom):
    shapes = {}
    for name in MAPS:
        picture = cv2.imread(str(bedroom.folder / f"{name}.pgm"), cv2.IMREAD_UNCHANGED)
        assert picture.ndim == 2
        assert len(np.unique(picture)) >= 3
        text = (bedroom.folder / f"{name}.yaml").read_text()
        entries = dict(line.split(": ", 1) for line in text.splitlines())
        assert entries["image"] == f"{name}.pgm"
        assert float(entries["resolution"]) == pytest.approx(0.05)
        assert cv2.imread(str(bedroom.folder / f"{name}.png")) is not None
        shapes[name] = picture.shape
    assert cv2.imread(str(bedroom.folder / "map_difference.png")) is not None
    (grid,) = [m for _, t, m in messages_of(bedroom.folder / "fused.mcap") if t == "/map_fused"]
    assert (grid.info.height, grid.info.width) == shapes["map_fused"]
    picture = cv2.imread(str(bedroom.folder / "map_fused.pgm"), cv2.IMREAD_UNCHANGED)
    cells = grid.data.reshape(shapes["map_fused"])[::-1]
    assert (picture[cells == 100] == 0).all()
    assert (cells > 80).sum() > 100


def test_two_runs_give_the_same_bytes(bedroom, fused):
    again = fused("bedroom")
    assert again.folder != bedroom.folder
    first, second = bytes_of(bedroom.folder), bytes_of(again.folder)
    assert first.keys() == second.keys()
    for name, content in first.items():
        assert second[name] == content, name


def test_measures_on_the_scene_stand_above_their_floors(bedroom):
    alignment = evaluate.alignment(bedroom.folder, bedroom.truth)
    assert abs(alignment["yaw_error_deg"]) < 1.0
    noise = evaluate.noise(bedroom.folder, bedroom.truth)
    assert noise["xi"] >= 0.95
    assert noise["eta"] >= 0.8
    assert noise["good_pairs"] > 1000
    assert noise["noise_pairs"] > 50


def test_the_same_work_is_skipped_and_forced_and_foreign_files_are_refused(scenes, tmp_path):
    recording, folder = scenes("bedroom", duration_s=1.0), tmp_path / "out"
    options = {"maps": False, "figures": False}
    first = fuse(recording, folder, FuseOptions(**options))
    assert not first.skipped
    times = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    second = fuse(recording, folder, FuseOptions(**options))
    assert second.skipped
    assert times == {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert {**second.to_json(), "skipped": False} == first.to_json()
    assert "nothing was done" in second.lines()[0]
    before = bytes_of(folder)
    assert not fuse(recording, folder, FuseOptions(**options, force=True)).skipped
    assert times != {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert bytes_of(folder) == before
    (folder / "thesis.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"thesis\.txt"):
        fuse(recording, folder, FuseOptions(**options, force=True))
    fuse(recording, folder, FuseOptions(**options, force=True, overwrite=True))
    assert (folder / "thesis.txt").read_text() == "mine"
    # Another seed is other work.
    with pytest.raises(ExportError, match=r"thesis\.txt"):
        fuse(recording, folder, FuseOptions(**options, seed=9))


@pytest.mark.slow
def test_the_settings_of_a_result_repeat_it(scenes, tmp_path):
    recording = scenes("bedroom", duration_s=1.0)
    own = tmp_path / "own.toml"
    own.write_text("[noise]\nepsilon = 2.0\n[registration]\nseed = 3\n")
    fuse(recording, tmp_path / "a", FuseOptions(settings_file=own, maps=False, figures=False))
    written = tmp_path / "a" / "settings.toml"
    fuse(recording, tmp_path / "b", FuseOptions(settings_file=written, maps=False, figures=False))
    assert bytes_of(tmp_path / "a") == bytes_of(tmp_path / "b")
    assert "epsilon = 2.0" in written.read_text()


def test_the_published_preset_runs_and_says_so(scenes, tmp_path):
    folder = tmp_path / "out"
    options = FuseOptions(preset="published", maps=False, figures=False)
    summary = fuse(scenes("bedroom"), folder, options)
    document = document_of(folder)
    assert document["preset"] == "published"
    assert document["row_model"] == "row"
    assert document["metric"] == "pearson"
    assert 'preset = "published"' in (folder / "settings.toml").read_text()
    assert "published" in summary.lines()[0]
    rows = frames_of(folder)
    paired = [row for row in rows if row["u"]]
    assert len(paired) > 0.9 * len(rows)
    assert {row["row_model"] for row in paired} == {"row"}
    # Each frame alone, in the lower half of the image.
    assert all(row["u"] == row["u_alone"] for row in paired)
    assert all(float(row["v"]) >= 59.0 for row in paired)
    samples = samples_of(folder)
    assert not (samples["lidar_class"] == NoiseClass.CONFLICT).any()
    # One sample a degree: of 682 beams 240 at most.
    assert len(np.unique(samples["lidar_beam"])) <= 240


def test_a_clock_offset_is_applied_only_when_asked_and_observable(scenes, tmp_path):
    recording = scenes("bedroom")
    options = {"maps": False, "figures": False}
    summary = fuse(recording, tmp_path / "shifted", FuseOptions(**options, apply_clock_offset=True))
    offset_ms = summary.document["clock_offset_ms"]
    frames = frames_of(tmp_path / "shifted")
    for frame in frames[5:-5]:
        between_ms = (int(frame["stamp_ns"]) - int(frame["scan_stamp_ns"])) / 1e6
        assert float(frame["gap_ms"]) == pytest.approx(between_ms - offset_ms, abs=1e-5)
    # Each frame alone estimates no clock.
    with pytest.raises(AlignmentFailed, match="not observable"):
        fuse(
            recording,
            tmp_path / "none",
            FuseOptions(preset="published", **options, apply_clock_offset=True),
        )
    assert not (tmp_path / "none").exists()


def test_a_band_without_rows_is_refused(scenes, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text("[sampling]\nrow_first = 500\n")
    with pytest.raises(SettingsError, match=r"row_first = 500.*120 rows"):
        fuse(scenes("bedroom"), tmp_path / "out", FuseOptions(settings_file=file, figures=False))


def test_a_recording_without_a_camera_is_refused_and_leaves_no_folder(log, tmp_path):
    log.scan(0.0)
    log.open()
    with pytest.raises(MissingStream, match="no depth images"):
        fuse(log.path, tmp_path / "out", FuseOptions())
    assert not (tmp_path / "out").exists()


def test_sensors_that_never_meet_in_time_are_refused(log, tmp_path):
    log.info()
    for index in range(8):
        log.scan(100.0 * index)
        log.image(100.0 * index + 60_000.0)
    log.open()
    with pytest.raises(AlignmentFailed, match="close enough in time"):
        fuse(log.path, tmp_path / "out", FuseOptions())
