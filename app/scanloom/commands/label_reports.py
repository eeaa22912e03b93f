"""Results of ``scanloom labels`` as lines of text."""

from collections.abc import Mapping, Sequence
from typing import Any

from scanloom.commands.reports import table_lines

_UNLABELLED = "none"
_OF_PAIR = {
    "percent": "percent",
    "cohen_kappa": "Cohen's kappa",
    "sample_iou": "IoU of samples",
    "panoptic_quality": "panoptic quality of runs",
    "matched_iou": "IoU of matched runs",
}
_OVERALL = {
    "percent": "percent",
    "fleiss_kappa": "Fleiss' kappa",
    "krippendorff_alpha": "Krippendorff's alpha",
}


def export_lines(result: Mapping[str, Any]) -> list[str]:
    """File, format, layer, and what was written and left out."""
    lines = [
        f"output   {result['output']} ({result['format']})",
        f"layer    {result['layer']}",
        f"written  {_by_sensor(result['written'])}",
    ]
    if result["left_out"]:
        lines.append(
            f"left out {_by_sensor(result['left_out'])}: {result['format']} has no place for them"
        )
    return lines


def import_lines(result: Mapping[str, Any]) -> list[str]:
    """The difference, and what was done about it."""
    difference = result["difference"]
    lines = [
        f"file     {result['file']} ({result['format']})",
        f"layer    {result['layer']} in {result['store']}",
        *_difference_lines(difference),
    ]
    if not result["done"]:
        lines += ["", "Nothing was imported: --replace makes the layer as the file."]
    elif not difference["samples"]:
        lines += ["", "Nothing to import: the layer is as the file."]
    return lines


def merge_lines(result: Mapping[str, Any]) -> list[str]:
    """Each layer's difference, and what was done about it."""
    lines = [f"from     {result['from']}", f"into     {result['store']}"]
    for layer, difference in result["layers"].items():
        lines += ["", f"layer    {layer}", *_difference_lines(difference)]
    if not result["done"]:
        lines += ["", "Nothing was merged: --replace takes the other store's labels."]
    return lines


def _difference_lines(difference: Mapping[str, Any]) -> list[str]:
    lines = [
        f"differs  {difference['added']} labels added, {difference['altered']} altered, "
        f"{difference['missing']} missing, in {difference['captures']} captures"
    ]
    if difference["altered"] or difference["missing"]:
        rows = [
            (found["before"] or _UNLABELLED, found["after"] or _UNLABELLED, str(found["samples"]))
            for found in difference["samples"]
        ]
        lines += ["", *table_lines([("here", "there", "samples"), *rows])]
    return lines


def agreement_lines(result: Mapping[str, Any]) -> list[str]:
    """Overall, by class, by layer, and for each pair with its confusion matrix."""
    lines = [
        f"captures  {result['captures']}",
        f"samples   {result['complete_samples']} that all layers decided on",
        "",
        *_estimate_table("overall", {"": result}, _OVERALL),
        "",
        *_estimate_table("class", result["by_class"], _OVERALL),
        "",
        *_estimate_table("layer with the others", result["layers"], _OF_PAIR),
    ]
    for pair in result["pairs"]:
        names = f"{pair['first']} and {pair['second']}"
        lines += [
            "",
            f"{names}: {pair['samples']} samples",
            *_estimate_table("class", {"all": pair, **pair["by_class"]}, _OF_PAIR),
            "",
            *_confusion_table(pair, result["classes"]),
        ]
    return lines


def _estimate_table(
    what: str, rows: Mapping[str, Mapping[str, Any]], titles: Mapping[str, str]
) -> list[str]:
    shown = {
        key: title for key, title in titles.items() if any(key in row for row in rows.values())
    }
    body = [
        [name, *(_estimate(row[key]) if key in row else "" for key in shown)]
        for name, row in rows.items()
    ]
    return table_lines([[what, *shown.values()], *body])


def _estimate(found: Mapping[str, Any]) -> str:
    if found["value"] is None:
        return f"- ({found['undefined']})"
    if found["low"] is None:
        return f"{found['value']:.3f}"
    return f"{found['value']:.3f} [{found['low']:.3f}, {found['high']:.3f}]"


def _confusion_table(pair: Mapping[str, Any], classes: Sequence[str]) -> list[str]:
    header = [f"{pair['first']} \\ {pair['second']}", *classes]
    rows = [
        [name, *map(str, counts)] for name, counts in zip(classes, pair["confusion"], strict=True)
    ]
    return table_lines([header, *rows])


def log_lines(result: Mapping[str, Any]) -> list[str]:
    """A line for each action."""
    columns = ("id", "time (UTC)", "annotator", "layer", "action", "source", "samples", "comment")
    rows = [
        (
            str(action["id"]),
            action["time_utc"].removesuffix("+00:00"),
            action["annotator"],
            action["layer"],
            action["kind"] + ("" if action["target"] is None else f" {action['target']}"),
            action["source"],
            f"{action['samples']} in {action['captures']}",
            action["comment"],
        )
        for action in result["actions"]
    ]
    return table_lines([columns, *rows]) if rows else ["no actions"]


def statistics_lines(result: Mapping[str, Any]) -> list[str]:
    """Labels by layer and class, then the annotators' work."""
    if not result["layers"]:
        return ["no labels"]
    names = list(next(iter(result["layers"].values())))
    layers = [
        [layer, *(str(counts[name]) for name in names)]
        for layer, counts in result["layers"].items()
    ]
    work = [
        [
            found["annotator"],
            found["layer"],
            str(found["actions"]),
            str(found["samples"]),
            f"{found['minutes']:.1f}",
            _rate(found["actions_per_minute"]),
        ]
        for found in result["annotators"]
    ]
    titles = ("annotator", "layer", "actions", "samples", "minutes", "actions per minute")
    return [
        *table_lines([["layer", *names], *layers]),
        "",
        *table_lines([titles, *work]),
    ]


def _rate(per_minute: float | None) -> str:
    return "-" if per_minute is None else f"{per_minute:.1f}"


def _by_sensor(counts: Mapping[str, int]) -> str:
    names = {"lidar": "beams", "depth": "pixels"}
    shown = [f"{count} {names[sensor]}" for sensor, count in sorted(counts.items())]
    return ", ".join(shown) if shown else "nothing"
