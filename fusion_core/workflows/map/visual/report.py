"""What ``scanloom map --slam visual`` reports: report.json's content, and the same for people."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.number_text import counted
from fusion_core.slam.visual.image_trajectory import JUMP_M
from fusion_core.slam.visual.visual_slam import VisualSlamResult
from fusion_core.workflows.map.report import MapSummary

# Of more lost or doubtful stretches or jumps than fit on a screen only the first are printed.
_PRINTED = 8


class VisualMapSummary(MapSummary):
    """Of a run with --slam visual."""

    def lines(self) -> list[str]:
        """The report for people."""
        report = self.report
        lines = [
            f"images     {report['images_tracked']} of {report['images']} have a pose, "
            f"{report['duration_s']:.1f} s, {report['path_m']:.1f} m path",
            f"map        {counted(report['keyframes'], 'keyframe')}, "
            f"{counted(report['landmarks'], 'landmark')}, {counted(report['loops'], 'loop')}",
        ]
        for stretch in report["lost"][:_PRINTED]:
            lines.append(
                f"lost       {stretch['from_s']:.3f} s to {stretch['to_s']:.3f} s: "
                f"{counted(stretch['images'], 'image')}, {stretch['reason']}"
            )
        for stretch in report["doubtful"][:_PRINTED]:
            lines.append(
                f"doubtful   {stretch['from_s']:.3f} s to {stretch['to_s']:.3f} s: "
                f"{stretch['reason']}"
            )
        for jump in report["jumps"][:_PRINTED]:
            lines.append(
                f"jump       {jump['step_m']:.2f} m from {jump['from_s']:.3f} s to "
                f"{jump['to_s']:.3f} s"
            )
        for name in ("lost", "doubtful", "jumps"):
            if len(report[name]) > _PRINTED:
                lines.append(f"{name:10} {len(report[name]) - _PRINTED} more in report.json")
        lines += [f"time       {name} {value:.1f} s" for name, value in self.seconds.items()]
        lines += [f"note       {note}" for note in report["notes"]]
        if self.is_skipped:
            lines.append("Nothing was done, the results were there already (--force redoes).")
        return [*lines, f"results    {self.output}"]


def build_visual_report(
    result: VisualSlamResult, choices: Mapping[str, str], notes: Sequence[str]
) -> dict[str, Any]:
    """report.json's content. ``choices``: the run's options, by name."""
    visual_map = result.visual_map
    steps_m = np.linalg.norm(np.diff(result.T_map_camera[result.is_tracked, :3, 3], axis=0), axis=1)
    tracked = int(result.is_tracked.sum())
    return {
        **choices,
        "images": len(result.stamps_ns),
        "images_tracked": tracked,
        "duration_s": _seconds(result.stamps_ns[-1] - result.stamps_ns[0]),
        "path_m": float(steps_m.sum()),
        "keyframes": len(visual_map.kept_keyframes),
        "keyframes_culled": len(visual_map.keyframes) - len(visual_map.kept_keyframes),
        "landmarks": int(np.count_nonzero(~visual_map.is_landmark_culled)),
        "loops": len(visual_map.loops),
        "loop_closures": [
            {
                "first_s": _seconds(visual_map.keyframes[loop.first].stamp_ns),
                "second_s": _seconds(visual_map.keyframes[loop.second].stamp_ns),
                "inliers": len(loop.pose.matches),
            }
            for loop in visual_map.loops
        ],
        "refused_loops": [
            {
                "first_s": _seconds(visual_map.keyframes[loop.first].stamp_ns),
                "second_s": _seconds(visual_map.keyframes[loop.second].stamp_ns),
                "inliers": loop.inliers,
                "reason": loop.reason,
            }
            for loop in result.refused_loops
        ],
        "trusted_share": tracked / len(result.stamps_ns),
        "untrusted": [],
        "lost": [
            {
                "from_s": _seconds(stretch.first_stamp_ns),
                "to_s": _seconds(stretch.last_stamp_ns),
                "images": stretch.last - stretch.first + 1,
                "reason": stretch.reason,
            }
            for stretch in result.lost
        ],
        "doubtful": [
            {
                "from_s": _seconds(stretch.first_stamp_ns),
                "to_s": _seconds(stretch.last_stamp_ns),
                "contradicted_share": stretch.share,
                "reason": stretch.reason,
            }
            for stretch in result.doubtful
        ],
        "jump_m": JUMP_M,
        "jumps": [
            {
                "from_s": _seconds(jump.first_stamp_ns),
                "to_s": _seconds(jump.second_stamp_ns),
                "step_m": jump.step_m,
            }
            for jump in result.jumps
        ],
        "notes": [*notes],
    }


def _seconds(stamp_ns: int) -> float:
    return float(stamp_ns) / NS_PER_S
