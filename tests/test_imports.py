"""Imports go downwards only, and each folder knows no more than it needs."""

import ast
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# What each folder may import of the project, beside itself.
BASE = {"fusion_core.model", "fusion_core.settings", "fusion_core.compiled"}
PROCESSES = {"fusion_core.worker_processes", "fusion_core.freed_memory"}
FILES = {"fusion_core.files"}
LENS = {"fusion_core.lens"}
PATCHES = {"fusion_core.patches"}
ALGORITHMS = {
    "fusion_core.alignment": BASE | LENS | PATCHES,
    "fusion_core.registration": BASE,
    "fusion_core.mapping": BASE | {"fusion_core.registration"},
    "fusion_core.calibration": BASE | LENS | PATCHES | {"fusion_core.registration"},
    "fusion_core.denoising": BASE | {"fusion_core.alignment", "fusion_core.registration"},
    "fusion_core.motion": BASE | LENS | {"fusion_core.registration"},
    "fusion_core.slam": BASE
    | LENS
    | {"fusion_core.registration", "fusion_core.motion", "fusion_core.mapping"},
}
SIDES = {
    "fusion_core.annotation": BASE | FILES,
    "fusion_core.recordings": BASE | FILES,
    "fusion_core.exporting": BASE | FILES,
    "fusion_core.evaluation": BASE | FILES,
    "fusion_core.simulation": BASE | FILES | {"fusion_core.recordings"},
}
ALLOWED: dict[str, set[str]] = {
    "fusion_core.model": set(),
    "fusion_core.settings": {"fusion_core.model"},
    "fusion_core.lens": {"fusion_core.model"},
    "fusion_core.patches": {"fusion_core.model"},
    "fusion_core.files": {"fusion_core.model"},
    "fusion_core.compiled": set(),
    "fusion_core.freed_memory": set(),
    "fusion_core.worker_processes": {"fusion_core.model"},
    **ALGORITHMS,
    **SIDES,
    "fusion_core.workflows": BASE
    | LENS
    | PATCHES
    | FILES
    | PROCESSES
    | ALGORITHMS.keys()
    | SIDES.keys(),
    "scanloom": BASE | {"fusion_core.freed_memory", "fusion_core.workflows"},
}
# The parts of the app, each level above what it may import; jobs and state know each other.
APP_LEVELS: tuple[set[str], ...] = (
    {"api", "resources"},
    {"jobs", "state"},
    {"plots"},
    {"page"},
    {"frame_view"},
    {"scene"},
    {"page_parts"},
    {"client_session"},
    {"panels.widgets"},
    {"panels"},
    {"server"},
    {"commands"},
    {"cli", "the package"},
    {"__main__"},
)
# The core serves the command line and the browser alike, and knows neither.
NEVER_IN_CORE = {"scanloom", "viser", "tyro", "rich"}
VAGUE_NAMES = {"utils", "util", "helpers", "helper", "common", "misc"}


