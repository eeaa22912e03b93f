"""What contributors are told: the checks before a commit, and the names in the guide."""

import re
from pathlib import Path

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]


def test_the_hooks_of_pre_commit_are_the_lines_of_make_test() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^test test-all: types pytest$", makefile, flags=re.MULTILINE)
    recipes = re.findall(r"^(?:lint|types|pytest):.*\n((?:\t.*\n)+)", makefile, flags=re.MULTILINE)
    own_choice = re.search(r"^test: PYTEST := (.*)$", makefile, flags=re.MULTILINE)
    assert len(recipes) == 3
    assert own_choice is not None
    text = (
        "".join(recipes)
        .replace("$(PYTHON)", ".venv/bin/python")
        .replace("$(PYTEST)", own_choice[1])
    )
    lines = [line.strip() for line in text.split("\n") if line]
    (own,) = YAML(typ="safe").load(ROOT / ".pre-commit-config.yaml")["repos"]
    assert [hook["entry"] for hook in own["hooks"]] == lines


def test_the_guide_names_files_that_exist() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:app|fusion_core|tests)/[\w./]+)`", guide))
    assert len(named) > 20
    # The example's file is what a contributor writes.
    missing = {name for name in named if not (ROOT / name).exists()}
    assert missing <= {"fusion_core/recordings/csv_ranges.py"}
