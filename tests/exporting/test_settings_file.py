"""Settings as TOML: all of them out, and only what is right in."""

import tomllib
from functools import partial
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.settings_file import dump_toml, load_toml, read_preset
from fusion_core.model.errors import SettingsError
from fusion_core.settings import StageSettings, setting
from tests.hostile.files import write_pipe


class Search(StageSettings):
    metric: Literal["pearson", "cosine"] = setting("pearson", "Score")
    overlap: float = setting(0.5, "Least overlap", unit="share", ge=0.0, le=1.0)
    draws: int = setting(84, "Draws", ge=1, le=10_000_000_000)
    partial: bool = setting(False, "Beyond the ends")
    band: tuple[float, float] = setting((0.0, 1.0), "Band")
    limit_m: float | None = setting(None, "Limit", unit="m", gt=0.0)


class Repair(StageSettings):
    gap_deg: float = setting(3.0, "Widest gap", unit="deg", gt=0.0)


STAGES: dict[str, type[StageSettings]] = {"search": Search, "repair": Repair}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "settings.toml"


def test_every_key_with_its_help(path: Path) -> None:
    text = dump_toml({"search": Search(draws=9), "repair": Repair()}, "published")
    assert text == (
        'preset = "published"\n\n'
        "[search]\n"
        "# Score: pearson | cosine\n"
        'metric = "pearson"\n'
        "# Least overlap [share]: at least 0.0, at most 1.0\n"
        "overlap = 0.5\n"
        "# Draws: at least 1, at most 10000000000\n"
        "draws = 9\n"
        "# Beyond the ends\n"
        "partial = false\n"
        "# Band\n"
        "band = [0.0, 1.0]\n"
        "# Limit [m]: more than 0.0\n"
        "# limit_m is not set\n\n"
        "[repair]\n"
        "# Widest gap [deg]: more than 0.0\n"
        "gap_deg = 3.0\n"
    )
    path.write_text(text)
    assert read_preset(path) == "published"
    assert tomllib.loads(text)["repair"] == {"gap_deg": 3.0}


searches = st.builds(
    Search,
    metric=st.sampled_from(["pearson", "cosine"]),
    overlap=st.floats(0.0, 1.0),
    draws=st.integers(1, 10**10),
    partial=st.booleans(),
    band=st.tuples(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300)),
    limit_m=st.none() | st.floats(0.0, 1e300, exclude_min=True),
)


@given(searches, st.floats(0.0, 1e300, exclude_min=True))
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, search: Search, gap_deg: float
) -> None:
    stages = {"search": search, "repair": Repair(gap_deg=gap_deg)}
    path = tmp_path_factory.mktemp("settings") / "settings.toml"
    path.write_text(dump_toml(stages, "default"))
    assert load_toml(path, STAGES) == stages


def test_missing_keys_come_from_the_base_or_the_default(path: Path) -> None:
    path.write_text("[search]\noverlap = 1\n")
    assert read_preset(path) is None
    assert load_toml(path, STAGES) == {"search": Search(overlap=1.0), "repair": Repair()}
    base = {"search": Search(draws=5, overlap=0.1, limit_m=2.0)}
    assert load_toml(path, STAGES, base) == {
        "search": Search(draws=5, overlap=1.0, limit_m=2.0),
        "repair": Repair(),
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[serach]\n", "unknown stage 'serach'. Stages: search, repair."),
        ("search = 3\n", "search must be a table, got 3."),
        ("[search]\noverlop = 1\n", "unknown key search.overlop. Keys: metric, overlap, draws"),
        ("[search]\noverlap = 1.5\n", "search.overlap = 1.5: Input should be less than or equal"),
        ("[search]\noverlap = 1.5\n", "Allowed: at least 0.0, at most 1.0."),
        ("[search]\noverlap = '0.5'\n", "search.overlap = '0.5': Input should be a valid number"),
        ("[search]\noverlap = true\n", "search.overlap = True: Input should be a valid number"),
        ("[search]\noverlap = nan\n", "search.overlap = nan: Input should be a finite number"),
        ("[search]\noverlap = 2000-01-01\n", "Input should be a valid number"),
        ("[search]\ndraws = 1.5\n", "search.draws = 1.5: Input should be a valid integer"),
        ("[search]\nmetric = 'l1'\n", "search.metric = 'l1': "),
        ("[search]\nmetric = 'l1'\n", "Allowed: pearson | cosine."),
        ("[search]\nband = [1.0]\n", "search.band = [1.0]: "),
        ("[repair]\ngap_deg = 0\n", "repair.gap_deg = 0: Input should be greater than 0"),
        ("[search]\na = 1\na = 2\n", "is not TOML"),
        ("[search\n", "is not TOML"),
        ("x = " + "[" * 10_000, "is not TOML"),
    ],
)
def test_an_invalid_key_or_value_is_named(path: Path, text: str, words: str) -> None:
    path.write_text(text)
    with pytest.raises(SettingsError) as error:
        load_toml(path, STAGES)
    assert words in str(error.value)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[search]\ndraws = " + "9" * 10_000, "holds a number of thousands of digits"),
        ("[search]\ndraws = 0x" + "f" * 10_000, "search.draws = ...: holds a number of thousands"),
        ("[search]\ndraws = " + "9" * 4_000, "search.draws = 999"),
        ("[search]\nband = [0x" + "f" * 10_000 + "]", "search.band = ...: holds a number"),
        ("search = 0x" + "f" * 10_000, "search must be a table, got ..."),
        ("preset = 0x" + "f" * 10_000, "preset must be text, got ..."),
        ("[search]\nx" + ".a" * 5_000 + " = 1", "nested too deeply"),
        ("[search]\n" + "o" * 10_000 + " = 1", "unknown key search.oooo"),
        ("[" + "o" * 10_000 + "]", "unknown stage 'oooo"),
    ],
    ids=lambda text: text[:20],
)
def test_endless_numbers_and_names_are_abbreviated(path: Path, text: str, words: str) -> None:
    path.write_text(text)
    read = read_preset if text.startswith("preset") else partial(load_toml, stages=STAGES)
    with pytest.raises(SettingsError) as error:
        read(path)
    assert words in str(error.value)
    assert len(error.value.problem) < 200


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read: it is not a regular file"):
        read_preset(write_pipe(tmp_path / "pipe"))


def test_files_that_cannot_be_read(path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read: No such file"):
        load_toml(path, STAGES)
    path.write_bytes(b"\xff")
    with pytest.raises(SettingsError, match="is not TOML"):
        load_toml(path, STAGES)
    path.write_text("preset = 1\n")
    with pytest.raises(SettingsError, match="preset must be text, got 1"):
        read_preset(path)


class Renamed(StageSettings):
    range_max_m: float = setting(8.0, "Greatest range", unit="m", gt=0.0, formerly="reach_m")


def test_a_key_of_an_earlier_version_is_read_and_its_new_name_given(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path.write_text("[grid]\nreach_m = 5.0\n")
    assert load_toml(path, {"grid": Renamed}, {"grid": Renamed()}) == {
        "grid": Renamed(range_max_m=5.0)
    }
    assert caplog.messages == [f"{path}: grid.reach_m is now called grid.range_max_m."]


def test_a_key_under_both_its_names_is_refused(path: Path) -> None:
    path.write_text("[grid]\nreach_m = 5.0\nrange_max_m = 6.0\n")
    with pytest.raises(SettingsError, match=r"unknown key grid\.reach_m"):
        load_toml(path, {"grid": Renamed})
