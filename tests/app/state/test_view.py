"""A view as a link and back, and what becomes of values that no view can have."""

import base64
import json
import re
import zlib
from typing import Any, get_args

import msgspec.msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import SettingsError
from fusion_core.workflows.fuse.settings import PRESETS, PresetName
from scanloom.state.slam_choices import (
    ESTIMATORS,
    MOTIONS,
    PARTICLES_MAX,
    PARTICLES_MIN,
    SCANS,
    SlamChoices,
)
from scanloom.state.view import MAP_MODES, PANELS, Scope, View, view_of_link

# What the page of a link takes (scanloom.server.pages), and what a URL holds without being
# escaped.
LONGEST_LINK = 6_000
IN_A_URL = re.compile(r"[A-Za-z0-9_-]+")

NAMES = st.text(max_size=40)
SETTINGS = st.one_of(
    st.tuples(st.just("sampling"), st.just("step_deg"), st.floats(0.06, 5.0)),
    st.tuples(st.just("sampling"), st.just("row_band"), st.floats(0.01, 1.0)),
    st.tuples(st.just("search"), st.just("metric"), st.sampled_from(["pearson", "cosine"])),
    st.tuples(st.just("search"), st.just("mask_holes"), st.booleans()),
    st.tuples(st.just("registration"), st.just("draws"), st.integers(1, 10_000)),
    st.tuples(st.just("noise"), st.just("epsilon"), st.floats(0.01, 10.0)),
    st.tuples(st.just(""), st.just("pairing"), st.sampled_from(["mount", "frame"])),
)
SLAM = st.builds(
    SlamChoices,
    scan=st.sampled_from(SCANS),
    motion=st.sampled_from(MOTIONS),
    estimator=st.sampled_from(ESTIMATORS),
    particles=st.integers(PARTICLES_MIN, PARTICLES_MAX),
)


@st.composite
def views(draw: st.DrawFn) -> View:
    preset: PresetName = draw(st.sampled_from(get_args(PresetName)))
    base = View(
        recording=draw(NAMES),
        preset=preset,
        settings=PRESETS[preset],
        alignment_settings=PRESETS[preset],
    )
    changed = [base, base]
    for place in range(2):
        for stage, name, value in draw(st.lists(SETTINGS, max_size=4)):
            changed[place] = changed[place].with_setting(stage, name, value)
    return base.changed(
        settings=changed[0].settings,
        alignment_settings=changed[1].settings,
        frame_index=draw(st.integers(0, 10**6)),
        panel=draw(st.sampled_from(PANELS)),
        lidar_topic=draw(st.none() | NAMES),
        depth_topics=tuple(draw(st.lists(NAMES, max_size=4))),
        virtual_row=draw(st.none() | st.integers(0, 100_000)),
        apply_clock_offset=draw(st.booleans()),
        field_scope=draw(st.sampled_from(get_args(Scope))),
        picked_offset=draw(st.none() | st.tuples(st.floats(-1e5, 1e5), st.floats(0.0, 1e5))),
        lock_picked_offset=draw(st.booleans()),
        draw_index=draw(st.integers(0, 99_999)),
        visible_classes=draw(st.frozensets(st.sampled_from(NoiseClass))),
        show_repaired=draw(st.booleans()),
        show_raw_and_repaired=draw(st.booleans()),
        selected_beam=draw(st.none() | st.integers(0, 10**6)),
        row_step=draw(st.integers(1, 60)),
        playback_speed=draw(st.floats(0.1, 8.0)),
        loop_playback=draw(st.booleans()),
        map_mode=draw(st.sampled_from(MAP_MODES)),
        slam=draw(SLAM),
    )


def link_of(values: Any) -> str:
    """Anything at all, packed as a link is."""
    packed = zlib.compress(json.dumps(values).encode())
    return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def values_of(view: View) -> dict[str, Any]:
    """What is packed in a view's link."""
    link = view.to_link()
    values = json.loads(zlib.decompress(base64.urlsafe_b64decode(link + "=" * (-len(link) % 4))))
    assert isinstance(values, dict)
    return values


