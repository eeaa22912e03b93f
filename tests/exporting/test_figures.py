"""The figures: right places, the same bytes each time, and nothing that fails on poor data."""

import itertools
import json
import struct
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting import figures
from fusion_core.exporting.figures import (
    COLUMN_IN,
    continuous_deg,
    describe_delay,
    far_limit_m,
    format_stamp,
    png_figure,
)
from fusion_core.exporting.figures_alignment import (
    CurvePair,
    FieldPanel,
    MetricColumn,
    SynchronizedFrame,
    write_aligned,
    write_similarity,
)
from fusion_core.exporting.figures_maps import write_maps
from fusion_core.exporting.figures_registration import (
    RansacPairs,
    RecallCurves,
    write_pairs,
    write_recall,
)
from fusion_core.exporting.figures_repair import (
    RepairedCurve,
    fused_depth_m,
    longest_run,
    rectify_band_m,
    write_fused_depth,
    write_repair,
)
from fusion_core.exporting.map_axes import seen_extent
from fusion_core.exporting.palette import BURR, DEPTH, FUSED, GOOD, LIDAR, PALETTE
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.conventions import ByteArray, Float32Array
from fusion_core.model.errors import ExportError
from fusion_core.model.grids import MapDifference, OccupancyGrid
from fusion_core.model.sensors import LaserScan

ROOT = Path(__file__).parents[2]
HEIGHT, WIDTH = 24, 32


def chunks(png: bytes) -> Iterator[bytes]:
    """Types of a PNG's chunks."""
    position = 8
    while position < len(png):
        size, kind = struct.unpack_from(">I4s", png, position)
        yield kind
        position += 12 + size


def pixels(path: Path) -> ByteArray:
    """(H, W, 3) RGB of a picture."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    assert image is not None
    return np.asarray(image, dtype=np.uint8)


def where(path: Path, color: str, *, within: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels that have a colour, or one close to it at a thin line."""
    wanted = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return np.nonzero((np.abs(pixels(path).astype(int) - wanted) < within).all(axis=2))


def depth_image(seed: int = 0) -> Float32Array:
    generator = np.random.default_rng(seed)
    depth_m = generator.uniform(1.0, 4.0, (HEIGHT, WIDTH)).astype(np.float32)
    depth_m[generator.random((HEIGHT, WIDTH)) < 0.2] = np.nan
    return depth_m


