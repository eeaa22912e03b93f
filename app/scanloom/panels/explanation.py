"""Explains the class and the repair of a beam or a pixel.

Each sentence is derived from the values that decided the class or the repair.
"""

import math

from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.workflows.fuse.settings import ChainSettings
from scanloom.scene.frame_summary import BeamFacts, SampleFacts

_ADJACENT = (
    "no adjacent beam supports it",
    "one adjacent beam supports it",
    "both adjacent beams support it",
)


def explain_beam_class(facts: BeamFacts, settings: ChainSettings) -> str:
    """Why the beam has its class."""
    if facts.lidar.is_decided:
        return _decided(facts.lidar)
    published = settings.noise.burr_criterion == "rougher"
    support = _beam_support(facts)
    match facts.lidar.noise_class:
        case NoiseClass.HOLE:
            return "Hole: the LiDAR returned no range."
        case NoiseClass.CONFLICT:
            weighed = f"{_evidence(facts, 'for')}: {support}"
            return f"Conflict: {_disagrees(facts, 'the camera')}, but {weighed}. {_two_surfaces()}"
        case NoiseClass.BURR if _no_pair(facts):
            return f"Burr: {_nothing_to_compare(facts)}, and too few support it: {support}."
        case NoiseClass.BURR if not _disagree(facts):
            return f"Burr: {_mixed_alike('pixel')} {_capital(support)}."
        case NoiseClass.BURR if published:
            rough = "it deviates from its neighbours no less than its pixel does"
            return f"Burr: {_disagrees(facts, 'the camera')}, and {rough}."
        case NoiseClass.BURR:
            weighed = f"{_evidence(facts, 'against')}: {support}"
            return f"Burr: {_disagrees(facts, 'the camera')}, and {weighed}."
    if _no_pair(facts):
        return f"Good: {_nothing_to_compare(facts)}" + ("." if published else f", and {support}.")
    if _disagree(facts):
        own = f"{_evidence(facts, 'for')}: {support}"
        if published:
            own = "its pixel deviates more from its neighbours"
        return f"Good: {_disagrees(facts, 'the camera')}, but {own}. Its pixel is the burr."
    return f"Good: {_agrees(facts, 'the camera')}."


def explain_pixel_class(facts: BeamFacts, settings: ChainSettings) -> str:
    """Why the beam's pixel has its class."""
    if facts.pixel is None:
        return "No pixel: the beam's point lies outside the image."
    if facts.pixel.is_decided:
        return _decided(facts.pixel)
    published = settings.noise.burr_criterion == "rougher"
    support = _pixel_support(facts)
    match facts.pixel.noise_class:
        case NoiseClass.HOLE:
            return "Hole: the camera gave no depth."
        case NoiseClass.CONFLICT:
            return f"Conflict: {_disagrees(facts, 'the LiDAR')}, but {support}. {_two_surfaces()}"
        case NoiseClass.BURR if not _disagree(facts):
            return f"Burr: {_mixed_alike('beam')} {_capital(support)}."
        case NoiseClass.BURR if published:
            rough = "it deviates more from its neighbours than its beam does"
            return f"Burr: {_disagrees(facts, 'the LiDAR')}, and {rough}."
        case NoiseClass.BURR if facts.pixel_through:
            met = "its beam has met a surface that the camera shows nowhere around"
            return f"Burr: {_disagrees(facts, 'the LiDAR')}, and {met}: it looks through it."
        case NoiseClass.BURR if facts.pixel_gone:
            gone = "the image before shows no such surface there"
            return f"Burr: {_disagrees(facts, 'the LiDAR')}, and {gone}; {support}."
        case NoiseClass.BURR:
            return f"Burr: {_disagrees(facts, 'the LiDAR')}, and too few pixels agree: {support}."
    if _no_pair(facts):
        return "Good: the LiDAR has no range here to compare it with."
    if _disagree(facts):
        own = "its beam deviates no less from its neighbours" if published else support
        return f"Good: {_disagrees(facts, 'the LiDAR')}, but {own}. Its beam is the burr."
    return f"Good: {_agrees(facts, 'the LiDAR')}."


def explain_beam_repair(facts: BeamFacts, settings: ChainSettings) -> str:
    """How the beam was repaired, or why it was not."""
    lidar = facts.lidar
    if lidar.noise_class == NoiseClass.BURR and math.isnan(lidar.from_other_m):
        if facts.steady:
            return "Kept: the scans before and after show it at the same place."
        least = settings.repair.lidar_burr_confidence
        if lidar.confidence < least:
            confidence = _rounded_down(lidar.confidence)
            return f"Kept: its confidence as a burr, {confidence}, is below {least:.2f}."
        return "Kept: the camera sees its range beside it."
    refused = "the camera gives no value"
    if facts.camera_range_m > 0.0:
        refused = (
            f"the camera's range, {length(facts.camera_range_m)}, contradicts both sides of a "
            "narrow gap, or something nearer was seen about this direction, and is rejected"
        )
    return _repair_text(lidar, "the camera", refused, settings)


