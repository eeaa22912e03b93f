"""Results of commands as lines of text; ``--json`` prints the results themselves."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

NS_PER_S = 1e9


@dataclass(frozen=True, kw_only=True)
class Report:
    """A command's output: ``result`` under ``--json``, else ``lines``.

    ``failed``: exit with code 1, as a check that found damage does.
    """

    result: dict[str, Any]
    lines: Sequence[str]
    failed: bool = False


def info_lines(info: Mapping[str, Any]) -> list[str]:
    """Format, times, outcome of the check, topics, possible commands, and warnings."""
    lines = [f"format    {info['format']}"]
    if "rooms" in info:
        return [*lines, "", *_room_table(info["rooms"]), "", *info["can"]]
    if info["start_ns"] is None:
        lines.append("time      none in this format")
    else:
        start_s, end_s = info["start_ns"] / NS_PER_S, info["end_ns"] / NS_PER_S
        lines.append(f"time      {start_s:.3f} s to {end_s:.3f} s, {info['duration_s']:.3f} s")
    check = info["check"]
    lines += ["checked   " + _check_outcome(check), ""]
    header = ["topic", "role", "count", "rate (Hz)", "type"]
    rows = [
        [
            topic["name"],
            topic["role"],
            str(topic["count"]),
            "-" if topic["rate_hz"] is None else f"{topic['rate_hz']:.2f}",
            topic["type"],
        ]
        for topic in info["topics"]
    ]
    if check is not None:
        header.insert(3, "unreadable")
        unreadable = {topic["name"]: topic["unreadable"] for topic in check["topics"]}
        for row in rows:
            row.insert(3, str(unreadable[row[0]]))
    lines += table_lines([header, *rows])
    lines.append("")
    lines += info["can"]
    lines += [f"warning: {warning}" for warning in info["warnings"]]
    return lines


def _check_outcome(check: Mapping[str, Any] | None) -> str:
    if check is None:
        return "no: --check reads every message and verifies all checksums in the file"
    outcome = "damaged" if check["damaged"] else "whole"
    messages = f"{check['read']} messages read, {check['unreadable']} unreadable"
    if not check["checksums"] and not check["unguarded"]:
        return f"{outcome}: {messages}"
    guarded = f"checksums correct: {check['checksums']}"
    if not check["checksums"]:
        guarded = "no checksums, so changed values are not detected"
    elif check["unguarded"]:
        guarded += f", parts without one: {check['unguarded']}"
    return f"{outcome}: {messages}; {guarded}"


def conversion_lines(conversion: Mapping[str, Any]) -> list[str]:
    """File, times, written and skipped topics, and notes."""
    lines = [f"file      {conversion['file']}", f"from      {conversion['format']}"]
    if conversion["start_ns"] is not None:
        start_s, end_s = conversion["start_ns"] / NS_PER_S, conversion["end_ns"] / NS_PER_S
        lines.append(f"time      {start_s:.3f} s to {end_s:.3f} s, {end_s - start_s:.3f} s")
    lines += [f"messages  {conversion['written']}, left out {conversion['left_out']}", ""]
    rows = [
        (topic["name"], str(topic["count"]), str(topic["left_out"]), topic["type"])
        for topic in conversion["topics"]
    ]
    lines += table_lines([("topic", "written", "left out", "type"), *rows])
    lines += [f"skipped: {topic['name']}: {topic['reason']}" for topic in conversion["skipped"]]
    lines += [f"note: {note}" for note in conversion["notes"]]
    return lines


def _room_table(rooms: Sequence[Mapping[str, Any]]) -> list[str]:
    columns = ("home", "session", "room", "subsession", "scans", "images", "depth_bits")
    shown = [[format_value(room[column]) for column in columns] for room in rooms]
    return table_lines([[column.replace("_", " ") for column in columns], *shown])


def scene_lines(listed: Mapping[str, Any]) -> list[str]:
    """The scenes, and the path of the built-in recording."""
    rows = [(scene["name"], scene["description"]) for scene in listed["scenes"]]
    return [*table_lines(rows), "", f"built-in recording: {listed['built_in']}"]


def measure_lines(measures: Mapping[str, Any]) -> list[str]:
    """One line for each number, named by its path in the result; lists are only in ``--json``."""
    named = [(name, value) for name, value in _flatten(measures, "") if not isinstance(value, list)]
    width = max((len(name) for name, _ in named), default=0)
    return [f"{name:<{width}}  {format_value(value)}" for name, value in named]


def trajectory_lines(evaluation: Mapping[str, Any]) -> list[str]:
    """Association and alignment, then the statistics of each error."""
    counts = "{associated} of {estimate_poses} poses, against {reference_poses}"
    lines = [
        f"compared     {counts.format(**evaluation)}",
        f"coverage     {evaluation['coverage']:.1%} of the reference's time, longest gap "
        f"{evaluation['longest_gap_s']:.3f} s",
        f"path         {evaluation['path_m']:.3f} m",
    ]
    alignment, relative = evaluation["T_reference_estimate"], evaluation["relative"]
    if alignment is not None:
        scale = f", scale {alignment['scale']:.6f}" if evaluation["alignment"] == "sim3" else ""
        lines.append(f"aligned by   {evaluation['alignment']}{scale}")
    step = f"{relative['delta']:g} {relative['unit']}"
    lines += [f"relative to  {step}, {relative['pairs']} pairs", ""]
    named = {
        "absolute": evaluation["absolute"],
        "absolute, aligned": evaluation["absolute_aligned"],
        f"relative, {step}": relative,
    }
    statistics = ("min", "max", "mean", "median", "variance", "std", "rmse")
    rows = [
        (name, unit, *(f"{errors[key][statistic]:.4g}" for statistic in statistics))
        for name, errors in named.items()
        if errors is not None
        for key, unit in (("translation_m", "m"), ("rotation_deg", "deg"))
    ]
    lines += table_lines([("error", "unit", *statistics), *rows])
    return lines + [f"warning: {warning}" for warning in evaluation["warnings"]]


def relation_lines(evaluation: Mapping[str, Any]) -> list[str]:
    """Coverage, then mean and standard deviation of each error and of its square."""
    counts = "{covered} of {relations} within the trajectory".format(**evaluation)
    lines = [f"relations  {counts} ({evaluation['coverage']:.1%})", ""]
    rows = [
        (
            title,
            size,
            *(f"{evaluation[name][key][figure]:.3f}" for key in keys for figure in ("mean", "std")),
        )
        for name, title in (("kuemmerle", "Kümmerle"), ("cartographer", "Cartographer"))
        for size, keys in (
            ("absolute", ("translation_m", "rotation_deg")),
            ("squared", ("translation_squared_m2", "rotation_squared_deg2")),
        )
    ]
    header = ("measure", "error", "translation (m)", "std", "rotation (deg)", "std")
    lines += table_lines([header, *rows])
    return lines + [f"warning: {warning}" for warning in evaluation["warnings"]]


def room_lines(room: Mapping[str, Any]) -> list[str]:
    """Each dimension with its uncertainty, and its error where the truth is known."""
    named = [(name, room[name]) for name in ("length", "width", "height")]
    header = ["", "m", "sd (mm)", "noise (mm)", "points", "parallel (deg)"]
    rows = [
        [
            name,
            f"{found['m']:.4f}",
            f"{found['sd_m'] * 1000.0:.1f}",
            f"{found['scatter_m'] * 1000.0:.1f}",
            str(found["inliers"]),
            f"{found['parallel_deg']:.2f}",
        ]
        for name, found in named
    ]
    if "error_m" in room["length"]:
        header += ["true (m)", "error (mm)"]
        for row, (_, found) in zip(rows, named, strict=True):
            row += [f"{found['true_m']:.4f}", f"{found['error_m'] * 1000.0:+.1f}"]
    return [
        *table_lines([header, *rows]),
        "",
        f"by {room['points']} points",
        *(f"warning: {warning}" for warning in room["warnings"]),
    ]


def map_lines(evaluation: Mapping[str, Any]) -> list[str]:
    """Alignment, detection rates by outline and by obstacle, false obstacles, and the errors of
    lines and angles with how many of them the map shows."""
    alignment = evaluation["alignment"]
    lines = ["aligned    no, taken to be in the world's frame"]
    if alignment is not None:
        moved = "{x_m:.3f} m, {y_m:.3f} m, {yaw_deg:.2f} deg".format(**alignment)
        lines = [f"aligned    by {moved}; {alignment['cells_near']:.1%} of the cells near outlines"]
    false, per_m2 = evaluation["false_obstacles"], evaluation["false_cells_per_m2"]
    lines += [
        f"found      within {evaluation['reach_m']:.3f} m of an occupied cell",
        f"false      {_percentage(false)} of {evaluation['occupied_cells']} occupied cells lie "
        f"farther from every outline: {format_value(per_m2)} a square metre "
        f"of {evaluation['mapped_m2']:.1f} m2 mapped",
        "",
    ]
    parts = ("all", "visible", "visible_to_lidar", "visible_to_camera")
    rows = [(part.replace("_", " "), *_detection_cells(evaluation[part])) for part in parts]
    lines += [*table_lines([("outline", "length (m)", "found (m)", "rate"), *rows]), ""]
    rows = [
        (
            obstacle["name"],
            *_detection_cells(obstacle["all"]),
            *(_percentage(obstacle[part]["rate"]) for part in parts[1:]),
        )
        for obstacle in evaluation["obstacles"]
    ]
    header = (
        "obstacle",
        "length (m)",
        "found (m)",
        "rate",
        *(part.replace("_", " ") for part in parts[1:]),
    )
    lines += table_lines([header, *rows])
    for kind, unit in (("lines", "m"), ("angles", "deg")):
        measures = evaluation[kind]
        if not measures["each"]:
            continue
        columns = (f"true_{unit}", f"measured_{unit}", f"error_{unit}")
        rows = [
            (measure["name"], *(format_value(measure[column]) for column in columns))
            for measure in measures["each"]
        ]
        titles = [f"{word} ({unit})" for word in ("true", "measured", "error")]
        mean = measures[f"mean_absolute_error_{unit}"]
        relative = (
            f", relative {_percentage(measures['relative_error'])}" if kind == "lines" else ""
        )
        lines += ["", *table_lines([(kind, *titles), *rows])]
        error = f"; mean absolute error of these {format_value(mean)} {unit}{relative}"
        counts = f"{measures['measured']} of {measures['total']} found"
        lines.append(counts + ("" if mean is None else error))
    return lines


def _detection_cells(part: Mapping[str, Any]) -> tuple[str, str, str]:
    return f"{part['outline_m']:.2f}", f"{part['found_m']:.2f}", _percentage(part["rate"])


def _percentage(fraction: float | None) -> str:
    return "-" if fraction is None else f"{fraction:.2%}"


def _flatten(measures: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in measures.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def format_value(value: Any) -> str:
    """A number with four digits, "-" for None."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def table_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of equal length, in columns."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
