"""Peak memory of `scanloom fuse` on a recording and on one ten times as long.

    python -m tests.benchmarks.memory [SCENE]

Each run is a process of its own; what counts is the most memory that it ever held (ru_maxrss). The
recordings are simulated, with images of half size. One run before these compiles.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene

SECONDS = (6.0, 60.0)
GROWTH_MAX = 0.10
FUSE = "from scanloom.cli import main; raise SystemExit(main())"


def write(scene: str, folder: Path, duration_s: float) -> Path:
    own = find_scene(scene).settings.model_dump()
    settings = SceneSettings(**own | {"duration_s": duration_s, "image_scale": 0.5})
    path = folder / f"{scene}_{duration_s:g}.mcap"
    write_scene(scene, path, settings=settings)
    return path


def fuse(recording: Path, output: Path) -> float:
    """MiB at the peak of one run. The measuring process in between starts small, since a child
    counts at least what its parent held."""
    command = [sys.executable, "-c", FUSE, "fuse", str(recording), "-o", str(output)]
    measure = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[1:], capture_output=True, text=True)\n"
        "if done.returncode: sys.exit(done.stderr)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    command = [sys.executable, "-c", measure, *command, "--no-figures"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return int(done.stdout) / 1024.0


def main() -> None:
    scene = sys.argv[1] if len(sys.argv) > 1 else "bedroom"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = [write(scene, folder, seconds) for seconds in SECONDS]
        fuse(recordings[0], folder / "compiling")
        peaks = [fuse(path, folder / path.stem) for path in recordings]
        sizes = [path.stat().st_size / 2**20 for path in recordings]
    print(f"{'scene ' + scene:20}{'recording MiB':>16}{'peak MiB':>12}")
    for seconds, size, peak in zip(SECONDS, sizes, peaks, strict=True):
        print(f"{f'{seconds:g} s':20}{size:16.1f}{peak:12.0f}")
    growth = peaks[1] / peaks[0] - 1.0
    print(f"growth {growth:+.1%}, at most {GROWTH_MAX:+.0%}")
    sys.exit(growth > GROWTH_MAX)


if __name__ == "__main__":
    main()
