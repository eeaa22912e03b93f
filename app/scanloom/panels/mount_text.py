"""The mount as text: the camera's pose on the LiDAR, and what is not observable."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.number_text import with_deviation
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from scanloom.page.markup import escape_markdown
from scanloom.state.hand_pose import HandPose

_NAMES = {
    "yaw_rad": (
        "looks {} {} of the LiDAR's zero",
        "to the left",
        "to the right",
        "°",
        180.0 / np.pi,
    ),
    "delta_z_m": ("sits {} {} the LiDAR (Δz)", "above", "below", " m", 1.0),
    "forward_m": ("sits {} {} it", "in front of", "behind", " m", 1.0),
    "left_m": ("sits {} {} of it", "to the left", "to the right", " m", 1.0),
    "pitch_rad": ("looks {} {}", "down", "up", "°", 180.0 / np.pi),
    "clock_offset_ms": ("stamps {} {}", "later", "earlier", " ms", 1.0),
}

_UNKNOWN = {
    "yaw_rad": "where it looks",
    "delta_z_m": "how far above the LiDAR it sits (Δz)",
    "forward_m": "how far in front",
    "left_m": "how far to the left",
    "pitch_rad": "how far it looks down",
    "clock_offset_ms": "how late its stamps are",
}


def unknown_text(mount: Mount) -> str:
    """A sentence that names what of the camera's pose is not observable, empty if all is."""
    unknown = [_UNKNOWN[name] for name in _unobserved(mount) if name != "clock_offset_ms"]
    if not unknown:
        return ""
    return f"This recording does not tell {', '.join(unknown)}: assumed here, not found."


def given_text(pose: HandPose, source: str, notes: Sequence[str] = ()) -> str:
    """A pose that a person gives, and the notes on it, as Markdown. ``source``: where from."""
    lines = [
        f"- It looks **{_aside(pose.yaw_deg, 'to the left', 'to the right', '°', 2)}**.",
        f"- It looks **{_aside(pose.pitch_deg, 'down', 'up', '°', 2)}**, rolled "
        f"{pose.roll_deg:.2f}°.",
        f"- It sits **{_aside(pose.forward_m, 'in front of', 'behind', ' m', 3)}** the LiDAR, "
        f"**{_aside(pose.left_m, 'to the left', 'to the right', ' m', 3)}**, "
        f"**{_aside(pose.up_m, 'above', 'below', ' m', 3)}**.",
    ]
    lines += [f"- {escape_markdown(note)}" for note in notes]
    return f"The camera, by {escape_markdown(source)}:\n\n" + "\n".join(lines)


def _aside(value: float, positive: str, negative: str, unit: str, decimals: int) -> str:
    return f"{abs(value):.{decimals}f}{unit} {positive if value >= 0.0 else negative}"


def mount_text(
    mount: Mount,
    notes: Sequence[str] = (),
    *,
    seen_roll_rad: tuple[float, float] | None = None,
    roll_used_rad: float = 0.0,
    is_roll_known: bool = True,
) -> str:
    """One line for each parameter and note, as Markdown; what is not observable is named.

    ``seen_roll_rad``: the roll that floor or walls show and its standard deviation, unless it is
    known from elsewhere; ``roll_used_rad``: what the camera's pose has of it.
    """
    lines = []
    unknown = [_UNKNOWN[name] for name in _unobserved(mount)]
    for name, sd in zip(MOUNT_PARAMETERS, mount.sd, strict=True):
        if sd is None:
            continue
        form, positive, negative, unit, factor = _NAMES[name]
        value = getattr(mount, name) * factor
        number = f"**{' ± '.join(with_deviation(abs(value), sd * factor))}{unit}**"
        lines.append(f"- It {form.format(number, positive if value >= 0.0 else negative)}.")
    if seen_roll_rad is None and not is_roll_known:
        unknown.append("how far it is rolled")
    elif seen_roll_rad is not None:
        roll_deg, sd_deg = np.rad2deg(seen_roll_rad)
        level = ", taken as level" if roll_used_rad == 0.0 else ""
        number = " ± ".join(with_deviation(roll_deg, sd_deg))
        lines.append(f"- It is rolled **{number}°**{level}.")
    if unknown:
        lines.append(f"- This recording does not tell {', '.join(unknown)}.")
    lines += [f"- {note}" for note in notes]
    return "The camera:\n\n" + "\n".join(lines)


def _unobserved(mount: Mount) -> list[str]:
    return [name for name, sd in zip(MOUNT_PARAMETERS, mount.sd, strict=True) if sd is None]
