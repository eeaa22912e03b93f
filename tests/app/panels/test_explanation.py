"""Words of why: each from classes and repairs that the chain itself makes of a small frame.

A frame has a beam for each column, a wall two metres ahead, flat to both sensors.
"""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import classify
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.denoising.repair import RepairSettings, repair
from fusion_core.model.classes import RepairSource
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.settings import ChainSettings
from scanloom.panels.explanation import (
    explain_beam_class,
    explain_beam_repair,
    explain_pixel_class,
    explain_pixel_repair,
    length,
)
from scanloom.scene.frame_summary import BeamFacts, facts_of_beam
from tests.denoising.seen_scans import seen

BEAMS, ROWS, ROW = 41, 61, 30
SCALE = NoiseScale(floor_m=0.02, fraction=0.0)
# Not the defaults: the words must hold however those are tuned. Epsilon is 6 cm here.
SETTINGS = ChainSettings(
    noise=NoiseSettings(epsilon=3.0, support_sigma=3.0),
    repair=RepairSettings(
        farther_confidence=0.7,
        lidar_burr_confidence=0.0,
        depth_burr_confidence=0.5,
        lidar_confidence=0.5,
        max_gap_deg=8.0,
        check_nearby=False,
    ),
)
PUBLISHED = ChainSettings(
    noise=NoiseSettings(epsilon=0.06, epsilon_unit="m", burr_criterion="rougher"),
    repair=RepairSettings(
        prefer="other_sensor",
        farther_confidence=0.0,
        lidar_burr_confidence=0.0,
        check_nearby=False,
    ),
)


def wall() -> np.ndarray:
    return np.full(BEAMS, 2.0)


def wall_image() -> np.ndarray:
    return np.full((ROWS, BEAMS), 2.0, dtype=np.float32)


def scan_of(ranges_m: np.ndarray) -> LaserScan:
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        angle_min_rad=-0.16,
        angle_increment_rad=1.0 / 128.0,
        range_min_m=0.05,
        range_max_m=8.0,
        ranges_m=np.array(ranges_m, dtype=np.float64),
    )


def facts(
    lidar: np.ndarray,
    image: np.ndarray,
    *,
    beam: int = 20,
    settings: ChainSettings = SETTINGS,
    camera: np.ndarray | None = None,
    row: np.ndarray | None = None,
    compared: bool = True,
    steady: bool = False,
    before: np.ndarray | None = None,
) -> BeamFacts:
    """Facts of a beam after the chain judged the frame. ``camera``: its answers along the rays."""
    scan = scan_of(lidar)
    row = np.full(BEAMS, ROW) if row is None else row
    column = np.where(row >= 0, np.arange(BEAMS), -1)
    depth = np.where(row >= 0, image[ROW, np.arange(BEAMS)], np.nan).astype(np.float64)
    pairs = Correspondence(
        model="curve",
        beam=np.arange(BEAMS),
        row=row,
        column=column,
        azimuth_rad=scan.angles_rad,
        lidar_range_m=scan.ranges_m,
        depth_m=depth,
        depth_as_range_m=depth,
        lidar_as_depth_m=scan.ranges_m.copy(),
        camera_range_m=depth.copy() if camera is None else camera,
        camera_blocked=np.zeros(BEAMS, dtype=np.bool_),
        residual_m=(depth - scan.ranges_m) if compared else np.full(BEAMS, np.nan),
    )
    again = seen(scan.ranges_m)
    window = FrameWindow(
        pairs=pairs,
        scan=scan,
        depth_m=image,
        scan_before=again if steady else None,
        scan_after=again if steady else None,
        depth_before_m=before,
    )
    classes = classify(window, settings.noise, SCALE, 0.05)
    repaired = repair(window, classes, SCALE, settings.repair)
    match = SimpleNamespace(correspondence=pairs)
    found = facts_of_beam(SimpleNamespace(match=match, classes=classes, repair=repaired), beam)
    assert found is not None
    return found


def with_values(values: np.ndarray, value: float, *where: int | slice) -> np.ndarray:
    changed = values.copy()
    for place in where:
        changed[..., place] = value
    return changed


def test_a_pair_that_agrees() -> None:
    said = facts(with_values(wall(), 2.03, 20), wall_image())
    assert explain_beam_class(said, SETTINGS) == (
        "Good: it differs from the camera by 3.0 cm, within ε (6.0 cm)."
    )
    assert explain_pixel_class(said, SETTINGS) == (
        "Good: it differs from the LiDAR by 3.0 cm, within ε (6.0 cm)."
    )
    assert explain_beam_repair(said, SETTINGS) == "Kept: good values are not changed."
    assert explain_pixel_repair(said, SETTINGS) == "Kept: good values are not changed."


