"""How soon a person sees something: from opening the page to controls, the flat depth image, the
scene, and the aligned scene.

    python -m tests.benchmarks.bench_first_picture [--runs 3] [--warm-only] [RECORDING]

``scanloom view`` runs as a process of its own, and the page in Debian's chromium, which draws by
the processor where there is no graphics card. Cold: a copy of the sources without compiled files,
and empty caches, as after a fresh clone. Warm: the same copy once more.

The page itself watches its canvas and notes the first time at which the scene shows both the
LiDAR's curve and depth. What of the canvas is not background is measured at the end.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from playwright.sync_api import Browser, ViewportSize, sync_playwright

from scanloom.plots.palette import color_of
from scanloom.resources import sample_path

ROOT = Path(__file__).parents[2]
SCREEN: ViewportSize = {"width": 1600, "height": 900}
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
RAW_WITHIN_S = {"warm": 2.0, "cold": 5.0}
LEAST_SHARE = 0.25
_ADDRESS_WITHIN_S = 60.0
_ALIGNED_WITHIN_S = 300.0
_DRAWN_WITHIN_MS = 3000

# The canvas is read at the end of a frame in which more was drawn than the floor's grid of 384
# lines, and seldom: reading takes long. The time is that at which the frame has been drawn. Lines
# are blended at their edges, so a colour is that of the LiDAR where no channel is farther off than
# 40; the floor's grid is nearer to the ground.
WATCH = """
window.seen = {controls: null, flat: null, picture: null, aligned: null, share: 0};
const lidar = LIDAR_RGB;
let drawn = 0, isPlanned = false, readAt = 0;
for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced']) {
    const draw = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...values) {
        draw.apply(this, values);
        const count = name === 'drawArrays' ? values[2] : values[1];
        drawn = Math.max(drawn, name.endsWith('Instanced') ? values[values.length - 1] : count);
        const isWanted = window.seen.picture === null || window.lookAgain;
        if (isPlanned || !isWanted || drawn < 1000 || performance.now() - readAt < 100) return;
        isPlanned = true;
        queueMicrotask(() => { isPlanned = false; drawn = 0; look(this); });
    };
}
function look(gl) {
    const canvas = gl.canvas;
    // Waits until all is drawn; chromium's finish() does not.
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    const drawnAt = performance.now();
    const [width, height] = [canvas.width >> 2, canvas.height >> 2];
    if (!width || !canvas.matches('canvas[data-engine]')) return;
    // A page may hide the canvas while it loads.
    if (Number(getComputedStyle(canvas).opacity) < 0.9) return;
    const copy = new OffscreenCanvas(width, height);
    const context = copy.getContext('2d', {willReadFrequently: true});
    context.imageSmoothingEnabled = false;
    context.drawImage(canvas, 0, 0, width, height);
    const data = context.getImageData(0, 0, width, height).data;
    const [r0, g0, b0] = data;
    let curve = 0, other = 0;
    for (let i = 0; i < data.length; i += 4) {
        const r = data[i], g = data[i + 1], b = data[i + 2];
        if (data[i + 3] === 0) continue;
        const near = Math.max(
            Math.abs(r - lidar[0]), Math.abs(g - lidar[1]), Math.abs(b - lidar[2])) < 40;
        const spread = Math.max(r, g, b) - Math.min(r, g, b);
        const apart = Math.max(Math.abs(r - r0), Math.abs(g - g0), Math.abs(b - b0));
        if (near) curve += 1;
        else if (spread > 24 || apart > 90) other += 1;
    }
    window.seen.share = (curve + other) / (width * height);
    if (curve >= 15 && other >= 500) window.seen.picture ??= drawnAt / 1000;
    readAt = performance.now();
}
setInterval(() => {
    const seen = window.seen, now_s = performance.now() / 1000;
    if (document.querySelectorAll('input, button').length >= 20) seen.controls ??= now_s;
    const name = document.querySelector("[data-picture='depth']");
    const flat = name?.parentElement?.nextElementSibling?.querySelector('img');
    if (flat?.complete && flat.naturalWidth > 1) seen.flat ??= now_s;
    const bar = document.querySelector('[data-alignment]');
    const isAligned = bar === null
        ? document.body?.innerText.includes('frames are averaged')
        : bar.dataset.alignment === 'done';
    if (isAligned) seen.aligned ??= now_s;
}, 100);
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Seconds from starting the command to its address; and from opening the page to controls, to
    the depth image with the LiDAR's curve, to both in the scene and to the aligned scene.
    ``share``: of the canvas is not background."""

    address_s: float
    controls_s: float
    flat_s: float
    picture_s: float
    aligned_s: float
    share: float


@contextmanager
def serving(recording: Path, tree: Path, environment: Mapping[str, str]) -> Iterator[str]:
    """The address of ``scanloom view`` run from the sources of ``tree``."""
    command = [sys.executable, "-m", "scanloom", "view", str(recording), "--port", "0"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=environment, cwd=tree
    )
    assert process.stdout is not None, "it is piped"
    try:
        yield process.stdout.readline().strip()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(_ADDRESS_WITHIN_S)


def measure(
    browser: Browser, recording: Path, tree: Path, environment: Mapping[str, str], picture: Path
) -> Times:
    """Start the server, open its page, and wait for the aligned picture; keep a screenshot."""
    started_s = time.monotonic()
    with serving(recording, tree, environment) as address:
        address_s = time.monotonic() - started_s
        context = browser.new_context(viewport=SCREEN)
        page = context.new_page()
        page.add_init_script(WATCH.replace("LIDAR_RGB", json.dumps(list(color_of("lidar")))))
        page.goto(address, wait_until="commit")
        page.wait_for_function(
            "window.seen.aligned !== null && window.seen.picture !== null",
            timeout=1e3 * _ALIGNED_WITHIN_S,
            polling=100,
        )
        page.evaluate("window.lookAgain = true")
        page.wait_for_timeout(_DRAWN_WITHIN_MS)
        seen = page.evaluate("window.seen")
        page.screenshot(path=picture)
        context.close()
    return Times(
        address_s=address_s,
        controls_s=seen["controls"],
        flat_s=seen["flat"],
        picture_s=seen["picture"],
        aligned_s=max(seen["aligned"], seen["picture"]),
        share=seen["share"],
    )


def environment_of(tree: Path, caches: Path) -> dict[str, str]:
    """The process's own, but with the sources of ``tree`` and caches below ``caches``."""
    changed = {
        "PYTHONPATH": os.pathsep.join([str(tree / "app"), str(tree)]),
        "HOME": str(caches),
        "XDG_CACHE_HOME": str(caches / "cache"),
        "XDG_CONFIG_HOME": str(caches / "config"),
        "NUMBA_CACHE_DIR": str(caches / "numba"),
        "MPLCONFIGDIR": str(caches / "matplotlib"),
    }
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | changed


