"""A registration as Markdown: what A does, one RANSAC draw, why a model was refused."""

from collections.abc import Iterable

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.number_text import counted
from fusion_core.workflows.fuse.epsilon import EpsilonInFrame, EpsilonUnit
from fusion_core.workflows.fuse.registration_details import (
    Consensus,
    RansacDraw,
    Registration,
    TransformDecomposition,
)

# Set by hand: a transform that shrinks a distance below this fraction has an unstable inverse.
_FLATTENS = 0.5
_UNIT_SIGNS: dict[EpsilonUnit, str] = {"sigma": " σ", "E": " E", "m": " m"}


def transform_text(found: Registration, meaning: TransformDecomposition) -> str:
    """What A does, by the model's parameters, and its quality."""
    lines = [
        f"rotates the LiDAR's points by **{_turn(meaning.rotation_rad)}**",
        f"translates the origin by **{_shift(meaning.translation_m)}**",
        f"moves the centroid of the inliers by {_shift(meaning.displacement_m)}",
    ]
    if found.model == "similarity":
        lines.append(f"scales by **{meaning.scale:.3f}**: {_longer(meaning.scale)}")
    if found.model in ("affine", "homography"):
        lines.append(
            f"scales x by **{meaning.scale_x:.3f}** and z by **{meaning.scale_z:.3f}** "
            f"(a distance by {meaning.scale_min:.3f} to {meaning.scale_max:.3f})"
        )
        lines.append(
            f"shears by **{_degrees(meaning.shear_rad)}**: the right angle of the axes becomes "
            f"{_degrees(0.5 * np.pi - meaning.shear_rad)}"
        )
    if found.model == "homography":
        right, ahead = 100.0 * meaning.perspective_per_m
        lines.append(
            f"has a perspective: w′ grows by **{_signed(right, 2)} %** per metre to the right and "
            f"by **{_signed(ahead, 2)} %** per metre ahead; distances there shrink as much"
        )
    if meaning.is_mirrored:
        lines.append("**mirrors**: left becomes right")
    if meaning.scale_min < _FLATTENS:
        lines.append(
            f"**flattens**: one direction keeps {_percent(meaning.scale_min, 1)} of its length, "
            f"so that A⁻¹ multiplies errors by up to {1.0 / meaning.scale_min:.3g}"
        )
    near = " near the centroid of the inliers" if found.model == "homography" else ""
    settled = "" if found.has_converged else ", not converged"
    quality = (
        f"Mean error **E = {_length(found.mean_error_m)}** over {found.valid} pairs; σ = "
        f"{_length(found.sigma_m)} per axis over {int(found.inliers.sum())} inliers. Condition "
        f"{found.condition:.3g}; {counted(found.refits, 'refit')}{settled}."
    )
    return f"A ({found.model}){near}:\n\n" + _listed(lines) + f"\n\n{quality}" + _refused(found)


def matrix_text(A: FloatArray) -> str:
    """A, (3, 3), for ``(x', z', w') = (x, z, 1) A``."""
    rows = "\n".join("  ".join(f"{value:9.4f}" for value in row) for row in A)
    return f"`(x′, z′, w′) = (x, z, 1) A`\n\n```\n{rows}\n```"


def failure_text(refusal: str) -> str:
    """Why there is no A."""
    return (
        f"**There is no A for this frame:** {refusal}\n\nClasses and repairs do not need it: pairs "
        "along the curve are compared through the mount, pairs in a row by their ranges. Only the "
        "published pairing compares nothing without A."
    )


def draw_text(draw: RansacDraw, found: Registration) -> str:
    """One draw, compared with the best draw and with the refined A."""
    count, best = len(found.draws), found.best_draw
    mark = " ★ **the best draw**" if draw.index == best else ""
    if np.isfinite(draw.A).all():
        percent = _percent(draw.inliers / found.valid, 0)
        outcome = (
            f"its A agrees with **{draw.inliers}** of {found.valid} pairs ({percent}) within "
            f"{_length(found.draws.inlier_threshold_m)}"
        )
    else:
        outcome = "its pairs do not determine a transform"
    numbers = ", ".join(str(pair) for pair in draw.pairs)
    after = ""
    if draw.index == best:
        after = (
            f" After {counted(found.refits, 'refit')} to its inliers, A agrees with "
            f"{int(found.inliers.sum())}."
        )
    return f"Draw **{draw.index}** of 0…{count - 1}{mark}: {outcome}.{after} Pairs {numbers}."


