"""Compiled functions need no place on disk."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
CALL = """
import numpy as np
from fusion_core.mapping.rays import trace_ray

cells = np.empty((9, 2), dtype=np.int64)
print(trace_ray(0.5, 0.5, 3.5, 0.5, cells), bool(trace_ray.stats.cache_path))
"""


def printed(code: str, **environment: str) -> str:
    """What a process of its own prints, which says nothing else."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr == ""
    return done.stdout


def test_a_cache_that_has_no_place_is_done_without() -> None:
    # The one place that is left is for sources in a zip archive, and these are in none.
    assert printed(CALL, NUMBA_CACHE_LOCATOR_CLASSES="ZipCacheLocator") == "4 False\n"


def test_a_cache_that_has_a_place_is_used() -> None:
    from fusion_core.mapping.rays import trace_ray

    assert trace_ray.stats.cache_path


NAMED_TUPLE = """
from typing import NamedTuple

from fusion_core.compiled import compiled


class {name}(NamedTuple):
    value: float


@compiled()
def doubled(given):
    return 2.0 * given.value


print(doubled({name}({value})))
"""


def test_a_cache_of_another_version_is_compiled_anew(tmp_path: Path) -> None:
    """An upgrade leaves numba's files, which name the classes of the version before."""
    stage = tmp_path / "stage.py"
    for name, value in (("Before", 1.0), ("After", 2.0)):
        stage.write_text(NAMED_TUPLE.format(name=name, value=value), encoding="utf-8")
        assert printed("import stage", PYTHONPATH=f"{tmp_path}:{ROOT}") == f"{2.0 * value}\n"
    assert list(tmp_path.glob("__pycache__/*.nbi"))


LOADED = """
from fusion_core.compiled import load_cached
from fusion_core.mapping.rays import trace_ray

load_cached()
stats = trace_ray.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def test_what_a_cache_holds_is_loaded_before_the_first_call(tmp_path: Path) -> None:
    found = [printed(code, NUMBA_CACHE_DIR=str(tmp_path)) for code in (LOADED, CALL, LOADED)]
    assert found == ["0 0\n", "4 True\n", "1 0\n"]
