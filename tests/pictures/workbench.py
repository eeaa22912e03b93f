"""The README's picture: the workbench on the built-in recording, in a browser without a screen.

    python -m tests.pictures.workbench [FILE.png] [--panel Repair] [--frame 40] [RECORDING]

Needs chromium. The picture has few enough colours for a palette, which keeps it small.
"""

import argparse
import shutil
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

from scanloom.resources import SAMPLE_FRAME
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.view import PANELS

PICTURE = Path(__file__).parents[2] / "samples" / "workbench.png"
SIZE = {"width": 1600, "height": 900}
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MOST_BYTES = 500 << 10
_LOADED_S = 120.0
_DRAWN_S = 6.0


def main() -> None:
    """Serve, open, wait for the frame, and write what the browser shows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", type=Path, default=PICTURE)
    parser.add_argument("recording", nargs="*", type=Path)
    parser.add_argument("--panel", choices=PANELS, default="Repair")
    parser.add_argument("--frame", type=int, default=SAMPLE_FRAME)
    parser.add_argument("--virtual-lidar", type=int)
    asked = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not on the PATH; install it, e.g. with apt-get install chromium")
    options = ServeOptions(recordings=asked.recording, port=0, virtual_row=asked.virtual_lidar)
    with Workbench(options) as workbench, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport=SIZE)
        page.goto(workbench.address)
        until = time.monotonic() + _LOADED_S
        while not any(
            session.frame_view and session.frame_view.fused for session in workbench.sessions
        ):
            if time.monotonic() > until:
                sys.exit("the recording was not aligned in time")
            time.sleep(0.2)
        for session in workbench.sessions:
            session.change(frame_index=asked.frame, panel=asked.panel)
        # The browser's own warning that it has no graphics card is no part of the picture.
        page.get_by_text("Software WebGL").locator("xpath=../..").get_by_role("button").click()
        page.wait_for_timeout(1000 * _DRAWN_S)
        shot = page.screenshot()
        browser.close()
    pixels = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)
    # Two bits less of each channel: half the size, and nothing that an eye would see.
    packed = cv2.imencode(".png", pixels & 0xFC, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    if len(packed) > MOST_BYTES:
        sys.exit(f"the picture has {len(packed)} bytes, more than {MOST_BYTES}")
    asked.picture.write_bytes(packed)
    sys.stdout.write(f"{asked.picture}: {len(packed)} bytes\n")


if __name__ == "__main__":
    main()
