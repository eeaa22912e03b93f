"""What ``make demo`` and ``make test`` set up, each in an environment of its own kind."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PIP = """#!/bin/sh
# Stands for an environment's python: notes how it is called.
echo "$@" >> "$CALLS"
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """What make needs of the project, with an environment whose python only notes its calls."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(ROOT / ".ci", tmp_path / ".ci")
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("python", "scanloom"):
        (programs / name).write_text(PIP, encoding="utf-8")
        (programs / name).chmod(0o755)
    # Nothing is to be installed on the machine that tests.
    system = tmp_path / "system"
    system.mkdir()
    for name in ("apt-get", "chromium", "initdb"):
        (system / name).symlink_to("/bin/true")
    return tmp_path


def calls_of(tree: Path, *targets: str) -> list[str]:
    """How the environment's python was called by make."""
    calls = tree / "calls"
    calls.unlink(missing_ok=True)
    path = f"{tree / 'system'}:{os.environ['PATH']}"
    # Not a part of the make that runs the tests.
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    for target in targets:
        done = subprocess.run(
            ["make", target],
            cwd=tree,
            env=env | {"CALLS": str(calls), "PATH": path},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    return calls.read_text(encoding="utf-8").splitlines()


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_the_workbench_installs_no_test_tools_and_compiles_ahead(tree: Path) -> None:
    calls = calls_of(tree, "demo")
    assert not any("--group" in call for call in calls)
    assert calls[-2:] == ["-m scanloom.jobs.compile_ahead", "view"]
    # A second time nothing is set up.
    assert calls_of(tree, "demo") == ["view"]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_the_tests_set_up_what_the_workbench_has_not(tree: Path) -> None:
    calls_of(tree, "demo")
    calls = calls_of(tree, "test")
    assert any("--group test" in call for call in calls)
    assert calls_of(tree, "demo") == ["view"]
    assert not any("install" in call for call in calls_of(tree, "test"))