def test_a_lone_beam_is_a_burr_and_its_pixel_good() -> None:
    said = facts(with_values(wall(), 1.69, 20), wall_image())
    assert explain_beam_class(said, SETTINGS) == (
        "Burr: it disagrees with the camera by 31.0 cm, more than ε (6.0 cm), and the "
        "evidence is against a surface (beside it -2.4, in time +0.0, by the camera -2.3): no "
        "adjacent beam supports it (beams two or three away: 0, scans before and after: 0)."
    )
    assert explain_pixel_class(said, SETTINGS) == (
        "Good: it disagrees with the LiDAR by 31.0 cm, more than ε (6.0 cm), but 24 of the "
        "24 depths around it support it. Its beam is the burr."
    )


def test_the_smaller_expected_error_is_named_with_the_greater() -> None:
    said = facts(with_values(wall(), np.nan, slice(15, 26)), wall_image())
    assert explain_beam_class(said, SETTINGS) == "Hole: the LiDAR returned no range."
    # Half the noise of 2 cm; over a gap of 12 beams 0.6 of it and a tenth of its width.
    assert explain_beam_repair(said, SETTINGS) == (
        "Filled from the camera: expected error 1.0 cm against 3.1 cm from its neighbours."
    )
    no_camera = facts(with_values(wall(), np.nan, 20), wall_image(), camera=np.full(BEAMS, np.nan))
    words = explain_beam_repair(no_camera, SETTINGS)
    assert re.fullmatch(
        r"Filled from its neighbours: expected error 1\.\d cm; the camera gives no value\.", words
    )


def test_a_camera_that_contradicts_a_narrow_gap_is_named() -> None:
    said = facts(with_values(wall(), np.nan, 20), wall_image(), camera=with_values(wall(), 3.0, 20))
    assert "the camera's range, 3.00 m, contradicts both sides of a narrow gap" in (
        explain_beam_repair(said, SETTINGS)
    )


def test_a_camera_that_looks_past_something_nearer_is_named() -> None:
    """The box beside the lost beam is for the LiDAR alone."""
    box = with_values(with_values(wall(), 1.2, slice(21, 30)), np.nan, slice(15, 21))
    checked = SETTINGS.model_copy(
        update={"repair": SETTINGS.repair.model_copy(update={"check_nearby": True})}
    )
    said = facts(box, wall_image(), settings=checked)
    assert said.lidar.source == RepairSource.NONE
    assert "something nearer was seen about this direction" in explain_beam_repair(said, checked)


def test_a_hole_that_nothing_fills() -> None:
    everything = facts(np.full(BEAMS, np.nan), np.full_like(wall_image(), np.nan))
    assert explain_beam_repair(everything, SETTINGS) == (
        "Left empty: the camera gives no value, and its neighbours give no value."
    )
    assert explain_pixel_class(everything, SETTINGS) == "Hole: the camera gave no depth."
    assert explain_pixel_repair(everything, SETTINGS) == (
        "Left empty: the LiDAR has no range here, and its neighbours give no value."
    )


def test_a_conflict_keeps_both() -> None:
    said = facts(wall(), with_values(wall_image(), 1.2, slice(15, 26)))
    assert explain_beam_class(said, SETTINGS) == (
        "Conflict: it disagrees with the camera by 80.0 cm, more than ε (6.0 cm), but the "
        "evidence is for a surface (beside it +4.8, in time +0.0, by the camera -2.3): both "
        "adjacent beams support it (beams two or three away: 4, scans before and after: 0). "
        "Each sensor sees another surface."
    )
    assert explain_pixel_class(said, SETTINGS).startswith(
        "Conflict: it disagrees with the LiDAR by 80"
    )
    for repaired in (explain_beam_repair, explain_pixel_repair):
        assert repaired(said, SETTINGS).startswith("Kept: in a conflict both values stay")


