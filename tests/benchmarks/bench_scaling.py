"""How the cost of `scanloom fuse` grows with frames, pixels and workers.

    python -m tests.benchmarks.bench_scaling frames|pixels|workers

Simulated rooms, fused without figures. For frames and pixels the seconds are those of the
processor, in one process, so that other work on the machine counts little; the memory is the most
that the process ever held. For workers they are those of the clock, over a batch of eight
recordings. A run before these compiles.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene

SCENE = "furnished_room"
DURATIONS_S = (5.0, 10.0, 20.0, 40.0)
SCALES = (0.25, 0.5, 1.0)
WORKERS = (1, 2)
RECORDINGS = 8
_SCANLOOM = (sys.executable, "-m", "scanloom")
_MIB_OF_KIB = 1 / 1024


def write(folder: Path, name: str, duration_s: float, scale: float) -> Path:
    own = find_scene(SCENE).settings.model_dump()
    path = folder / f"{name}.mcap"
    settings = SceneSettings(**own | {"duration_s": duration_s, "image_scale": scale})
    write_scene(SCENE, path, settings=settings)
    return path


def run(*args: object) -> tuple[float, float]:
    """Seconds of the processor, and MiB at the most, of a command."""
    command = [*_SCANLOOM, *map(str, args)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * _MIB_OF_KIB


def fuse(recording: Path, output: Path) -> tuple[float, float]:
    return run("fuse", recording, "-o", output, "--no-figures", "--workers", 1)


def print_growth(sizes: list[float], seconds: list[float], what: str, unit: float = 1.0) -> None:
    """The straight line through the measured points."""
    slope, fixed = np.polyfit(sizes, seconds, 1)
    print(f"{fixed:.1f} s, and {1e3 * slope * unit:.1f} ms for each {what}")


def frames(folder: Path) -> None:
    print("images  cpu s  most MiB")
    counts: list[float] = []
    seconds: list[float] = []
    for duration_s in DURATIONS_S:
        recording = write(folder, f"long_{duration_s:g}", duration_s, 0.25)
        cpu_s, most_mib = fuse(recording, folder / f"long_{duration_s:g}")
        counts.append(duration_s * find_scene(SCENE).settings.camera_rate_hz)
        seconds.append(cpu_s)
        print(f"{counts[-1]:>6.0f} {cpu_s:>6.1f} {most_mib:>9.0f}", flush=True)
    print_growth(counts, seconds, "image")


def pixels(folder: Path) -> None:
    print("pixels  cpu s  most MiB")
    counts: list[float] = []
    seconds: list[float] = []
    for scale in SCALES:
        recording = write(folder, f"wide_{scale:g}", 5.0, scale)
        cpu_s, most_mib = fuse(recording, folder / f"wide_{scale:g}")
        counts.append(round(640 * scale) * round(480 * scale))
        seconds.append(cpu_s)
        print(f"{counts[-1]:>6.0f} {cpu_s:>6.1f} {most_mib:>9.0f}", flush=True)
    print_growth(counts, seconds, "thousand pixels of all images", 1e3)


def workers(folder: Path) -> None:
    data = folder / "data"
    data.mkdir()
    for number in range(RECORDINGS):
        write(data, f"run_{number}", 5.0 + 0.1 * number, 0.25)
    print("workers  s")
    seconds = []
    for count in WORKERS:
        begun_s = time.perf_counter()
        output = folder / f"with_{count}"
        options = ("--run", "fuse", "--workers", count, "--", "--no-figures")
        run("batch", data, "-o", output, *options)
        seconds.append(time.perf_counter() - begun_s)
        print(f"{count:>7} {seconds[-1]:>5.1f}", flush=True)
    print(f"{seconds[0] / seconds[-1]:.2f} times as fast with {WORKERS[-1]} as with one")


def main() -> None:
    measures = {"frames": frames, "pixels": pixels, "workers": workers}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("measure", choices=measures)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fuse(write(folder, "first", 1.0, 0.25), folder / "first")
        measures[asked.measure](folder)


if __name__ == "__main__":
    main()
