"""Few pools of free memory, however many threads."""

import platform
import subprocess
import sys

import pytest

# A pool other than the first begins at a multiple of 64 MiB.
COUNT = """
import sys, threading
from pathlib import Path
if sys.argv[1] == "limited":
    from scanloom.server.malloc_arenas import limit_arenas
    limit_arenas()
ready, done = threading.Barrier(9), threading.Event()
def work():
    kept = [bytes(2000) for _ in range(1000)]
    ready.wait()
    done.wait()
    del kept
threads = [threading.Thread(target=work) for _ in range(8)]
for thread in threads:
    thread.start()
ready.wait()
starts = [int(line.split("-")[0], 16) for line in Path("/proc/self/maps").read_text().splitlines()
          if " rw-p 00000000 00:00 0" in line]
print(sum(start % (64 << 20) == 0 for start in starts))
done.set()
"""


def pools(how: str) -> int:
    command = [sys.executable, "-c", COUNT, how]
    return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has such pools")
def test_threads_share_their_pools() -> None:
    assert pools("limited") <= 1 < 4 <= pools("as it is")
