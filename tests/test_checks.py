"""The same checks before a commit as in ``make test``."""

import re
from pathlib import Path

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]


def test_the_hooks_of_pre_commit_are_the_lines_of_make_test() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    recipe = re.search(r"^test:.*\n((?:\t.*\n)+)", makefile, flags=re.MULTILINE)
    assert recipe is not None
    lines = [
        line.strip().replace("$(PYTHON)", ".venv/bin/python") for line in recipe[1].split("\n")
    ]
    (own,) = YAML(typ="safe").load(ROOT / ".pre-commit-config.yaml")["repos"]
    assert [hook["entry"] for hook in own["hooks"]] == [line for line in lines if line]
