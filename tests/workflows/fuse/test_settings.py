"""The two presets, and a settings file over them."""

import itertools

import pytest

from fusion_core.exporting.settings_file import dump_toml
from fusion_core.model.errors import SettingsError
from fusion_core.workflows.fuse.settings import PRESETS, chain_settings
from fusion_core.workflows.map.settings import map_settings
from tests.hostile.settings import (
    NUMBERS,
    write_nested_key,
    write_number,
    write_swapped_ends,
    write_wide_search,
)

# What Xu 2024 does, with our reading where its text does not decide.
PUBLISHED = {
    "pairing": "frame",
    "time.compensate_motion": False,
    "sampling.by": "index",
    "sampling.step_deg": 1.0,
    "sampling.row_first": 0,
    "sampling.row_band": 0.5,
    "search.metric": "pearson",
    "search.mask_holes": False,
    "search.allow_partial": False,
    "search.use_prior": False,
    "search.sub_samples": 1,
    "registration.model": "affine",
    "registration.sample_size": 6,
    "registration.stopping": "fixed",
    "registration.draws": 84,
    "registration.guards": False,
    "noise.epsilon": 1.2,
    "noise.epsilon_unit": "E",
    "noise.burr_criterion": "rougher",
    "repair.prefer": "other_sensor",
    # Every burr is repaired and every good value believed, however sure its class.
    "repair.farther_confidence": 0.0,
    "repair.lidar_burr_confidence": 0.0,
    "repair.depth_burr_confidence": 0.0,
    "repair.lidar_confidence": 0.0,
    # Gaps are closed however wide, and between whatever surfaces.
    "repair.max_gap_deg": 180.0,
    "repair.max_gap_pixels": 100,
    "repair.edge_m": 100.0,
    # The paper repairs each frame alone.
    "repair.check_nearby": False,
}


def flat(settings):
    values = {}
    for name, value in settings.model_dump().items():
        if isinstance(value, dict):
            values |= {f"{name}.{key}": entry for key, entry in value.items()}
        else:
            values[name] = value
    return values


def test_published_is_the_paper_where_it_decides_and_the_default_elsewhere():
    published, default = flat(PRESETS["published"]), flat(PRESETS["default"])
    assert PUBLISHED.items() <= published.items()
    assert {name for name in default if default[name] != published[name]} <= PUBLISHED.keys()


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_a_settings_file_goes_over_the_preset_and_leaves_the_rest(tmp_path):
    file = write(tmp_path / "s.toml", "[noise]\nepsilon = 2.5\n[repair]\nmax_gap_deg = 3.0\n")
    for preset in PRESETS:
        name, settings = chain_settings(preset, file, None)
        expected = flat(PRESETS[preset]) | {"noise.epsilon": 2.5, "repair.max_gap_deg": 3.0}
        assert name == preset
        assert flat(settings) == expected


def test_a_file_that_names_a_preset_decides_on_it(tmp_path):
    file = write(tmp_path / "s.toml", 'preset = "published"\n[search]\nmetric = "cosine"\n')
    name, settings = chain_settings("default", file, None)
    assert name == "published"
    assert flat(settings) == flat(PRESETS["published"]) | {"search.metric": "cosine"}


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('preset = "publicized"\n', "'publicized'.*default, published"),
        ("preset = 3\n", "preset"),
        ("[noise]\nepsilom = 2.0\n", "noise.epsilom"),
        ("[nose]\nepsilon = 2.0\n", "'nose'"),
        ("[noise]\nepsilon = -1.0\n", "noise.epsilon"),
        ('[noise]\nepsilon = "much"\n', "noise.epsilon"),
        ("[registration]\nmodel = 'homography'\nsample_size = 3\n", "sample_size"),
        ("pairing = 'frame'\n", "pairing"),
        ("[noise\n", "TOML"),
    ],
)
def test_what_a_file_has_wrong_is_named(tmp_path, text, named):
    file = write(tmp_path / "wrong.toml", text)
    with pytest.raises(SettingsError, match=named) as failure:
        chain_settings("default", file, None)
    assert failure.value.file == str(file)


@pytest.mark.parametrize("number", NUMBERS.values(), ids=NUMBERS)
def test_a_number_that_the_work_cannot_take_is_refused(tmp_path, number):
    file = write_number(tmp_path / "s.toml", number)
    with pytest.raises(SettingsError, match=r"delta_z_min_m|thousands of digits") as failure:
        chain_settings("default", file, None)
    assert len(str(failure.value)) < 500


def test_a_key_of_thousands_of_parts_is_refused(tmp_path):
    file = write_nested_key(tmp_path / "s.toml")
    with pytest.raises(SettingsError, match=r"mount\.x = \.\.\.: .* nested too deeply"):
        chain_settings("default", file, None)


def test_the_ends_of_a_range_stay_in_order(tmp_path):
    file = write_swapped_ends(tmp_path / "s.toml")
    with pytest.raises(SettingsError, match=r"delta_z_min_m = 2 must be less than delta_z_max_m"):
        chain_settings("default", file, None)


def test_what_several_stages_make_together_is_checked(tmp_path):
    file = write_wide_search(tmp_path / "s.toml")
    with pytest.raises(SettingsError, match=r"window_max_m = 100 over .*resolution_m = 0\.01"):
        map_settings("default", file)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_out_of_range_is_refused(seed):
    for settings_of in (chain_settings, map_settings):
        with pytest.raises(SettingsError, match="seed must be from 0 to 9223372036854775807"):
            settings_of("default", None, seed)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"nowhere\.toml"):
        chain_settings("default", tmp_path / "nowhere.toml", None)


@pytest.mark.parametrize("preset", PRESETS)
def test_written_settings_repeat_the_run(tmp_path, preset):
    start = write(
        tmp_path / "start.toml", f'preset = "{preset}"\n[mount]\nframes = 7\n[grid]\np_hit = 0.9\n'
    )
    name, settings = chain_settings("default", start, 5)
    file = write(tmp_path / "dumped.toml", dump_toml(settings.stages(), name))
    for asked in PRESETS:
        assert chain_settings(asked, file, None) == (name, settings)


def test_a_seed_goes_over_the_files_only_where_it_is_given(tmp_path):
    file = write(tmp_path / "s.toml", "[registration]\nseed = 7\n")
    for preset, seed in itertools.product(PRESETS, (None, 0, 5)):
        _, settings = chain_settings(preset, file, seed)
        assert settings.registration.seed == (7 if seed is None else seed)
    assert chain_settings("default", None, None)[1].registration.seed == 0
