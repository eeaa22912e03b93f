"""What is told of each recording of a batch: one declaration for batch.parquet, the report's table
and the workbench's list."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees
from typing import TYPE_CHECKING, Any, Literal

from fusion_core.model.rig import MOUNT_PARAMETERS

if TYPE_CHECKING:
    import pyarrow as pa

ArrowType = Literal["text", "texts", "whole", "real"]
Show = Literal["text", "texts", "whole", "real", "degrees", "percent", "megabytes", "instant", "no"]

UNKNOWN_TEXT = "–"


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """``unit``: of the stored value. ``label``: its heading where it is shown, with the unit that
    is shown. ``digits``: after the point. ``sd_of``: it is the standard deviation of that column,
    shown beside it. Unknown values are null."""

    name: str
    type: ArrowType
    label: str
    help: str
    unit: str = ""
    show: Show
    digits: int = 2
    sd_of: str | None = None

    @property
    def is_number(self) -> bool:
        return self.show not in ("text", "texts", "instant", "no")

    @property
    def shown_unit(self) -> str:
        """The unit in which a number is shown, "" where it has none."""
        return self.label.partition(", ")[2]

    def shown_number(self, value: float) -> float:
        """A value in the unit that is shown."""
        if self.show == "degrees":
            return degrees(value)
        return value * {"percent": 100.0, "megabytes": 1e-6}.get(self.show, 1.0)

    def format(self, value: Any) -> str:
        """A value as text, without its unit."""
        if value is None:
            return UNKNOWN_TEXT
        if self.show == "instant":
            return format_instant(int(value))
        if self.show == "texts":
            return "; ".join(value)
        if self.show == "whole":
            return str(int(value))
        if self.is_number:
            return f"{self.shown_number(float(value)):.{self.digits}f}"
        return str(value)


def format_instant(stamp_ns: int) -> str:
    """An instant of a recording's own clock: a date where it counts from 1970, else seconds."""
    import numpy as np

    # Clocks that count from the start of a machine are told from those that tell the date.
    if stamp_ns < _FIRST_DATE_NS:
        return f"{stamp_ns / 1e9:.1f} s"
    return str(np.datetime64(stamp_ns, "ns").astype("datetime64[s]")).replace("T", " ")


_FIRST_DATE_NS = 631_152_000 * 10**9
_MOUNT_LABELS = {
    "yaw_rad": ("yaw, deg", "Mount: how far the camera looks to the left of the LiDAR's zero"),
    "delta_z_m": ("height, m", "Mount: the camera above the LiDAR"),
    "forward_m": ("forward, m", "Mount: the camera ahead of the LiDAR"),
    "left_m": ("left, m", "Mount: the camera to the left of the LiDAR"),
    "pitch_rad": ("pitch, deg", "Mount: how far the camera looks down"),
    "clock_offset_ms": ("clock, ms", "Camera stamp - LiDAR stamp of the same instant"),
}


def _mount_columns() -> list[Column]:
    columns: list[Column] = []
    for name in MOUNT_PARAMETERS:
        label, text = _MOUNT_LABELS[name]
        unit = name.rsplit("_", 1)[1]
        columns += _with_deviation(
            Column(
                name=name,
                type="real",
                unit=unit,
                label=label,
                help=f"{text}; empty where the recording does not show it",
                show="degrees" if unit == "rad" else "real",
                digits={"rad": 2, "m": 3, "ms": 1}[unit],
            )
        )
    return columns


def _share_columns() -> list[Column]:
    sensors = {"lidar": ("LiDAR", "beams in view"), "depth": ("depth", "their pixels")}
    return [
        column
        for noise in ("hole", "burr", "conflict")
        for sensor, (label, of) in sensors.items()
        for column in _with_deviation(
            Column(
                name=f"{sensor}_{noise}_share",
                type="real",
                label=f"{label} {noise}s, %",
                help=f"Fraction of {of} that are classified as {noise}s",
                show="percent",
                digits=1,
            )
        )
    ]


def _with_deviation(column: Column) -> tuple[Column, Column]:
    """A column, and that of its standard deviations."""
    deviation = replace(
        column,
        name=f"{column.name}_sd",
        label="±",
        help=f"Standard deviation of {column.name}",
        sd_of=column.name,
    )
    return column, deviation