def imported(module: str, source: str) -> Iterator[str]:
    """Full names of all that ``source`` imports, inside functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: imports are absolute, line {node.lineno}"
            assert node.module is not None
            # The name may be a module itself: ``from fusion_core import recordings``.
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def folder_of(name: str) -> str:
    """The entry of ALLOWED that a module belongs to."""
    return "scanloom" if name.split(".")[0] == "scanloom" else ".".join(name.split(".")[:2])


def violations(module: str, source: str) -> list[str]:
    """What ``source`` imports and ``module`` may not."""
    folder = folder_of(module)
    found = []
    for name in imported(module, source):
        top = name.split(".")[0]
        if top in {"scanloom", "fusion_core"}:
            wrong = folder_of(name) not in ALLOWED[folder] | {folder}
        elif folder == "fusion_core.model":
            wrong = top != "numpy" and top not in sys.stdlib_module_names
        else:
            wrong = folder != "scanloom" and top in NEVER_IN_CORE
        if wrong:
            found.append(f"{module} imports {name}")
    return found


def part_of(name: str) -> str:
    """The part of APP_LEVELS that a module of the app, or a name in it, belongs to."""
    parts = name.split(".")[1:]
    return "panels.widgets" if parts[:2] == ["panels", "widgets"] else (parts or ["the package"])[0]


def upward_imports(module: str, source: str) -> list[str]:
    """What ``source``, of the app, imports from parts of the app above its own."""
    levels = {part: level for level, parts in enumerate(APP_LEVELS) for part in parts}
    own = levels[part_of(module)]
    return [
        f"{module} imports {name}"
        for name in imported(module, source)
        if name.split(".")[0] == "scanloom" and levels[part_of(name)] > own
    ]


MODULES = {
    ".".join(path.relative_to(folder).with_suffix("").parts).removesuffix(".__init__"): path
    for folder, package in ((ROOT / "app", "scanloom"), (ROOT, "fusion_core"))
    for path in sorted((folder / package).rglob("*.py"))
}


def of_each_module(check: Callable[[str, str], list[str]], of: str = "") -> list[str]:
    """What a check finds in all modules, or those of a package, but for the core's own."""
    return [
        found
        for module, path in MODULES.items()
        if module != "fusion_core" and module.startswith(of)
        for found in check(module, path.read_text(encoding="utf-8"))
    ]


def test_the_table_has_every_folder() -> None:
    assert [name for name in MODULES if folder_of(name) not in {*ALLOWED, "fusion_core"}] == []


def test_imports_go_downwards() -> None:
    assert of_each_module(violations) == []


def test_the_apps_parts_import_downwards() -> None:
    assert of_each_module(upward_imports, of="scanloom") == []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("scanloom.page.live_picture", "from scanloom.panels.widgets.controls import Controls"),
        ("scanloom.panels.widgets.controls", "from scanloom.panels.scene import ScenePanel"),
        ("scanloom.panels.opening", "from scanloom.server import security"),
        ("scanloom.state.view", "import scanloom.frame_view"),
    ],
)
def test_the_check_sees_an_import_from_above(module: str, source: str) -> None:
    assert len(upward_imports(module, source)) == 1


def test_the_package_itself_imports_nothing() -> None:
    assert list(imported("fusion_core", MODULES["fusion_core"].read_text(encoding="utf-8"))) == []


def test_the_table_has_no_cycle() -> None:
    reached: set[str] = set()
    while ready := {folder for folder, below in ALLOWED.items() if below <= reached} - reached:
        reached |= ready
    assert reached == ALLOWED.keys()


def test_a_file_is_named_for_its_subject() -> None:
    paths = [*MODULES.values(), *ROOT.glob("tests/**/*.py")]
    assert [path for path in paths if path.stem.removeprefix("test_") in VAGUE_NAMES] == []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fusion_core.alignment.search", "from fusion_core.recordings.decode import decode"),
        ("fusion_core.alignment.search", "from fusion_core import recordings"),
        ("fusion_core.alignment.search", "def f():\n    import scanloom.cli"),
        ("fusion_core.alignment.search", "import viser.transforms"),
        ("fusion_core.workflows.fuse.fuse", "from scanloom import cli"),
        ("fusion_core.recordings.ros1", "from fusion_core.simulation import scenes"),
        ("fusion_core.model.grids", "import scipy"),
        ("fusion_core.model.grids", "from fusion_core.settings import StageSettings"),
        ("scanloom.panels.noise", "from fusion_core.denoising import noise"),
    ],
)
def test_the_check_sees_a_wrong_import(module: str, source: str) -> None:
    assert len(violations(module, source)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fusion_core.simulation.scenes", "from fusion_core.recordings import ros2_writer"),
        ("fusion_core.denoising.noise", "from fusion_core.registration.ransac import fit"),
        ("fusion_core.model.grids", "import dataclasses\nimport numpy as np"),
        ("scanloom.cli", "import tyro\nfrom fusion_core.workflows.fuse.fuse import fuse"),
    ],
)
def test_the_check_lets_right_imports_pass(module: str, source: str) -> None:
    assert violations(module, source) == []