def test_a_burr_that_a_repair_would_move_farther_needs_confidence() -> None:
    lidar = with_values(wall(), 1.2, 20)
    sure = facts(lidar, wall_image())
    assert explain_beam_repair(sure, SETTINGS).startswith(
        "Replaced from the camera: expected error"
    )
    strict = SETTINGS.model_copy(
        update={"repair": SETTINGS.repair.model_copy(update={"farther_confidence": 1.0})}
    )
    doubtful = facts(with_values(lidar, 1.2, 18), wall_image(), settings=strict, camera=wall())
    assert doubtful.lidar.confidence < 1.0
    words = explain_beam_repair(doubtful, strict)
    assert words.startswith("Kept: a repair would move it farther away, and its confidence as a")
    assert words.endswith("is below 1.00.")


def test_a_burr_that_the_other_scans_have_too_is_kept() -> None:
    lidar = with_values(wall(), 1.2, 20)
    strict = SETTINGS.model_copy(
        update={"noise": SETTINGS.noise.model_copy(update={"burr_odds": 1000.0})}
    )
    said = facts(lidar, wall_image(), steady=True, camera=wall(), settings=strict)
    assert explain_beam_class(said, strict).startswith("Burr: it disagrees")
    assert explain_beam_repair(said, strict) == (
        "Kept: the scans before and after show it at the same place."
    )


def test_a_burr_of_too_little_confidence_or_seen_beside_is_kept() -> None:
    strict = SETTINGS.model_copy(
        update={"repair": SETTINGS.repair.model_copy(update={"lidar_burr_confidence": 1.0})}
    )
    said = facts(with_values(wall(), 1.2, 20), wall_image(), settings=strict)
    words = explain_beam_repair(said, strict)
    assert re.fullmatch(r"Kept: its confidence as a burr, 0\.9\d, is below 1\.00\.", words)
    image = wall_image()
    image[ROW + 1 : ROW + 4, 18:23] = 1.2
    said = facts(with_values(wall(), 1.2, 20), image)
    assert explain_beam_class(said, SETTINGS).startswith("Burr: it disagrees")
    assert explain_beam_repair(said, SETTINGS) == "Kept: the camera sees its range beside it."


def test_a_pixel_that_looks_through_a_pane() -> None:
    pane = slice(15, 26)
    said = facts(
        with_values(wall(), 1.2, pane), with_values(wall_image(), 2.8, pane), camera=wall()
    )
    assert explain_beam_class(said, SETTINGS).endswith("Its pixel is the burr.")
    assert explain_pixel_class(said, SETTINGS) == (
        "Burr: it disagrees with the LiDAR by 1.60 m, more than ε (6.0 cm), and its beam has "
        "met a surface that the camera shows nowhere around: it looks through it."
    )


def test_a_burr_with_nothing_to_take_from() -> None:
    lidar = np.full(BEAMS, np.nan)
    lidar[20] = 1.2
    said = facts(lidar, np.full_like(wall_image(), np.nan))
    assert explain_beam_class(said, SETTINGS) == (
        "Burr: the camera has no depth here to compare it with, and too few support it: no "
        "adjacent beam supports it (beams two or three away: 0, scans before and after: 0)."
    )
    assert explain_beam_repair(said, SETTINGS) == (
        "Kept: the camera gives no value, and its neighbours give no value."
    )


def test_a_beam_whose_point_lies_outside_the_image() -> None:
    row = np.full(BEAMS, ROW)
    row[20] = -1
    said = facts(wall(), wall_image(), row=row)
    assert explain_pixel_class(said, SETTINGS) == (
        "No pixel: the beam's point lies outside the image."
    )
    assert explain_pixel_repair(said, SETTINGS) == ""
    assert explain_beam_class(said, SETTINGS).startswith(
        "Good: its point lies outside the image, with nothing to compare it with, and both "
    )


def test_a_lone_pixel_is_a_burr_and_its_beam_good() -> None:
    image = wall_image()
    image[ROW, 20] = 1.2
    said = facts(wall(), image, camera=wall())
    assert explain_pixel_class(said, SETTINGS) == (
        "Burr: it disagrees with the LiDAR by 80.0 cm, more than ε (6.0 cm), and too few "
        "pixels agree: 0 of the 24 depths around it support it."
    )
    assert explain_beam_class(said, SETTINGS).endswith("Its pixel is the burr.")
    assert explain_pixel_repair(said, SETTINGS).startswith("Replaced from its neighbours: expected")
    assert "from the LiDAR" in explain_pixel_repair(said, SETTINGS)


def test_a_speckle_that_the_image_before_lacks() -> None:
    image = wall_image()
    image[ROW - 1 : ROW + 2, 19:22] = 1.2
    said = facts(wall(), image, camera=wall(), before=wall_image())
    assert "and the image before shows no such surface there; 8 of the 24" in (
        explain_pixel_class(said, SETTINGS)
    )


