"""A person's labels in the chain: frame by frame, in a run, and in what it leaves behind."""

import json
from dataclasses import fields, replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from fusion_core.exporting.manifest import LabelsDigest, Manifest
from fusion_core.exporting.output_folder import RunRequest, plan_output
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.errors import SettingsError
from fusion_core.model.labels import NO_LABEL, CaptureLabels, Label
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.captures import frame_captures, image_capture, scan_capture
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.recorded_sensors import RecordedSensors
from fusion_core.workflows.map.repaired_scans import RepairedScans
from tests.workflows.fuse.fused_frames import fuse_frames
from tests.workflows.label_layer import MemoryLayer

pytestmark = pytest.mark.slow

GOOD, HOLE, BURR, CONFLICT = NoiseClass
DEFAULT, PUBLISHED = PRESETS["default"], PRESETS["published"]


@pytest.fixture(scope="module")
def chain(scenes):
    """The chain on a room with one camera, whose mount is refined on few frames."""
    mount = DEFAULT.mount.model_copy(update={"frames": 8})
    settings = DEFAULT.model_copy(update={"mount": mount})
    with open_recording(scenes("bedroom")) as recording:
        session = open_session(recording, FuseOptions(), settings)
        yield CachedChain(session, FrameReader(session), align_recording(session))


@pytest.fixture(scope="module")
def pasted(scenes):
    """The chain on four rolled cameras, pasted beside each other."""
    with open_recording(scenes("robot_at_home", duration_s=2.0)) as recording:
        session = open_session(recording, FuseOptions(preset="published"), PUBLISHED)
        yield CachedChain(session, FrameReader(session), align_recording(session))


def fused(chain, number, layer=None, settings=None):
    choice = FrameChoice(number=number)
    return chain.fused(choice, settings or chain.session.settings, layer)


def beam_labels(chain, frame, beam, label):
    """Labels of beams, by their numbers in the scan."""
    scan = frame_captures(frame.match, chain.session).scan
    beam = np.atleast_1d(beam)
    return CaptureLabels.of_samples(scan, np.zeros_like(beam), beam, label)


def pixel_labels(chain, frame, pair, label):
    """Labels of the pixels of some pairs."""
    found = frame_captures(frame.match, chain.session)
    pair = np.atleast_1d(pair)
    return CaptureLabels.of_samples(found.image, found.row[pair], found.column[pair], label)


def assert_same_frames(first, second):
    for part in ("classes", "repair"):
        own, other = getattr(first, part), getattr(second, part)
        for field in fields(own):
            np.testing.assert_array_equal(
                getattr(own, field.name), getattr(other, field.name), err_msg=field.name
            )
    np.testing.assert_array_equal(first.camera_range_m, second.camera_range_m)


def test_without_labels_a_frame_is_the_cached_one(chain) -> None:
    plain = fused(chain, 20)
    assert fused(chain, 20, MemoryLayer()) is plain
    elsewhere = beam_labels(chain, fused(chain, 30), 100, BURR)
    assert fused(chain, 20, MemoryLayer(elsewhere)) is plain