def explain_pixel_repair(facts: BeamFacts, settings: ChainSettings) -> str:
    """How the pixel was repaired, or why it was not."""
    pixel, beam = facts.pixel, facts.lidar
    if pixel is None:
        return ""
    if pixel.noise_class == NoiseClass.BURR and math.isnan(pixel.from_other_m):
        least = settings.repair.depth_burr_confidence
        confidence = _rounded_down(pixel.confidence)
        return f"Kept: its confidence as a burr, {confidence}, is below {least:.2f}."
    least = settings.repair.lidar_confidence
    if beam.noise_class == NoiseClass.HOLE:
        refused = "the LiDAR has no range here"
    elif beam.noise_class != NoiseClass.GOOD:
        refused = f"the beam is a {beam.noise_class.name.lower()} and not used as a source"
    elif beam.confidence < least:
        refused = f"the beam's confidence, {_rounded_down(beam.confidence)}, is below {least:.2f}"
    elif not facts.lidar_as_depth_m > 0.0:
        refused = "the LiDAR gives no value"
    else:
        refused = "the pixels around it are nearer and may occlude the LiDAR's point"
    return _repair_text(pixel, "the LiDAR", refused, settings)


def length(metres: float) -> str:
    """A length in readable units; a dash for NaN."""
    if not math.isfinite(metres):
        return "–"
    return f"{100.0 * metres:.1f} cm" if abs(metres) < 1.0 else f"{metres:.2f} m"


def _repair_text(
    sample: SampleFacts, other: str, other_refused: str, settings: ChainSettings
) -> str:
    """``other_refused``: why the other sensor gives no value, if so."""
    if sample.noise_class == NoiseClass.GOOD:
        return "Kept: good values are not changed."
    if sample.noise_class == NoiseClass.CONFLICT:
        return "Kept: in a conflict both values stay, so that no obstacle is lost."
    done = "Filled" if sample.noise_class == NoiseClass.HOLE else "Replaced"
    from_other, from_neighbours = sample.from_other_m, sample.from_neighbours_m
    match sample.source:
        case RepairSource.NONE:
            return f"Left empty: {other_refused}, and its neighbours give no value."
        case RepairSource.RAW if math.isinf(from_other) and math.isinf(from_neighbours):
            return f"Kept: {other_refused}, and its neighbours give no value."
        case RepairSource.RAW:
            least = settings.repair.farther_confidence
            return (
                "Kept: a repair would move it farther away, and its confidence as a burr, "
                f"{_rounded_down(sample.confidence)}, is below {least:.2f}."
            )
        case RepairSource.OTHER_SENSOR:
            against = f"{length(from_neighbours)} from its neighbours"
            own, theirs, source = from_other, from_neighbours, other
            none = "its neighbours give no value"
            preferred = settings.repair.prefer == "other_sensor"
        case RepairSource.NEIGHBOURS:
            against = f"{length(from_other)} from {other}"
            own, theirs, source = from_neighbours, from_other, "its neighbours"
            none = other_refused
            preferred = False
    text = f"{done} from {source}: expected error {length(own)}"
    if preferred:
        return f"{text}. The other sensor is preferred, regardless of the neighbours."
    return f"{text}; {none}." if math.isinf(theirs) else f"{text} against {against}."


def _decided(sample: SampleFacts) -> str:
    return f"{sample.noise_class.name.capitalize()}: a person's label says so."


def _no_pair(facts: BeamFacts) -> bool:
    return facts.pixel is None or math.isnan(facts.pixel.raw_m) or math.isnan(facts.lidar.raw_m)


def _disagree(facts: BeamFacts) -> bool:
    return abs(facts.residual_m) > facts.epsilon_m


def _disagrees(facts: BeamFacts, other: str) -> str:
    return (
        f"it disagrees with {other} by {length(abs(facts.residual_m))}, "
        f"more than ε ({length(facts.epsilon_m)})"
    )


def _agrees(facts: BeamFacts, other: str) -> str:
    if math.isnan(facts.residual_m):
        return "this frame has no transform A, so that nothing is compared"
    difference = length(abs(facts.residual_m))
    if math.isnan(facts.epsilon_m):
        return f"ε has no value in this frame, so that a difference of {difference} is allowed"
    return f"it differs from {other} by {difference}, within ε ({length(facts.epsilon_m)})"


def _nothing_to_compare(facts: BeamFacts) -> str:
    if facts.pixel is None:
        return "its point lies outside the image, with nothing to compare it with"
    return "the camera has no depth here to compare it with"


def _mixed_alike(other: str) -> str:
    return (
        f"it and its {other} do not disagree, but neither has enough support. "
        "At an edge both sensors may mix the same two surfaces."
    )


def _two_surfaces() -> str:
    return "Each sensor sees another surface."


def _beam_support(facts: BeamFacts) -> str:
    near, beyond, in_time = facts.supporters
    farther = f"beams two or three away: {beyond}, scans before and after: {in_time}"
    return f"{_ADJACENT[near]} ({farther})"


def _evidence(facts: BeamFacts, direction: str) -> str:
    beside, in_time, camera = facts.evidence
    witnesses = f"beside it {beside:+.1f}, in time {in_time:+.1f}, by the camera {camera:+.1f}"
    return f"the evidence is {direction} a surface ({witnesses})"


def _pixel_support(facts: BeamFacts) -> str:
    supporters, valid = facts.pixel_supporters
    return f"{supporters} of the {valid} depths around it support it"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _rounded_down(confidence: float) -> str:
    """To two digits: a value below a limit must not read as the limit."""
    return f"{math.floor(100.0 * confidence) / 100.0:.2f}"
