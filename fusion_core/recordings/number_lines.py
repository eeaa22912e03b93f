"""Text files with the same columns of numbers on every line; lines that begin with # are comments.

A line that cannot be read is an error, not a warning: an evaluation against such a file would
otherwise silently use a part of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fusion_core.files.regular_file import open_regular
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.decimal_time import ns_from_decimal_seconds
from fusion_core.recordings.quoting import quote_clipped

# Far beyond any trajectory of a robot; what is larger is another kind of file.
_MAX_BYTES = 1 << 30
_MAX_LINE_BYTES = 4096
# No place on Earth is farther away, and its square is far from overflow.
_LARGEST = 1e9


@dataclass(frozen=True, slots=True)
class NumericLine:
    """The fields of one line, one for each name in ``columns``."""

    file: Path
    number: int
    columns: str
    fields: list[str]

    def time_ns(self, column: int) -> int:
        """A time in seconds, read without a float in between. Raises RecordingError."""
        time_ns = ns_from_decimal_seconds(self.fields[column])
        if time_ns is None:
            raise self.error(f"{quote_clipped(self.fields[column])} is no time in seconds")
        return time_ns

    def numbers(self, first: int) -> list[float]:
        """The columns from ``first`` on. Raises RecordingError for what is no finite number."""
        return [self._number(field) for field in self.fields[first:]]

    def _number(self, field: str) -> float:
        try:
            number = float(field)
        except ValueError:
            raise self.error(f"{quote_clipped(field)} is no number") from None
        # NaN compares false.
        if not abs(number) <= _LARGEST:
            raise self.error(f"{quote_clipped(field)} is not between -1e9 and 1e9")
        return number

    def error(self, problem: str) -> RecordingError:
        """What is wrong with this line, and what it should be."""
        return RecordingError(
            f"line {self.number}: {problem}.",
            file=self.file,
            advice=f"Each line holds {self.columns}.",
        )


def read_numeric_lines(file: Path, columns: str) -> Iterator[NumericLine]:
    """The lines of a file that are neither empty nor comments.

    Raises RecordingError for a line without a field for each of ``columns``, for what is no text,
    and for a file without lines; OSError where the file cannot be read, is no regular file or is
    larger than 1 GiB.
    """
    count = len(columns.split())
    empty = True
    with open_regular(file, _MAX_BYTES) as stream:
        lines = iter(partial(stream.readline, _MAX_LINE_BYTES), b"")
        for number, text in enumerate(lines, start=1):
            line = NumericLine(file, number, columns, _split_fields(text))
            if not line.fields or line.fields[0].startswith("#"):
                continue
            if len(line.fields) != count:
                raise line.error(f"has {len(line.fields)} fields, not {count}")
            empty = False
            yield line
    if empty:
        raise RecordingError("holds no lines.", file=file, advice=f"Each line holds {columns}.")


def _split_fields(text: bytes) -> list[str]:
    # Undecodable bytes become a field that is no number, which raises an error.
    return text.decode(errors="replace").split()