def refusal_of(link: str) -> str:
    """The one line that says why a link is refused."""
    with pytest.raises(SettingsError) as refused:
        view_of_link(link)
    said = str(refused.value)
    assert said.startswith("the link cannot be followed: ")
    assert said.isprintable()
    assert len(said) < 300
    return said


VIEW = View(recording="room.mcap")


@given(view=views())
def test_a_link_restores_the_view(view: View) -> None:
    link = view.to_link()
    assert view_of_link(link) == view
    assert view_of_link(link).to_link() == link
    assert IN_A_URL.fullmatch(link)


@given(view=views())
def test_a_link_is_short_enough_for_its_page(view: View) -> None:
    assert len(view.to_link()) <= LONGEST_LINK


def test_a_link_holds_of_the_settings_only_what_differs_from_the_preset() -> None:
    changed = VIEW.with_setting("noise", "epsilon", 3.5).with_setting("", "pairing", "frame")
    assert values_of(VIEW)["settings"] == {}
    assert values_of(changed)["settings"] == {"noise": {"epsilon": 3.5}, "": {"pairing": "frame"}}
    assert changed.preset_overrides() == values_of(changed)["settings"]


def test_a_preset_differs_in_nothing_from_itself() -> None:
    published = PRESETS["published"]
    assert VIEW.changed(preset="published", settings=published).preset_overrides() == {}
    assert "epsilon" in VIEW.changed(settings=published).preset_overrides()["noise"]


@pytest.mark.parametrize(
    ("stage", "name", "value", "needed"),
    [
        ("sampling", "step_deg", 2.0, True),
        ("search", "metric", "cosine", True),
        ("", "pairing", "frame", True),
        ("noise", "epsilon", 2.0, False),
        ("registration", "draws", 7, False),
    ],
)
def test_only_what_the_alignment_reads_asks_for_another(
    stage: str, name: str, value: Any, needed: bool
) -> None:
    assert not VIEW.needs_alignment()
    assert VIEW.with_setting(stage, name, value).needs_alignment() == needed


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("frame_index", -1),
        ("frame_index", 1.5),
        ("frame_index", "first"),
        ("frame_index", None),
        ("map_mode", "Both"),
        ("slam", {"scan": "sonar"}),
        ("slam", {"particles": 10_000}),
        ("panel", "Kitchen"),
        ("panel", ["Match"]),
        ("preset", "best"),
        ("recording", None),
        ("recording", "x" * 4097),
        ("recording", "\ud800"),
        ("lidar_topic", 5),
        ("depth_topics", "/depth"),
        ("depth_topics", ("/depth",) * 65),
        ("virtual_row", -1),
        ("field_scope", "year"),
        ("picked_offset", (1.0,)),
        ("picked_offset", (1.0, float("nan"))),
        ("picked_offset", (float("inf"), 1.0)),
        ("picked_offset", (1e300, 1.0)),
        ("picked_offset", (1.0, -2.0)),
        ("draw_index", 100_000),
        ("visible_classes", [9]),
        ("visible_classes", "hole"),
        ("show_repaired", "perhaps"),
        ("selected_beam", -1),
        ("row_step", 0),
        ("playback_speed", 0.0),
        ("playback_speed", 100.0),
        ("loop_playback", 7),
        ("settings", {"noise": {"epsilon": "wide"}}),
        ("settings", {"noise": 3}),
        ("colour", "red"),
    ],
)
def test_a_refused_value_is_one_line_that_names_it(name: str, value: Any) -> None:
    with pytest.raises(SettingsError) as refused:
        VIEW.changed(**{name: value})
    said = str(refused.value)
    assert said.startswith(name)
    assert said.isprintable()
    assert said.endswith("The value before is kept.")