def copy_of_sources(folder: Path) -> Path:
    """The project's sources without what was compiled of them."""
    tree = folder / "tree"
    for name in ("app", "fusion_core", "static", "samples"):
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    return tree


def show(name: str, times: list[Times]) -> bool:
    """Print the medians of some runs, and return whether the aims are met."""
    middle = {
        field: median(getattr(one, field) for one in times) for field in Times.__dataclass_fields__
    }
    aim_s = RAW_WITHIN_S[name]
    is_met = middle["picture_s"] <= aim_s and middle["share"] >= LEAST_SHARE
    print(
        f"{name:5} address {middle['address_s']:6.2f} s   controls {middle['controls_s']:6.2f} s   "
        f"depth image {middle['flat_s']:6.2f} s   "
        f"scene {middle['picture_s']:6.2f} s (aim {aim_s:.0f})   "
        f"aligned {middle['aligned_s']:6.2f} s   "
        f"drawn {middle['share']:.1%} (aim {LEAST_SHARE:.0%})",
        flush=True,
    )
    return is_met


def main() -> None:
    """Measure and print; exit with 1 where an aim is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", nargs="?", type=Path, default=sample_path())
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--pictures", type=Path, default=Path(tempfile.gettempdir()))
    only = parser.add_mutually_exclusive_group()
    only.add_argument("--cold-only", action="store_true")
    only.add_argument("--warm-only", action="store_true")
    asked = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not on the PATH")
    recording = asked.recording.resolve()
    asked.pictures.mkdir(parents=True, exist_ok=True)
    cold, warm = [], []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        for run in range(asked.runs):
            with tempfile.TemporaryDirectory() as folder:
                place = Path(folder)
                tree, environment = ROOT, dict(os.environ)
                if not asked.warm_only:
                    tree = copy_of_sources(place)
                    environment = environment_of(tree, place / "caches")
                    picture = asked.pictures / f"cold_{run}.png"
                    cold.append(measure(browser, recording, tree, environment, picture))
                if not asked.cold_only:
                    picture = asked.pictures / f"warm_{run}.png"
                    warm.append(measure(browser, recording, tree, environment, picture))
        browser.close()
    are_met = [show(name, times) for name, times in (("cold", cold), ("warm", warm)) if times]
    sys.exit(0 if all(are_met) else 1)


if __name__ == "__main__":
    main()
