"""The Repair panel's tables as HTML: counts by class and repair source, details of one beam."""

import math

from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.settings import ChainSettings
from scanloom.panels.explanation import (
    explain_beam_class,
    explain_beam_repair,
    explain_pixel_class,
    explain_pixel_repair,
    length,
)
from scanloom.resources import palette
from scanloom.scene.frame_summary import (
    BeamFacts,
    SampleFacts,
    counts_of_beams,
    counts_of_pixels,
    facts_of_beam,
)

_BOX = "<div style='padding:0 0.9em 0.6em;font-size:0.85em;line-height:1.45'>"
_TABLE = (
    "<table style='width:100%;border-collapse:collapse;font-variant-numeric:tabular-nums'>"
    "{}</table>"
)
_FIRST_CELL = "<td style='padding:0.05em 0.6em 0.05em 0'>{}</td>"
_VALUE_CELL = "<td style='padding:0.05em 0;text-align:right'>{}</td>"
_SEPARATOR_ROW = (
    "<tr><td colspan='3' style='border-top:1px solid rgba(128,128,128,0.35)'></td></tr>"
)
_SOURCE_LABELS = (
    (RepairSource.OTHER_SENSOR, "repaired from the other sensor"),
    (RepairSource.NEIGHBOURS, "repaired from neighbours"),
    (RepairSource.RAW, "kept as they are"),
    (RepairSource.NONE, "left empty"),
)


def class_table(frame: FusedFrame) -> str:
    """Counts of beams and pixels by class, and of holes and burrs by repair source."""
    beams, pixels = counts_of_beams(frame), counts_of_pixels(frame)
    rows = [_row("", "beams", "pixels")]
    rows += [
        _row(_class_label(noise), str(beams.by_class[noise]), str(pixels.by_class[noise]))
        for noise in NoiseClass
    ]
    rows += [_row("outside the image", "", str(pixels.without_pixel)), _SEPARATOR_ROW]
    rows += [_row("of the holes and burrs", "", "")]
    rows += [
        _row(words, str(beams.by_source[source]), str(pixels.by_source[source]))
        for source, words in _SOURCE_LABELS
    ]
    return f"{_BOX}{_TABLE.format(''.join(rows))}</div>"


def beam_table(frame: FusedFrame, beam: int | None, settings: ChainSettings) -> str:
    """Class, confidence, values and source of a beam and its pixel, with the reasons."""
    if beam is None:
        return f"{_BOX}Choose a conflict, type a beam's number, or click a beam or a pixel.</div>"
    facts = facts_of_beam(frame, beam)
    if facts is None:
        return f"{_BOX}{_out_of_view(frame, beam)}</div>"
    beam_side, pixel_side = _side(facts.lidar, "camera"), _side(facts.pixel, "LiDAR")
    titles = ("", "class", "confidence (0 to 1)", "recorded", "repaired", "source")
    heads = (f"beam {facts.beam}, range", "pixel, depth")
    table = "".join(map(_row, titles, (heads[0], *beam_side), (heads[1], *pixel_side)))
    paragraphs = [
        "<b>Beam.</b> "
        f"{explain_beam_class(facts, settings)} {explain_beam_repair(facts, settings)}",
        "<b>Pixel.</b> "
        f"{explain_pixel_class(facts, settings)} {explain_pixel_repair(facts, settings)}",
        _measures(facts),
    ]
    text = "".join(f"<p style='margin:0.5em 0 0'>{line}</p>" for line in paragraphs)
    return f"{_BOX}{_TABLE.format(table)}{text}</div>"


def _side(sample: SampleFacts | None, other: str) -> tuple[str, ...]:
    """Class, confidence, raw and repaired value, and source of one side."""
    if sample is None:
        return ("none", "", "", "", "")
    source = {
        RepairSource.RAW: "itself",
        RepairSource.OTHER_SENSOR: f"the {other}",
        RepairSource.NEIGHBOURS: "its neighbours",
        RepairSource.NONE: "none",
    }[sample.source]
    return (
        _class_label(sample.noise_class),
        f"{sample.confidence:.2f}",
        _metres(sample.raw_m),
        _metres(sample.repaired_m),
        source,
    )


def _measures(facts: BeamFacts) -> str:
    measures = [f"azimuth {facts.azimuth_deg:.1f}°"]
    if facts.pixel is not None:
        measures += [
            f"pixel in row {facts.row}, column {facts.column}",
            f"its depth as a range: {_metres(facts.pixel_range_m)}",
        ]
    measures += [
        f"along the beam the camera sees a surface at {_metres(facts.camera_range_m)}",
        f"difference {length(facts.residual_m)}",
        f"tolerance ε {length(facts.epsilon_m)}",
    ]
    return "<b>Measures.</b> " + "; ".join(measures).replace("-", "−") + "."


def _out_of_view(frame: FusedFrame, beam: int) -> str:
    ranges_m = frame.match.scan.ranges_m
    if beam >= ranges_m.size:
        return f"The scan has {ranges_m.size} beams; there is no beam {beam}."
    return (
        f"Beam {beam} lies outside the camera's view, so it has no class. "
        f"Its range: {_metres(float(ranges_m[beam]))}."
    )


def _row(first: str, second: str, third: str) -> str:
    values = "".join(_VALUE_CELL.format(value) for value in (second, third))
    return f"<tr>{_FIRST_CELL.format(first)}{values}</tr>"


def _class_label(noise: NoiseClass) -> str:
    """A class name with a swatch of its colour."""
    name = noise.name.lower()
    return (
        "<span style='display:inline-block;width:0.75em;height:0.75em;margin-right:0.45em;"
        f"background:{palette()[name]}'></span>{name}"
    )


def _metres(value: float) -> str:
    return f"{value:.2f} m" if math.isfinite(value) else "no value"