@pytest.mark.parametrize(
    ("stage", "name", "value"),
    [
        ("noise", "epsilon", -1.0),
        ("noise", "epsilon", float("nan")),
        ("noise", "epsilon", "wide"),
        ("noise", "epsilon_unit", "feet"),
        ("sampling", "step_deg", 0.0),
        ("sampling", "row_band", 1.01),
        ("search", "metric", "guess"),
        ("registration", "draws", 2.5),
        ("registration", "draws", 10**9),
        ("", "pairing", "luck"),
    ],
)
def test_a_refused_setting_is_one_line_that_names_it(stage: str, name: str, value: Any) -> None:
    with pytest.raises(SettingsError) as refused:
        VIEW.with_setting(stage, name, value)
    said = str(refused.value)
    assert said.startswith(f"{stage}.{name}: " if stage else f"{name}: ")
    assert said.isprintable()


def test_a_link_cut_anywhere_is_refused() -> None:
    link = VIEW.with_setting("noise", "epsilon", 3.5).to_link()
    for length in range(len(link)):
        assert "Copy it again, whole." in refusal_of(link[:length])


@pytest.mark.parametrize(
    "link",
    ["", "=", "a", "é", "\x00", "not base64!", "A" * 5_000, "../../etc/passwd", "<script>"],
)
def test_what_is_no_link_is_refused(link: str) -> None:
    assert "it is no link of a view" in refusal_of(link)


@pytest.mark.parametrize(
    "values",
    [
        [],
        None,
        "view",
        {},
        {"preset": "default"},
        {"preset": [], "settings": {}, "alignment_settings": {}},
        {"preset": "default", "settings": [], "alignment_settings": {}},
        {"preset": "default", "settings": {"": 5}, "alignment_settings": {}},
        {"preset": "default", "settings": {"noise": 5}, "alignment_settings": {}},
        {"preset": "default", "settings": {"pairing": {}}, "alignment_settings": {}},
    ],
)
def test_a_link_of_another_shape_is_refused(values: Any) -> None:
    refusal_of(link_of(values))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("unknown", 1),
        ("a\nb\x1b[31m", 1),
        ("k" * 5_000, 1),
        ("frame_index", "1\n2"),
        ("frame_index", -1),
        ("picked_offset", [float("nan"), 0.0]),
        ("recording", {"a": 1}),
        ("settings", {"noise": {"epsilon\n": 1}}),
        ("settings", {"kitchen": {"sink": 1}}),
        ("alignment_settings", {"": {"\u2028": 1}}),
    ],
)
def test_a_link_with_a_refused_value_says_so_in_one_line(name: str, value: Any) -> None:
    refusal_of(link_of(values_of(VIEW) | {name: value}))


# As JSON spells them.
NONSENSE = {
    "2^63": str(2**63),
    "2^64": str(2**64),
    "below -2^63": str(-(2**63) - 1),
    "thousands of digits": "9" * 5000,
    "beyond all floats": "1e400",
    "below all floats": "-1e400",
    "nan": "NaN",
    "infinite": "-Infinity",
}
NUMBERS = [
    ("selected_beam",),
    ("frame_index",),
    ("draw_index",),
    ("row_step",),
    ("playback_speed",),
    ("virtual_row",),
    ("picked_offset", 0),
    ("slam", "particles"),
    ("visible_classes", 0),
    ("settings", "registration", "seed"),
    ("settings", "registration", "draws"),
    ("settings", "noise", "epsilon"),
    ("alignment_settings", "mount", "delta_z_min_m"),
    ("alignment_settings", "time", "max_gap_ms"),
]


def link_with(place: tuple[Any, ...], value: str) -> str:
    """A link of which one value is another, given as JSON."""
    values = values_of(VIEW.changed(picked_offset=(1.0, 2.0), selected_beam=3))
    inner: Any = values
    for part in place[:-1]:
        inner = inner.setdefault(part, {}) if isinstance(inner, dict) else inner[part]
    inner[place[-1]] = "the value"
    text = json.dumps(values).replace('"the value"', value)
    return base64.urlsafe_b64encode(zlib.compress(text.encode())).decode().rstrip("=")


@pytest.mark.parametrize("value", NONSENSE.values(), ids=NONSENSE.keys())
@pytest.mark.parametrize("place", NUMBERS, ids=lambda place: ".".join(map(str, place)))
def test_a_number_that_is_none_is_refused_by_its_name(place: tuple[Any, ...], value: str) -> None:
    assert ".".join(map(str, place)) in refusal_of(link_with(place, value))