def consensus_text(found: Registration, consensus: Consensus) -> str:
    """The confidence that the number of draws gives."""
    n, count = found.draws.sample_size, len(found.draws)
    return (
        f"{_percent(consensus.inlier_fraction, 0)} of the pairs are inliers (c), so a draw of "
        f"n = {n} has only inliers with probability cⁿ = "
        f"{_probability(consensus.clean_probability)}; at least one of {count} draws has with "
        f"{_probability(consensus.any_clean_probability)}. The best is draw {found.best_draw}."
    )


def epsilon_text(measured: EpsilonInFrame, epsilon: float, unit: EpsilonUnit) -> str:
    """The threshold in metres, the pairs beyond it, and the paper's band."""
    if measured.compared == 0:
        return "No pair of this frame has both values."
    if not np.isfinite(measured.median_m):
        return "This frame has no E, so ε in multiples of E has no value: no pair counts as beyond."
    spread = ""
    if measured.max_m > 1.01 * measured.min_m:
        spread = f" ({_cm(measured.min_m)} to {_cm(measured.max_m)} cm, growing with range)"
    own = "" if unit == "m" else f" = {epsilon:g}{_UNIT_SIGNS[unit]}"
    lines = [
        f"ε = **{_cm(measured.median_m)} cm**{own}{spread}; **{measured.beyond}** of "
        f"{measured.compared} pairs disagree by more."
    ]
    if np.isfinite(measured.E_m):
        low_m, high_m = measured.band_m
        where = "inside"
        if measured.median_m < low_m * (1.0 - 1e-9):
            where = "below"
        elif measured.median_m > high_m * (1.0 + 1e-9):
            where = "above"
        ratio = "" if measured.E_m <= 0.0 else f", {measured.median_m / measured.E_m:.2f} E"
        lines.append(
            f"The paper's band [E, √2 E] is [{_cm(low_m)}, {_cm(high_m)}] cm here: ε lies "
            f"**{where}** it{ratio}."
        )
    else:
        lines.append("This frame has no E, so the paper's band [E, √2 E] is not known.")
    return "  \n".join(lines)


def _cm(length_m: float) -> str:
    return f"{100.0 * length_m:.1f}"


def _refused(found: Registration) -> str:
    if not found.rejected:
        return ""
    reasons = [f"{refusal.model}: {refusal.reason}" for refusal in found.rejected]
    return "\n\nRefused:\n\n" + _listed(reasons)


def _listed(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _turn(angle_rad: float) -> str:
    text = f"{_degrees(abs(angle_rad))}"
    if text == "0.0°":
        return text
    return text + (" to the left" if angle_rad > 0.0 else " to the right")


def _degrees(angle_rad: float) -> str:
    return f"{np.rad2deg(angle_rad):.1f}°".replace("-", "−")


def _shift(shift_m: FloatArray) -> str:
    right_cm, ahead_cm = 100.0 * shift_m
    across = "to the left" if right_cm < 0.0 else "to the right"
    along = "back" if ahead_cm < 0.0 else "ahead"
    return f"{abs(right_cm):.1f} cm {across} and {abs(ahead_cm):.1f} cm {along}"


def _longer(scale: float) -> str:
    comparison = "longer" if scale >= 1.0 else "shorter"
    return f"distances become {_percent(abs(scale - 1.0), 1)} {comparison}"


def _length(length_m: float) -> str:
    if not np.isfinite(length_m):
        return "∞" if length_m > 0.0 else "unknown"
    return f"{100.0 * length_m:.1f} cm"


def _signed(value: float, digits: int) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")


def _probability(value: float) -> str:
    return "more than 99.9 %" if value > 0.999 else _percent(value, 1)


def _percent(fraction: float, digits: int) -> str:
    return f"{100.0 * fraction:.{digits}f} %"
