"""Freed memory is used again."""

import platform
import subprocess
import sys

import pytest

# Pages of 4 KiB that the system has to provide for 20 rounds of three arrays of 3 MB.
COUNT = """
import resource, sys
import numpy as np
if sys.argv[1] == "kept":
    from fusion_core.freed_memory import keep_freed_memory
    keep_freed_memory()
def work():
    arrays = [np.ones(3 << 17) for _ in range(3)]
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work()
begin = faults()
for _ in range(20):
    work()
print(faults() - begin)
"""


def pages(how: str) -> int:
    command = [sys.executable, "-c", COUNT, how]
    return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told so")
def test_the_system_provides_memory_once() -> None:
    assert pages("kept") < 100 < 10_000 < pages("as it is")