def curve_of(depth_m: Float32Array, beams: int = 20) -> RepairedCurve:
    """Beams across the image with every class and source, the last without a pixel."""
    index = np.arange(beams)
    row = np.where(index == beams - 1, -1, 12 + index % 3)
    column = np.where(index == beams - 1, -1, index)
    raw_m = np.where(row >= 0, depth_m[row, column], np.nan).astype(np.float64)
    source = index % 4
    repaired = np.isin(source, (RepairSource.OTHER_SENSOR, RepairSource.NEIGHBOURS)) & (row >= 0)
    lidar_class = index % 4
    lidar_m = np.where(lidar_class == NoiseClass.HOLE, np.nan, 2.0 + 0.1 * index)
    return RepairedCurve(
        azimuth_rad=0.3 - 0.02 * index,
        row=row,
        column=column,
        lidar_m=lidar_m,
        lidar_repaired_m=np.where(lidar_class == NoiseClass.HOLE, 2.5, lidar_m),
        lidar_class=lidar_class,
        lidar_source=np.where(lidar_class == NoiseClass.HOLE, 1 + index // 10, 0),
        depth_m=raw_m,
        depth_repaired_m=np.where(repaired, 3.25, raw_m),
        depth_class=np.where(row >= 0, (index // 2) % 4, -1),
        depth_source=np.where(repaired, source, int(RepairSource.RAW)),
        depth_as_range_m=1.05 * raw_m,
        camera_range_m=np.full(beams, 2.2),
    )


def scan() -> LaserScan:
    ranges_m = np.linspace(1.0, 5.0, 60)
    ranges_m[10:14] = np.nan
    return LaserScan(
        stamp_ns=2_000_000_000,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-1.5,
        angle_increment_rad=0.05,
        range_min_m=0.1,
        range_max_m=6.0,
        ranges_m=ranges_m,
    )


def panel(scores: np.ndarray, peak: tuple[float, float] | None = (3.0, 5.0)) -> FieldPanel:
    return FieldPanel(
        scores=scores,
        u_first=0,
        peak=peak,
        runner_up=None if peak is None else (8.0, 2.0),
        peak_score=0.9,
        yaw_at_zero_deg=40.0,
        step_deg=1.0,
        mount_u=4.5,
        middle_row=12.0,
        focal_px=30.0,
    )


def draw_all(folder: Path) -> None:
    """Every figure, from small made-up values."""
    depth_m = depth_image()
    curve = curve_of(depth_m)
    color = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    write_aligned(
        folder / "fig3.png",
        "heading",
        SynchronizedFrame(
            color=color,
            color_after_ms=-3.0,
            depth_m=depth_m,
            depth_stamp_ns=2_010_000_000,
            scan=scan(),
            gap_ns=10_000_000,
            beams_in_view=np.arange(20, 40),
            has_nominal_stamps=False,
        ),
    )
    scores = np.random.default_rng(2).random((HEIGHT, 12))
    curves = CurvePair(lidar_m=np.linspace(1, 2, 9), depth_m=np.linspace(1.1, 2.2, 9))
    field = panel(scores)
    write_similarity(
        folder / "fig4.png",
        "heading",
        [
            MetricColumn(name="one", frame=field, recording=field, curves=curves),
            MetricColumn(name="two", frame=field, recording=field, curves=curves),
        ],
        mean_of="7 frames",
    )
    x = np.linspace(-1.0, 1.0, 40)
    lidar = np.stack([x, 2.0 + 0.0 * x], axis=1)
    far = np.abs(x) > 0.9
    write_pairs(
        folder / "fig5.png",
        "heading",
        RansacPairs(
            lidar_points_m=lidar,
            depth_points_m=lidar + np.where(far, 0.6, 0.2)[:, np.newaxis] * [0.0, 1.0],
            inliers=~far,
            model="rigid",
            mean_error_m=0.1,
            threshold_m=0.25,
            draws=84,
            axis_names=("x (m)", "z (m)"),
        ),
    )
    factors = np.linspace(0.2, 6.0, 30)
    write_recall(
        folder / "fig6.png",
        "heading",
        RecallCurves(
            epsilon_over_E=factors,
            xi=list(1.0 - np.exp(-factors)),
            eta=list(np.exp(-0.1 * factors)),
            band=(1.0, 2.0**0.5),
            own_epsilon_over_E=2.0,
            own_xi=0.9,
            own_eta=0.8,
        ),
    )
    write_repair(folder / "fig7.png", "heading", depth_m, curve)
    write_fused_depth(folder / "fig8.png", "heading", color=color, depth_m=depth_m, curve=curve)
    write_maps(folder / "fig9.png", "heading", grids(), difference())


def grid_with(row: int, column: int) -> OccupancyGrid:
    """40 x 40 free cells of 10 cm and a 3 x 3 obstacle."""
    log_odds = np.full((40, 40), -1.0)
    log_odds[row : row + 3, column : column + 3] = 3.0
    log_odds[0, :] = np.nan
    return OccupancyGrid(resolution_m=0.1, origin_m=(-2.0, -2.0), log_odds=log_odds)


def grids() -> dict[str, OccupancyGrid]:
    return {"lidar": grid_with(30, 5), "fused": grid_with(30, 30), "camera": grid_with(5, 30)}


def difference() -> MapDifference:
    states = np.full((40, 40), MapDifference.FREE, dtype=np.uint8)
    states[30:33, 5:8] += 1
    states[30:33, 30:33] += 2
    return MapDifference(
        names=("lidar", "fused"), resolution_m=0.1, origin_m=(-2.0, -2.0), states=states
    )


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drawn")
    draw_all(folder)
    return folder


def test_the_workbench_has_the_same_colours() -> None:
    static = json.loads((ROOT / "static" / "palette.json").read_text(encoding="utf-8"))
    assert static == PALETTE


@pytest.mark.slow
def test_the_bytes_are_the_same_whatever_the_users_settings(drawn: Path, tmp_path: Path) -> None:
    with mpl.rc_context({"font.size": 20.0, "lines.linewidth": 9.0, "savefig.dpi": 300}):
        draw_all(tmp_path)
    names = sorted(path.name for path in drawn.iterdir())
    assert len(names) == 7
    for name in names:
        assert (tmp_path / name).read_bytes() == (drawn / name).read_bytes(), name


@pytest.mark.slow
def test_titles_stand_where_a_search_for_a_free_place_puts_them(
    drawn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(figures._STYLE, "axes.titley")
    draw_all(tmp_path)
    for path in sorted(drawn.iterdir()):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.parametrize("number", range(3, 10))
def test_figures_hold_only_pixels_and_fit_a_column(drawn: Path, number: int) -> None:
    path = drawn / f"fig{number}.png"
    png = path.read_bytes()
    assert set(chunks(png)) == {b"IHDR", b"IDAT", b"IEND"}
    assert len(png) < 300 * 1024
    height, width = pixels(path).shape[:2]
    # At 300 dots an inch, on a page of 9 inches.
    assert width == round(300 * COLUMN_IN)
    assert height <= 300 * 9


@pytest.mark.parametrize("number", range(3, 10))
def test_no_letter_reaches_the_edge(drawn: Path, number: int) -> None:
    picture = pixels(drawn / f"fig{number}.png")
    for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert (edge == 255).all()


def test_panel_positions_are_rounded(tmp_path: Path) -> None:
    # The solver of the layout differs in the last digits; see the reason beside the rounding.
    with png_figure(tmp_path / "a.png", "heading", height_in=1.0) as figure:
        panels = figure.subplots(1, 3)
    for axes in panels:
        assert all(round(value, 5) == value for value in axes.get_position(True).extents[:2])


def test_parts_of_a_figure_are_rounded(tmp_path: Path) -> None:
    with png_figure(tmp_path / "a.png", "heading", height_in=2.0) as figure:
        parts = figure.subfigures(2, 1, height_ratios=(2.0, 1.0))
        for part in parts:
            part.subplots().set_title("title")
    for part in parts:
        assert all(round(value, 5) == value for value in part.bbox_relative.extents)


def test_a_failed_drawing_leaves_no_file(tmp_path: Path) -> None:
    with (
        pytest.raises(ZeroDivisionError),
        png_figure(tmp_path / "a.png", "heading", height_in=0.7),
    ):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_an_export_error(tmp_path: Path) -> None:
    with pytest.raises(ExportError):
        write_maps(tmp_path / "none" / "fig9.png", "heading", grids(), None)


def test_dollars_in_names_do_not_begin_formulas(tmp_path: Path) -> None:
    with png_figure(tmp_path / "a.png", r"room $\frac$ 1", height_in=0.7):
        pass
    assert (tmp_path / "a.png").exists()


def rows_by_panel(path: Path, color: str, *, within: int = 48) -> list[np.ndarray]:
    """Rows of the pixels that have a colour, in each of the three panels; the legend is below."""
    height = pixels(path).shape[0]
    rows, _ = where(path, color, within=within)
    ends = [0.0, 0.36 * height, 0.65 * height, 0.93 * height]
    return [rows[(rows >= low) & (rows < high)] for low, high in itertools.pairwise(ends)]


def test_outlier_pairs_are_drawn_in_their_colour_in_the_middle_panel_only(drawn: Path) -> None:
    first, outliers, last = rows_by_panel(drawn / "fig5.png", BURR)
    assert first.size == last.size == 0
    assert outliers.size > 0
    # Where a LiDAR point touches a depth point, the mixture is nearly as green as an inlier.
    first, inliers, last = rows_by_panel(drawn / "fig5.png", GOOD, within=24)
    assert first.size == 0
    assert inliers.size > 0
    assert last.size > 0
    # The made-up outliers stand at both ends of the curve.
    rows, columns = where(drawn / "fig5.png", BURR)
    good_rows, good_columns = where(drawn / "fig5.png", GOOD)
    outliers = columns[np.isin(rows, outliers)]
    inliers = good_columns[np.isin(good_rows, inliers)]
    assert outliers.min() < inliers.min()
    assert inliers.max() < outliers.max()
    assert not ((outliers > inliers.min()) & (outliers < inliers.max())).any()


def test_lidar_lies_below_depth_where_it_is_nearer(drawn: Path) -> None:
    lidar, depth = (rows_by_panel(drawn / "fig5.png", color) for color in (LIDAR, DEPTH))
    assert depth[0].mean() < lidar[0].mean()


def obstacle(path: Path) -> tuple[float, float]:
    """Height and width, as fractions from the lower left, of the black block in a picture."""
    dark = (pixels(path).max(axis=2) < 50).astype(np.uint8)
    # Text, axes and the scale bar are thinner than 17 pixels.
    rows, columns = np.nonzero(cv2.erode(dark, np.ones((17, 17), dtype=np.uint8)))
    height, width = dark.shape
    return 1.0 - float(rows.mean()) / height, float(columns.mean()) / width


@pytest.mark.parametrize(("row", "column"), [(30, 5), (5, 25)])
def test_maps_have_y_upwards_and_x_to_the_right(row: int, column: int, tmp_path: Path) -> None:
    states = np.full((40, 40), MapDifference.FREE, dtype=np.uint8)
    states[row : row + 3, column : column + 3] += 3
    both = MapDifference(
        names=("lidar", "fused"), resolution_m=0.1, origin_m=(-2.0, -2.0), states=states
    )
    write_maps(tmp_path / "map.png", "heading", {"lidar": grid_with(row, column)}, None)
    write_maps(tmp_path / "difference.png", "heading", {}, both)
    for name in ("map.png", "difference.png"):
        up, right = obstacle(tmp_path / name)
        assert (up > 0.5) == (row > 20), name
        assert (right > 0.5) == (column > 20), name


def test_cells_of_one_map_only_are_drawn_at_their_place(drawn: Path) -> None:
    # LiDAR cells on the left, fused ones on the right of the lowest panel, both above its middle.
    height, width = pixels(drawn / "fig9.png").shape[:2]
    places = []
    for color in (LIDAR, BURR):
        rows, columns = where(drawn / "fig9.png", color)
        shown = rows > 0.55 * height
        assert rows[shown].max() < 0.75 * height
        places.append(columns[shown].mean())
    assert places[0] < 0.5 * width < places[1]


@pytest.mark.parametrize("cells", [(0, 0), (3, 5), (10, 30)])
def test_maps_are_cropped_to_what_was_seen(cells: tuple[int, int]) -> None:
    row, column = cells
    log_odds = np.full((40, 60), np.nan)
    log_odds[row : row + 4, column : column + 8] = -1.0
    grid = OccupancyGrid(resolution_m=0.1, origin_m=(-2.0, 1.0), log_odds=log_odds)
    left, right, bottom, top = seen_extent([grid])
    margin_m = 0.1
    assert (left, right) == pytest.approx(
        (-2.0 + 0.1 * column - margin_m, -2.0 + 0.1 * (column + 8) + margin_m)
    )
    assert (bottom, top) == pytest.approx(
        (1.0 + 0.1 * row - margin_m, 1.0 + 0.1 * (row + 4) + margin_m)
    )


def test_a_long_heading_is_broken(tmp_path: Path) -> None:
    with png_figure(tmp_path / "a.png", "letters " * 40, height_in=2.0) as figure:
        figure.subplots()
    heading = figure.get_suptitle()
    assert heading.count("\n") > 2
    assert max(map(len, heading.splitlines())) < 80


def test_the_difference_counts_its_cells_by_mask() -> None:
    from matplotlib.figure import Figure

    from fusion_core.exporting import figures_maps

    figure = Figure()
    handles = figures_maps._show_difference(figure.subplots(), difference())
    assert [handle.get_label() for handle in handles] == [
        "obstacle in both: 0 cells",
        "only in the LiDAR map: 9 cells",
        "only in the fused map: 9 cells",
    ]
    assert handles[0].get_facecolor() == mpl.colors.to_rgba(FUSED)


def test_only_repaired_pixels_change_in_the_fused_image() -> None:
    depth_m = depth_image()
    curve = curve_of(depth_m)
    before = depth_m.copy()
    fused_m = fused_depth_m(depth_m, curve)
    np.testing.assert_array_equal(depth_m, before)
    expected_m = before.copy()
    for row, column, source, value in zip(
        curve.row, curve.column, curve.depth_source, curve.depth_repaired_m, strict=True
    ):
        if source in (RepairSource.OTHER_SENSOR, RepairSource.NEIGHBOURS):
            expected_m[row, column] = value
    np.testing.assert_array_equal(fused_m, expected_m)
    assert (fused_m == 3.25).sum() > 5


def test_the_rectified_band_has_the_rows_around_each_pixel() -> None:
    depth_m = depth_image()
    curve = curve_of(depth_m)
    band_m, outside = rectify_band_m(depth_m, curve)
    beams = curve.row.size
    assert band_m.shape == (15, 2 * beams)
    for shown in range(2 * beams):
        # Equal angles: column k of 2 B stands for the beam nearest to k (B - 1) / (2 B - 1).
        beam = round(shown * (beams - 1) / (2 * beams - 1))
        for k in range(15):
            row = curve.row[beam] + k - 7
            has_pixel = curve.row[beam] >= 0 and 0 <= row < HEIGHT
            assert outside[k, shown] == (not has_pixel)
            if has_pixel:
                np.testing.assert_equal(
                    band_m[k, shown], np.float64(depth_m[row, curve.column[beam]])
                )


def test_memory_of_the_band_grows_only_with_its_beams() -> None:
    """Angles of each column and each beam would be gigabytes."""
    depth_m, beams = depth_image(), 20_000
    curve = curve_of(depth_m)
    copies = np.arange(beams) % curve.row.size
    fields = {name: getattr(curve, name)[copies] for name in RepairedCurve.__slots__}
    fields["azimuth_rad"] = np.linspace(3.0, -3.0, beams)
    tracemalloc.start()
    try:
        band_m, _ = rectify_band_m(depth_m, RepairedCurve(**fields))
        assert tracemalloc.get_traced_memory()[1] < 10 * band_m.nbytes
    finally:
        tracemalloc.stop()


def test_the_band_is_empty_where_beams_are_missing() -> None:
    depth_m = depth_image()
    curve = curve_of(depth_m)
    keep = np.r_[0:6, 14:19]
    fields = {name: getattr(curve, name)[keep] for name in RepairedCurve.__slots__}
    _, outside = rectify_band_m(depth_m, RepairedCurve(**fields))
    middle = outside[7]
    assert not middle[:6].any()
    assert middle[8:12].all()


@given(st.lists(st.booleans(), max_size=30))
def test_of_equal_runs_the_first_is_the_longest(mask: list[bool]) -> None:
    best: list[int] = []
    run: list[int] = []
    for i, chosen in enumerate(mask):
        run = [*run, i] if chosen else []
        best = run if len(run) > len(best) else best
    assert longest_run(np.array(mask, dtype=np.bool_)).tolist() == best


@given(st.floats(-3.1, 3.1), st.floats(0.1, 2.5))
def test_azimuths_have_no_jump_and_keep_their_direction(middle: float, half_view: float) -> None:
    azimuth = middle + np.linspace(-half_view, half_view, 50)
    wrapped = np.angle(np.exp(1j * azimuth))
    degrees = continuous_deg(wrapped, middle)
    assert np.abs(np.diff(degrees)).max() < 1.1 * np.rad2deg(2 * half_view / 49)
    np.testing.assert_allclose(np.exp(1j * np.deg2rad(degrees)), np.exp(1j * azimuth), atol=1e-9)


@pytest.mark.parametrize(
    ("stamp_ns", "text"),
    [
        (0, "0.000 s"),
        (4_866_666_666, "4.867 s"),
        (1_700_000_002_999_600_000, "1700000003.000 s"),
    ],
)
def test_stamps_are_rounded_to_milliseconds(stamp_ns: int, text: str) -> None:
    assert format_stamp(stamp_ns) == text


def test_delays_are_described_as_text() -> None:
    assert describe_delay(46.3, "the scan") == "46.3 ms after the scan"
    assert describe_delay(-2.0, "the scan") == "2.0 ms before the scan"
    assert describe_delay(0.0, "the scan") == "at the stamp of the scan"


def test_the_depth_scale_ends_beyond_nearly_all_depths() -> None:
    depth_m = np.full((100, 100), 2.0, dtype=np.float32)
    depth_m[0, 0] = 60.0
    assert far_limit_m(depth_m) == pytest.approx(2.0)
    assert far_limit_m(np.full((3, 3), np.nan, dtype=np.float32)) == 1.0


@pytest.mark.parametrize("beams", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_poor_frames_are_drawn_too(beams: int, tmp_path: Path) -> None:
    depth_m = np.full((HEIGHT, WIDTH), np.nan, dtype=np.float32)
    curve = curve_of(depth_m, max(beams, 1))
    fields = {name: getattr(curve, name)[:beams] for name in RepairedCurve.__slots__}
    curve = RepairedCurve(**fields)
    write_repair(tmp_path / "fig7.png", "heading", depth_m, curve)
    write_fused_depth(tmp_path / "fig8.png", "heading", color=None, depth_m=depth_m, curve=curve)
    write_aligned(
        tmp_path / "fig3.png",
        "heading",
        SynchronizedFrame(
            color=None,
            color_after_ms=None,
            depth_m=depth_m,
            depth_stamp_ns=0,
            scan=scan().with_ranges(np.full(60, np.nan), None),
            gap_ns=0,
            beams_in_view=np.arange(beams),
            has_nominal_stamps=True,
        ),
    )
    assert len(list(tmp_path.iterdir())) == 3


def test_missing_fields_pairs_and_recalls_are_drawn_as_missing(tmp_path: Path) -> None:
    nothing = np.full((HEIGHT, 12), np.nan)
    write_similarity(
        tmp_path / "fig4.png",
        "heading",
        [
            MetricColumn(name="a", frame=None, recording=panel(nothing, None), curves=None),
            MetricColumn(
                name="b", frame=panel(np.zeros((HEIGHT, 12)), None), recording=None, curves=None
            ),
        ],
        mean_of="0 frames",
    )
    write_pairs(
        tmp_path / "fig5.png",
        "heading",
        RansacPairs(
            lidar_points_m=np.full((4, 2), np.nan),
            depth_points_m=np.full((4, 2), np.nan),
            inliers=np.zeros(4, dtype=np.bool_),
            model="rigid",
            mean_error_m=float("inf"),
            threshold_m=0.1,
            draws=1,
            axis_names=("x (m)", "z (m)"),
        ),
    )
    write_recall(
        tmp_path / "fig6.png",
        "heading",
        RecallCurves(
            epsilon_over_E=np.array([1.0, 2.0]),
            xi=None,
            eta=None,
            band=(1.0, 1.4),
            own_epsilon_over_E=float("nan"),
            own_xi=None,
            own_eta=None,
        ),
    )
    write_maps(tmp_path / "fig9.png", "heading", {"camera": grid_with(5, 5)}, None)
    assert len(list(tmp_path.iterdir())) == 4