def test_a_pixel_that_is_no_sure_burr_is_kept() -> None:
    image = wall_image()
    image[ROW - 1 : ROW + 2, 19:22] = 1.2
    strict = SETTINGS.model_copy(
        update={"repair": SETTINGS.repair.model_copy(update={"depth_burr_confidence": 0.9})}
    )
    said = facts(wall(), image, camera=wall(), before=wall_image(), settings=strict)
    assert explain_pixel_repair(said, strict) == (
        "Kept: its confidence as a burr, 0.65, is below 0.90."
    )


@pytest.mark.parametrize(
    ("lidar_m", "settings", "refused"),
    [
        (1.2, SETTINGS, "the beam is a burr and not used as a source"),
        (np.nan, SETTINGS, "the LiDAR has no range here"),
    ],
)
def test_why_a_pixel_is_not_taken_from_its_beam(
    lidar_m: float, settings: ChainSettings, refused: str
) -> None:
    image = wall_image()
    image[ROW, 20] = np.nan
    said = facts(with_values(wall(), lidar_m, 20), image, settings=settings, camera=wall())
    assert explain_pixel_repair(said, settings).endswith(f"; {refused}.")


def test_a_beam_that_is_not_sure_enough_is_no_source() -> None:
    image = with_values(wall_image(), np.nan, 20)
    strict = SETTINGS.model_copy(
        update={"repair": SETTINGS.repair.model_copy(update={"lidar_confidence": 1.0})}
    )
    # Good without a pair, and supported by all beams around but one.
    said = facts(with_values(wall(), 1.5, 22), image, camera=wall(), settings=strict)
    assert said.lidar.confidence < 1.0
    words = explain_pixel_repair(said, strict)
    assert (
        f"; the beam's confidence, {np.floor(100 * said.lidar.confidence) / 100:.2f}, is" in words
    )


def test_a_table_top_that_hides_the_beams_end() -> None:
    image = np.full((ROWS, BEAMS), 1.2, dtype=np.float32)
    image[ROW - 1 : ROW + 2, 19:22] = np.nan
    said = facts(wall(), image, camera=wall())
    assert explain_pixel_repair(said, SETTINGS).endswith(
        "; the pixels around it are nearer and may occlude the LiDAR's point."
    )


def test_at_an_edge_both_may_mix_alike() -> None:
    edge = np.where(np.arange(BEAMS) < 20, 2.0, 3.0)
    edge[20] = 2.5
    said = facts(edge, np.tile(edge, (ROWS, 1)).astype(np.float32))
    assert explain_beam_class(said, SETTINGS).startswith(
        "Burr: it and its pixel do not disagree, but neither has enough support."
    )
    assert explain_pixel_class(said, SETTINGS).startswith("Burr: it and its beam do not disagree")


def test_in_the_paper_the_rougher_side_is_the_burr_and_the_other_sensor_is_preferred() -> None:
    said = facts(with_values(wall(), 1.2, 20), wall_image(), settings=PUBLISHED)
    assert explain_beam_class(said, PUBLISHED).endswith(
        "and it deviates from its neighbours no less than its pixel does."
    )
    assert explain_pixel_class(said, PUBLISHED).endswith(
        "but its beam deviates no less from its neighbours. Its beam is the burr."
    )
    assert explain_beam_repair(said, PUBLISHED) == (
        "Replaced from the camera: expected error 1.0 cm. The other sensor is preferred, "
        "regardless of the neighbours."
    )
    image = wall_image()
    image[ROW, 20] = 1.2
    said = facts(wall(), image, settings=PUBLISHED)
    assert explain_pixel_class(said, PUBLISHED).endswith(
        "and it deviates more from its neighbours than its beam does."
    )
    assert explain_beam_class(said, PUBLISHED).endswith(
        "but its pixel deviates more from its neighbours. Its pixel is the burr."
    )


def test_a_frame_without_an_a_compares_nothing() -> None:
    said = facts(wall(), wall_image(), compared=False, settings=PUBLISHED)
    assert explain_beam_class(said, PUBLISHED) == (
        "Good: this frame has no transform A, so that nothing is compared."
    )


@pytest.mark.parametrize(
    ("metres", "said"),
    [(0.3104, "31.0 cm"), (-0.02, "-2.0 cm"), (1.0, "1.00 m"), (np.inf, "–"), (np.nan, "–")],
)
def test_lengths(metres: float, said: str) -> None:
    assert length(metres) == said