COLUMNS: tuple[Column, ...] = (
    Column(name="name", type="text", label="name", help="Of its results below runs", show="text"),
    Column(name="state", type="text", label="state", help="Whether the work is done", show="text"),
    Column(
        name="flags",
        type="texts",
        label="flags",
        help="In what it differs from the other recordings of its rig",
        show="texts",
    ),
    Column(
        name="recording", type="text", label="recording", help="Its path or address", show="text"
    ),
    Column(name="robot", type="text", label="robot", help="Whose recording it is", show="text"),
    Column(name="command", type="text", label="command", help="What was run", show="text"),
    Column(
        name="start_ns",
        type="whole",
        unit="ns",
        label="start",
        help="First stamp of the sensors, by the recording's own clock (UTC where it has a date)",
        show="instant",
    ),
    Column(
        name="duration_s",
        type="real",
        unit="s",
        label="length, s",
        help="From the first stamp to the last",
        show="real",
        digits=1,
    ),
    Column(
        name="frames",
        type="whole",
        label="images",
        help="Depth images, or scans of a map",
        show="whole",
    ),
    Column(
        name="paired",
        type="whole",
        label="paired",
        help="Depth images with a scan, or scans that are placed in the map",
        show="whole",
    ),
    *_mount_columns(),
    Column(
        name="agreement",
        type="real",
        label="agreement, %",
        help="Fraction of the visible LiDAR points that the depth images confirm",
        show="percent",
        digits=1,
    ),
    Column(
        name="peak_score",
        type="real",
        label="peak score",
        help="Similarity at the recording's offset (u, v)",
        show="real",
        digits=3,
    ),
    *_share_columns(),
    *_with_deviation(
        Column(
            name="untrusted_share",
            type="real",
            label="not trusted, %",
            help="Fraction of the images whose own offset contradicts the recording's, or of the "
            "scans that do not fit the map",
            show="percent",
            digits=1,
        )
    ),
    Column(
        name="untrusted_stretches",
        type="whole",
        label="stretches",
        help="Uninterrupted stretches of those",
        show="whole",
    ),
    Column(
        name="seconds",
        type="real",
        unit="s",
        label="work, s",
        help="Time that the work took",
        show="real",
        digits=1,
    ),
    Column(
        name="recorded_bytes",
        type="whole",
        unit="B",
        label="size, MB",
        help="Size of the recording",
        show="megabytes",
        digits=1,
    ),
    Column(
        name="warnings",
        type="texts",
        label="warnings",
        help="What the run or its reading had to tell",
        show="texts",
    ),
    Column(name="error", type="text", label="error", help="Why it failed", show="text"),
    Column(name="advice", type="text", label="advice", help="What to do about it", show="text"),
    Column(
        name="reasons",
        type="texts",
        label="reasons",
        help="For each flag the value, that of the other recordings, their spread, and z",
        show="texts",
    ),
    Column(
        name="geometry",
        type="text",
        label="sensors",
        help="Of its LiDAR and its cameras: what may be compared",
        show="text",
    ),
)

Row = dict[str, Any]
"""A value for each column, None where it is unknown."""


def column_of(name: str) -> Column:
    """The column of that name. Raises KeyError."""
    return _BY_NAME[name]


_BY_NAME = {column.name: column for column in COLUMNS}


# Told beside the list, or at its rows.
_NOT_IN_LIST = {"recording", "command", "reasons", "geometry", "advice"}
_ALWAYS_IN_LIST = {"name", "state", "flags"}


def shown_columns(table: "pa.Table") -> list[Column]:
    """The columns of a list for people: those that hold anything, without deviations."""
    return [
        column
        for column in COLUMNS
        if column.sd_of is None
        and column.name not in _NOT_IN_LIST
        and (column.name in _ALWAYS_IN_LIST or _holds_anything(table[column.name]))
    ]


def _holds_anything(values: "pa.ChunkedArray") -> bool:
    return any(value not in (None, "", []) for value in values.to_pylist())


def format_with_deviation(column: Column, row: Row) -> str:
    """A value of a row as text, with its standard deviation where the digits show it."""
    value, sd = row[column.name], row.get(f"{column.name}_sd")
    text = column.format(value)
    if value is None or sd is None:
        return text
    sd_text = column_of(f"{column.name}_sd").format(sd)
    return f"{text} ± {sd_text}" if float(sd_text) > 0.0 else text


def unknown_row() -> Row:
    """A row in which nothing is known yet."""
    row: Row = dict.fromkeys(_BY_NAME)
    return row | {column.name: [] for column in COLUMNS if column.type == "texts"}


def arrow_schema(metadata: dict[str, str] | None = None) -> "pa.Schema":
    """The schema of batch.parquet, with unit and help beside each column."""
    import pyarrow as pa

    types = {
        "text": pa.string(),
        "texts": pa.list_(pa.string()),
        "whole": pa.int64(),
        "real": pa.float64(),
    }
    fields = [
        pa.field(
            column.name,
            types[column.type],
            metadata={"unit": column.unit, "label": column.label, "help": column.help},
        )
        for column in COLUMNS
    ]
    return pa.schema(fields, metadata=metadata)


def arrow_batch(rows: Sequence[Row], schema: "pa.Schema") -> "pa.RecordBatch":
    """Rows as a batch of that schema."""
    import pyarrow as pa

    return pa.RecordBatch.from_pylist(list(rows), schema=schema)