def test_a_label_holds_at_once_and_until_it_is_taken_back(chain) -> None:
    plain = fused(chain, 20)
    pairs = plain.match.correspondence
    steady = (plain.classes.lidar_class == GOOD) & np.isfinite(pairs.camera_range_m)
    pair = int(np.flatnonzero(steady)[steady.sum() // 2])
    layer = MemoryLayer(beam_labels(chain, plain, pairs.beam[pair], BURR))
    judged = fused(chain, 20, layer)
    assert judged.match is plain.match
    assert judged.classes.lidar_class[pair] == BURR
    assert judged.classes.lidar_confidence[pair] == 1.0
    assert judged.repair.lidar_source[pair] in (
        RepairSource.OTHER_SENSOR,
        RepairSource.NEIGHBOURS,
    )
    assert np.isfinite(judged.repair.lidar_range_m[pair])
    others = np.arange(pairs.beam.size) != pair
    np.testing.assert_array_equal(
        judged.classes.lidar_class[others], plain.classes.lidar_class[others]
    )
    assert fused(chain, 20, layer) is judged
    layer.put(beam_labels(chain, plain, pairs.beam[pair], int(Label.UNSURE)))
    assert_same_frames(fused(chain, 20, layer), plain)
    layer.put(layer.labels_of(layer.captures()[0]).subset(np.array([False])))
    assert fused(chain, 20, layer) is plain


def test_a_pixel_is_labelled_where_it_is_stored(pasted) -> None:
    """In the rolled image of one camera, of which the whole panorama is classified."""
    for number in range(8, 12):
        plain = fused(pasted, number)
        known = np.flatnonzero(plain.classes.depth_class == GOOD)[:5]
        layer = MemoryLayer(pixel_labels(pasted, plain, known, CONFLICT))
        expected = plain.classes.depth_class.copy()
        expected[known] = CONFLICT
        judged = fused(pasted, number, layer)
        np.testing.assert_array_equal(judged.classes.depth_class, expected)
        np.testing.assert_array_equal(np.flatnonzero(judged.classes.depth_decided), known)
    captured = {capture.topic for capture in layer.captures()}
    assert captured == {pasted.session.rig.cameras[plain.match.pair.camera_index].topic}


def layer_of_classes(chain, numbers, codes):
    """A layer that repeats the automatic classes among ``codes`` of some frames."""
    layer = MemoryLayer()
    for number in numbers:
        frame = fused(chain, number)
        found, classes = frame_captures(frame.match, chain.session), frame.classes
        own = np.isin(classes.lidar_class, codes)
        layer.put(
            CaptureLabels.of_samples(
                found.scan,
                np.zeros(own.sum(), dtype=int),
                found.beam[own],
                classes.lidar_class[own],
            )
        )
        own = np.isin(classes.depth_class, codes) & (found.row >= 0)
        layer.put(
            CaptureLabels.of_samples(
                found.image, found.row[own], found.column[own], classes.depth_class[own]
            )
        )
    return layer


def test_repeated_classes_change_only_what_their_confidence_does(chain) -> None:
    """A burr is dropped whatever was its confidence; a pixel is repaired from any good beam. What
    the rule of confidences does not touch is the same."""
    any_beam = chain.session.settings.repair.model_copy(update={"lidar_confidence": 0.0})
    settings = chain.session.settings.model_copy(update={"repair": any_beam})
    kept_burrs = 0
    for number in (10, 20, 30):
        plain = fused(chain, number)
        raw_m = plain.match.correspondence.lidar_range_m
        judged = fused(
            chain, number, layer_of_classes(chain, [number], [GOOD, HOLE, CONFLICT]), settings
        )
        certain = fused(chain, number, None, settings)
        np.testing.assert_array_equal(judged.repair.lidar_range_m, certain.repair.lidar_range_m)
        np.testing.assert_array_equal(judged.repair.depth_m, certain.repair.depth_m)
        judged = fused(chain, number, layer_of_classes(chain, [number], list(NoiseClass)))
        for side, value_m in (
            ("lidar", judged.repair.lidar_range_m),
            ("depth", judged.repair.depth_m),
        ):
            classes = getattr(plain.classes, f"{side}_class")
            np.testing.assert_array_equal(getattr(judged.classes, f"{side}_class"), classes)
            decided = classes >= 0
            assert (getattr(judged.classes, f"{side}_confidence")[decided] == 1.0).all()
            kept = np.isin(classes, (GOOD, CONFLICT))
            before = getattr(plain.repair, "lidar_range_m" if side == "lidar" else "depth_m")
            np.testing.assert_array_equal(value_m[kept], before[kept])
        burr = plain.classes.lidar_class == BURR
        kept_burrs += int((plain.repair.lidar_range_m == raw_m)[burr].sum())
        assert not (judged.repair.lidar_range_m == raw_m)[burr].any()
    assert kept_burrs


def test_what_a_person_rejects_fills_no_gap(chain) -> None:
    """A rejected surface predicts no beam and fills no pixel."""
    plain = fused(chain, 20)
    image = frame_captures(plain.match, chain.session).image
    everything = np.full((image.rows, image.columns), int(BURR))
    judged = fused(chain, 20, MemoryLayer(CaptureLabels.of_image(image, everything)))
    assert np.isfinite(plain.camera_range_m).any()
    pairs = judged.match.correspondence
    on_a_value = np.isfinite(pairs.depth_m) & np.isfinite(pairs.camera_range_m)
    on_a_value &= np.abs(pairs.depth_as_range_m - pairs.camera_range_m) < 0.02
    assert on_a_value.sum() > 20
    assert np.isnan(judged.camera_range_m[on_a_value]).all()
    assert not (judged.repair.depth_source == RepairSource.NEIGHBOURS).any()
    assert (plain.repair.depth_source == RepairSource.NEIGHBOURS).any()


def test_a_pass_gives_the_frames_of_the_chain(chain) -> None:
    layer = layer_of_classes(chain, range(18, 24), [BURR, CONFLICT])
    labels = SessionLabels(session=chain.session, layer=layer)
    passed = {
        entry.match.stamp_ns: entry
        for entry in fuse_frames(chain.session, chain.alignment, 0.0, labels)
        if isinstance(entry, FusedFrame)
    }
    decided = 0
    for number in range(18, 24):
        seen = fused(chain, number, layer)
        assert_same_frames(seen, passed[seen.match.stamp_ns])
        decided += int(seen.classes.lidar_decided.sum())
    assert decided
    for entry in chain.fuse_all(chain.session.settings, 0.0, layer):
        if isinstance(entry, FusedFrame):
            assert_same_frames(entry, passed[entry.match.stamp_ns])


@pytest.fixture(scope="module")
def labelled_run(bedroom, scenes, tmp_path_factory):
    """The bedroom fused with a burr on beams of every scan, half of them outside of all images, and
    on a corner of every image; the layer, and the folder."""
    with open_recording(bedroom.recording) as recording:
        session = open_session(recording, FuseOptions(), DEFAULT)
        layer = MemoryLayer()
        lidar, topic = session.streams.lidar, session.rig.cameras[0].topic
        for message in recording.messages([lidar, topic]):
            if message.topic == lidar:
                scan = scan_capture(message.value, session)
                beams = np.arange(0, scan.columns, 5)
                layer.put(CaptureLabels.of_samples(scan, np.zeros_like(beams), beams, BURR))
            else:
                image = image_capture(message.value, 0, session)
                codes = np.full((image.rows, image.columns), NO_LABEL)
                codes[:4, :6], codes[4:6, :6] = BURR, GOOD
                layer.put(CaptureLabels.of_image(image, codes))
    folder = tmp_path_factory.mktemp("labelled") / "results"
    fuse(bedroom.recording, folder, FuseOptions(figures=False, labels=layer))
    return layer, folder


def topic_values(file, topic):
    with open_recording(file) as recording:
        return [message.value for message in recording.messages([topic])]


def test_a_run_with_labels_says_so_and_is_another_run(bedroom, labelled_run) -> None:
    layer, folder = labelled_run
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["labels"] == {"name": "anna", "sha256": layer.sha256}
    assert "labels" not in json.loads((bedroom.folder / "manifest.json").read_text())
    again = FuseOptions(figures=False, labels=layer)
    assert fuse(bedroom.recording, folder, again).skipped
    renamed = MemoryLayer(*(layer.labels_of(own) for own in layer.captures()), name="ben")
    for labels in (renamed, None):
        request = RunRequest(
            command="fuse", inputs=[bedroom.recording], settings_text="", seed=0, labels=labels
        )
        own = replace(plan_output(folder, request).run, settings_sha256=manifest["settings_sha256"])
        assert not Manifest.read(folder).matches(own)
    own = replace(own, labels=LabelsDigest("anna", layer.sha256))
    assert Manifest.read(folder).matches(own)


def test_labels_of_nothing_change_no_result(bedroom, tmp_path) -> None:
    output = tmp_path / "results"
    fuse(bedroom.recording, output, FuseOptions(figures=False, labels=MemoryLayer()))
    own, plain = (Manifest.read(folder).results for folder in (output, bedroom.folder))
    assert own.keys() == plain.keys()
    different = {name for name in own if own[name] != plain[name]}
    # Those that name the layer, and the recording with the topic of the pixels' classes.
    assert different == {"alignment.json", "summary.json", "fused.mcap"}


def test_labels_hold_outside_of_all_pairs(labelled_run, bedroom) -> None:
    _, folder = labelled_run
    scans = topic_values(folder / "fused.mcap", "/scan")
    plain = topic_values(bedroom.folder / "fused.mcap", "/scan")
    assert len(scans) == len(plain)
    filled = 0
    for scan, before in zip(scans, plain, strict=True):
        assert (scan.intensities[::5] == BURR).all()
        raw = before.intensities == GOOD
        raw[np.arange(raw.size) % 5 > 0] = False
        assert not (scan.ranges_m[raw] == before.ranges_m[raw]).any()
        filled += int(np.isfinite(scan.ranges_m[raw]).sum())
        assert np.isnan(scan.ranges_m[raw]).any()
    assert filled
    images = topic_values(folder / "fused.mcap", "/camera/depth/image_raw")
    for image in images:
        assert np.isnan(image.depth_m[:4, :6]).all()


def test_the_pixels_classes_stand_beside_the_repaired_image(labelled_run) -> None:
    _, folder = labelled_run
    table = pq.read_table(folder / "samples.parquet")
    column = {name: table[name].to_numpy() for name in table.column_names}
    typestore, seen = get_typestore(Stores.ROS2_HUMBLE), 0
    with (folder / "fused.mcap").open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages(
            ["/camera/depth/image_raw/class"]
        ):
            image = typestore.deserialize_cdr(message.data, schema.name)
            assert image.encoding == "8SC1"
            codes = image.data.view(np.int8).reshape(image.height, image.width)
            own = column["stamp_ns"] == message.publish_time
            own &= np.isfinite(column["depth_row"])
            row, place = (column[name][own].astype(int) for name in ("depth_row", "depth_column"))
            expected = np.full(codes.shape, -1)
            expected[row, place] = column["depth_class"][own]
            expected[:4, :6], expected[4:6, :6] = BURR, GOOD
            np.testing.assert_array_equal(codes, expected)
            seen += bool(own.any())
    assert seen > 40


def test_a_map_takes_labels_for_repaired_scans_alone(bedroom, tmp_path) -> None:
    for kind in ("lidar", "camera", "merged"):
        with pytest.raises(SettingsError, match=f"--scan {kind} takes no labels"):
            build_map(bedroom.recording, tmp_path, MapOptions(scan=kind, labels=MemoryLayer()))


def test_repaired_scans_of_a_map_are_those_of_fuse(bedroom, labelled_run) -> None:
    layer, folder = labelled_run
    fused_scans = topic_values(folder / "fused.mcap", "/scan")
    with open_recording(bedroom.recording) as recording:
        streams = choose_streams(recording)
        sensors = RecordedSensors(recording=recording, streams=streams)
        scans = RepairedScans(sensors, DEFAULT, labels=layer)
        for scan, other in zip(scans, fused_scans, strict=True):
            np.testing.assert_allclose(scan.ranges_m[::5], other.ranges_m[::5], atol=1e-6)
        assert "The labels of anna overrule the classes." in scans.notes


def test_rejected_beams_of_the_scans_before_and_after_are_no_evidence(chain) -> None:
    match = fused(chain, 20).match
    window = match.pair.window
    layer = MemoryLayer()
    beams = {"before": [3, 400], "scan": [7], "after": [400]}
    for name, own in beams.items():
        capture = scan_capture(getattr(window, name), chain.session)
        layer.put(CaptureLabels.of_samples(capture, np.zeros(len(own), int), np.array(own), HOLE))
    labels = SessionLabels(session=chain.session, layer=layer).of_match(match)
    trusted = labels.without_rejected(window)
    for name, own in beams.items():
        scan = getattr(window, name)
        expected = scan.ranges_m.copy()
        expected[own] = np.nan
        np.testing.assert_array_equal(getattr(trusted, name).ranges_m, expected)
        assert getattr(trusted, name).stamp_ns == scan.stamp_ns