@given(
    place=st.sampled_from(NUMBERS),
    value=st.integers() | st.floats() | st.integers(2**60, 2**70) | st.integers(-(2**70), -1),
)
def test_a_view_holds_no_number_that_a_browser_cannot_be_sent(
    place: tuple[Any, ...], value: float
) -> None:
    link = link_with(place, json.dumps(value))
    try:
        view = view_of_link(link)
    except SettingsError:
        assert str(place[0]) in refusal_of(link)
    else:
        sent = msgspec.msgpack.encode(view.model_dump(mode="json"))
        assert view == View.model_validate(msgspec.msgpack.decode(sent))


def test_a_link_that_unpacks_to_more_than_any_view_is_not_unpacked() -> None:
    assert "no link" in refusal_of(link_of(values_of(VIEW) | {"recording": "x" * 50_000_000}))


def test_links_of_hostile_json_are_refused() -> None:
    nested = b'{"preset":' + b"[" * 30_000
    digits = b'{"preset":"default","frame_index":' + b"9" * 30_000 + b"}"
    for text in (nested, digits, b"\xff\xfe", b'{"preset":"default"'):
        refusal_of(base64.urlsafe_b64encode(zlib.compress(text)).decode())


@given(text=st.text(max_size=200))
def test_any_text_is_a_view_or_refused(text: str) -> None:
    refusal_of(text)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)


@given(values=st.dictionaries(st.sampled_from(sorted(View.model_fields)), JSON, max_size=4))
def test_any_values_are_a_view_or_refused_in_one_line(values: dict[str, Any]) -> None:
    link = link_of(values_of(VIEW) | values)
    try:
        view = view_of_link(link)
    except SettingsError:
        refusal_of(link)
    else:
        assert view_of_link(view.to_link()) == view


@given(place=st.integers(0, 10_000), sign=st.sampled_from("AZaz09-_"))
def test_a_link_with_a_wrong_letter_is_the_same_view_or_refused(place: int, sign: str) -> None:
    link = VIEW.with_setting("noise", "epsilon", 3.5).to_link()
    place %= len(link)
    wrong = link[:place] + sign + link[place + 1 :]
    # The last letter has bits to spare, and a checksum is over the rest.
    if view_or_none(wrong) != view_of_link(link):
        refusal_of(wrong)


def view_or_none(link: str) -> View | None:
    try:
        return view_of_link(link)
    except SettingsError:
        return None


