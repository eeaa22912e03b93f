"""The preset `published` on a panorama of four cameras, beside a loop of the paper's formulas.

    python -m tests.benchmarks.bench_published_panorama [--seeds N] [--seconds S]

Both run on the simulated scene `robot_at_home` and are compared with the same true offsets: a frame
is a panorama of four images, right where its u lies within 2 samples of the truth. The loop is Xu
2024 §2.2 and §3.2 in NumPy, and shares no code with the alignment: images pasted beside each other,
every k-th column and beam (W = 180, Psi = 240), holes as zeros, the lower half of the rows, and the
arg max of eq. (2) over 0 <= u <= Psi - W.
"""

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.evaluation.alignment import U_TOLERANCE_SAMPLES, evaluate_alignment
from fusion_core.evaluation.fuse_folder import Frames, open_fuse_folder, read_frames
from fusion_core.evaluation.truth import load_truth
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions

FROM_LEFT = [f"/camera_{number}/depth/image_raw" for number in (1, 2, 3, 4)]
SCAN = "/scan"
PSI, W = 240, 180


@dataclass(frozen=True)
class Compared:
    """(P,) offsets of the panoramas of a recording; NaN where there is none."""

    preset: np.ndarray
    loop: np.ndarray
    truth: np.ndarray

    def share(self, u: np.ndarray) -> float:
        """Frames within two samples of the truth, of those that have one."""
        known = np.isfinite(self.truth)
        return float((np.abs(u - self.truth)[known] <= U_TOLERANCE_SAMPLES).mean())


def loop_offset(ranges_m: np.ndarray, upright_m: list[np.ndarray]) -> tuple[int, int]:
    """(u, v) of one scan, beams counter-clockwise, and the images of one instant, leftmost first.
    v counts from the top."""
    image = np.nan_to_num(np.concatenate(upright_m, axis=1))
    height, width = image.shape
    columns = [round(w * (width - 1) / (W - 1)) for w in range(W)]
    beams = [round(w * (ranges_m.size - 1) / (PSI - 1)) for w in range(PSI)]
    L = np.nan_to_num(ranges_m[::-1])[beams]
    D = image[height // 2 :, columns]
    best, place = -np.inf, (0, 0)
    for u in range(PSI - W + 1):
        L_u = L[u : u + W]
        # Eq. (2), of all rows at once.
        covariance = (D * L_u).mean(axis=1) - D.mean(axis=1) * L_u.mean()
        variance_D = (D**2).mean(axis=1) - D.mean(axis=1) ** 2
        variance_L = (L_u**2).mean() - L_u.mean() ** 2
        with np.errstate(invalid="ignore", divide="ignore"):
            score = covariance / (np.sqrt(variance_D) * np.sqrt(variance_L))
        score[~np.isfinite(score)] = -np.inf
        v = int(score.argmax())
        if score[v] > best:
            best, place = score[v], (u, height // 2 + v)
    return place


def read_sensors(
    recording: Path,
) -> tuple[dict[int, np.ndarray], dict[tuple[str, int], np.ndarray]]:
    """Ranges of each scan by stamp, and images by topic and stamp, turned upright: the rig's are
    stored with their columns running upwards."""
    scans, images = {}, {}
    with open_recording(recording) as opened:
        for message in opened.messages([SCAN, *FROM_LEFT]):
            value = message.value
            if isinstance(value, LaserScan):
                scans[value.stamp_ns] = value.ranges_m
            elif isinstance(value, DepthImage):
                images[message.topic, value.stamp_ns] = np.rot90(value.depth_m)
    return scans, images


def compare(recording: Path, folder: Path, *, panoramas: int | None = None) -> Compared:
    """Fuse a recording into ``folder`` with the preset, and run the loop on its first panoramas."""
    fuse(recording, folder, FuseOptions(preset="published", maps=False, figures=False))
    u_true = evaluate_alignment(folder, load_truth(truth_path(recording))).u_true
    opened = open_fuse_folder(folder)
    frames = read_frames(opened)
    scans, images = read_sensors(recording)
    scan_stamps = np.array(sorted(scans))
    preset, loop, truth = [], [], []
    for rows in panorama_rows(frames)[:panoramas]:
        stamps = [int(frames.stamp_ns[row]) for row in rows]
        nearest = scan_stamps[np.abs(scan_stamps - sum(stamps) // len(stamps)).argmin()]
        upright = [images[topic, stamp] for topic, stamp in zip(FROM_LEFT, stamps, strict=True)]
        u, _ = loop_offset(scans[int(nearest)], upright)
        loop.append(u)
        preset.append(frames.number["u"][rows[0]])
        truth.append(u_true[rows[0]])
    return Compared(preset=np.array(preset), loop=np.array(loop), truth=np.array(truth))


def panorama_rows(frames: Frames) -> list[list[int]]:
    """The rows of each panorama, in the order of the cameras: of the images whose stamps are
    nearest to each other."""
    rows_of = [np.flatnonzero(frames.camera == camera) for camera in range(len(FROM_LEFT))]
    found = []
    for row in rows_of[0]:
        near = [
            own[np.abs(frames.stamp_ns[own] - frames.stamp_ns[row]).argmin()] for own in rows_of
        ]
        # A camera's period is 93 ms.
        if np.ptp(frames.stamp_ns[near]) < 40_000_000:
            found.append([int(own) for own in near])
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0)
    options = parser.parse_args()
    print("frames with u within 2 samples of the truth")
    print(f"{'seed':>6}{'frames':>8}{'published':>11}{'loop':>8}{'same u':>8}")
    every = []
    for seed in range(1, options.seeds + 1):
        with tempfile.TemporaryDirectory() as work:
            recording = Path(work) / "panorama.mcap"
            given = {"seed": seed, "duration_s": options.seconds}
            own = find_scene("robot_at_home").settings
            write_scene("robot_at_home", recording, settings=own.model_copy(update=given))
            every.append(compare(recording, Path(work) / "fused"))
            show(str(seed), every[-1])
    pooled = {
        name: np.concatenate([getattr(one, name) for one in every])
        for name in ("preset", "loop", "truth")
    }
    show("all", Compared(**pooled))


def show(name: str, compared: Compared) -> None:
    """Print a row."""
    same = float((compared.preset == compared.loop).mean())
    print(
        f"{name:>6}{compared.truth.size:>8}{compared.share(compared.preset):>11.1%}"
        f"{compared.share(compared.loop):>8.1%}{same:>8.1%}",
        flush=True,
    )


if __name__ == "__main__":
    main()
