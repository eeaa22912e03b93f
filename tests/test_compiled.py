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


def test_a_cache_that_has_no_place_is_done_without() -> None:
    # The one place that is left is for sources in a zip archive, and these are in none.
    without = {**os.environ, "NUMBA_CACHE_LOCATOR_CLASSES": "ZipCacheLocator"}
    done = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=ROOT,
        env=without,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout == "4 False\n"


def test_a_cache_that_has_a_place_is_used() -> None:
    from fusion_core.mapping.rays import trace_ray

    assert trace_ray.stats.cache_path