# Written when the fields of a view had their former names.
OLD_LINK = (
    "eNq1UcFu2zAM_RVD59Rx3AZDe9t9u6zHYjBYmU6ESqJAyQ2GIP8-knGB_cBu9HtP5PN7VwcxnDLO7qW7ukyhok1Yao"
    "iUZR77423XOcZTqI2hBUOvbma4VJmeBqUrAvuzEQkbBy-jKwJWkd9UAaXEP5OP5D8mWpaKTSSNVxTuHSHJ1_OzztR0"
    "zwKxKuUj1Ip66O2w68bfAs1Y2nlqVII33O09JGTYG7EPCU44iTtnYh1eusM3mWOYge8P1d6-eshOcfUk4IfFsHmKRO"
    "UfHwnKlGjWdNzrj-8_9V1e0zuyZiDWXIGMUelfFpUQCn5tfTuM_XjcdY9DP6ivwniPQH5ngTU2ZyF74jnkk-LLyjnU"
    "M84TE6U-eSh3TYHAtvPLG9NlkoNq91G78FTM5yXkmS7O6mlN1tb_2bKGFPJEn8gR1MvQP1nzNVq7cq42KacR2zPgFn"
    "zEhyXELaxE210npW_5bSr1cBzs58AUUvhJQrD9BS2OsVfBZ-C2QpTQtPe8xnj7C31S6qk"
)
OLD_PUBLISHED_LINK = (
    "eNrtU1tu3DAMvMpC39vFJlu0RQ_Qv5ygKARapm0hehCUlEWwyN1LUc4DaE9Q9MeQRHI4HI5vBoJfE87m--Fm9EPg2a"
    "dVzibmlqp5OR5Myr6ghpGKDznJ-f70RSL73bbka68pfo1gJLBAC-OlEWUeOIyrL5WheoW4mbUBz0WOlRsee8sZQ69i"
    "v_q545SaiXZCMANV_4Q7VqeqKDNS3ezUmK3LafEzJtfpnk_flAnXDf8IfZVQ8DP8tYYYF2SlHyEEqUbmzNq4QKQwGN"
    "3M9KzE0hqws-V8tROkrufd6azZCOw2zY1QHu2WA34cGCt71zGwOaGDkHTqNlnto7mf5aUVtMQ-817bsauPYysuR8JU"
    "oKKtjdNrSs8BovBsXcju0eZlKdiXskAovfuEEOWaWgj9luv2zswFKEXb_zwfD3fHw_3xcPklgaG2rMU7jeobw7WL96"
    "apht-htb28PKrVXtuHnOmDFEC277-L8UPG7TqkFifdw6UvBdIwxwNQD77h7U1kaWM8Q20KvmyoDmJ0mefdQovIoxHL"
    "OcdTdANqmEnBdjZ9k6Vi59d9XlwmZbYwRKUmraqAlv-_zr_665Sgf4dsrkg6VAUwlAt-WhloM6r6vpDdZsNyJLp5Nx"
    "hczmof0CRVbUhBiPuscnvyXBsEMeV19_PLb0xV0FQ"
)


def test_links_with_former_field_names_are_read() -> None:
    view = View(
        recording="furnished_room.mcap",
        frame_index=41,
        panel="Register",
        lidar_topic="/scan",
        depth_topics=("/camera/depth/image_raw",),
        apply_clock_offset=True,
        field_scope="window",
        picked_offset=(12.25, 30.0),
        lock_picked_offset=True,
        draw_index=17,
        visible_classes=frozenset({NoiseClass.BURR, NoiseClass.HOLE}),
        show_repaired=False,
        show_raw_and_repaired=False,
        selected_beam=99,
        row_step=3,
        playback_speed=2.0,
        loop_playback=False,
        map_mode="SLAM",
        slam=SlamChoices(scan="merged", motion="laser", estimator="particle-filter", particles=50),
    )
    for stage, name, value in (
        ("noise", "epsilon", 2.5),
        ("registration", "draws", 40),
        ("search", "metric", "pearson"),
    ):
        view = view.with_setting(stage, name, value)
    view = view.changed(alignment_settings=view.settings)
    assert view_of_link(OLD_LINK) == view.with_setting("search", "min_overlap", 0.4)
    published = view_of_link(OLD_PUBLISHED_LINK)
    assert (published.preset, published.panel, published.frame_index) == ("published", "Map", 3)
    # It was made with the default settings under the preset's name, of which it holds those that
    # differed at that time.
    expected = published.changed(settings=PRESETS["default"])
    for name in (
        "check_nearby",
        "max_gap_deg",
        "max_gap_pixels",
        "edge_m",
        "lidar_burr_confidence",
    ):
        value = getattr(PRESETS["published"].repair, name)
        expected = expected.with_setting("repair", name, value)
    assert published.settings == expected.settings


def test_a_former_name_beside_the_current_one_is_refused() -> None:
    assert "number" in refusal_of(link_of(values_of(VIEW) | {"number": 3}))


@pytest.mark.parametrize(
    ("frame_index", "by", "looping", "ending"),
    [(3, 1, 4, 4), (4, 1, 0, 4), (0, -1, 4, 0), (2, 9, 1, 4), (2, -9, 3, 0)],
)
def test_steps_go_around_the_ends_or_stop_at_them(
    frame_index: int, by: int, looping: int, ending: int
) -> None:
    assert VIEW.changed(loop_playback=True).frame_after(frame_index, by, 5) == looping
    assert VIEW.changed(loop_playback=False).frame_after(frame_index, by, 5) == ending
