"""The files that come with ScanLoom, in the checkout and out of a wheel."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import ScanLoomError
from scanloom.resources import palette, sample_path, static_path

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of the checkout, built by the tools of this environment."""
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out)]
    run = subprocess.run([*build, str(ROOT)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    (built,) = out.glob("scanloom-*.whl")
    return built


def test_a_checkout_finds_its_own_folders() -> None:
    assert static_path("palette.json") == ROOT / "static" / "palette.json"
    assert sample_path() == ROOT / "samples" / "furnished_room.mcap"


def test_a_file_that_is_not_there_is_named() -> None:
    with pytest.raises(ScanLoomError, match=r"static/none\.json"):
        static_path("none.json")
    with pytest.raises(ScanLoomError, match=r"samples/none\.mcap"):
        sample_path("none.mcap")


def test_the_palette_has_a_colour_of_its_own_for_each_thing() -> None:
    colours = palette()
    names = {noise_class.name.lower() for noise_class in NoiseClass}
    assert colours.keys() == names | {"lidar", "depth", "fused"}
    assert len(set(colours.values())) == len(colours)
    assert all(re.fullmatch("#[0-9A-F]{6}", colour) for colour in colours.values())


def test_the_wheel_holds_the_whole_project(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    wanted = set()
    for folder, inside in {
        "app/scanloom": "scanloom",
        "fusion_core": "fusion_core",
        "static": "scanloom/static",
        "samples": "scanloom/samples",
    }.items():
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                wanted.add(f"{inside}/{path.relative_to(ROOT / folder).as_posix()}")
    assert {"scanloom/static/palette.json", "scanloom/samples/furnished_room.mcap"} <= wanted
    assert {name for name in held if ".dist-info/" not in name} == wanted
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in held)


def test_the_wheel_works_outside_the_repository(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    code = (
        "import json\n"
        "from scanloom.resources import palette, sample_path, static_path\n"
        "print(json.dumps([str(sample_path()), str(static_path('palette.json')), palette()]))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
        check=True,
    )
    inside = tmp_path / "site" / "scanloom"
    assert json.loads(run.stdout) == [
        str(inside / "samples" / "furnished_room.mcap"),
        str(inside / "static" / "palette.json"),
        palette(),
    ]


def test_the_wheel_leaves_the_name_app_to_others(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    (site / "app").mkdir(parents=True)
    (site / "app" / "__init__.py").write_text("name = 'another project'\n", encoding="utf-8")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    code = "import app, scanloom, scanloom.cli; print(app.name, scanloom.__file__)"
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.strip() == f"another project {site / 'scanloom' / '__init__.py'}"
