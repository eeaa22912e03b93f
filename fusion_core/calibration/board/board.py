"""A checkerboard: its inner corners in an image, and where they are on the board."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import CalibrationFailed, SettingsError

SquareCount = Literal["inner corners", "squares"]
# OpenCV's detectors need three corners a side; more than this is no board that is printed.
_SIDE_MIN, _SIDE_MAX = 3, 100
# A square below is not resolved, one above is no board that is carried about.
_SQUARE_M = (0.002, 1.0)
# The window of the sub-pixel search, as a fraction of the way to the nearest corner: it must hold
# the edges of this corner alone.
_WINDOW_FRACTION = 0.3
_WINDOW_PX = (2, 15)
# The thorough detector takes seconds: where these images show no board, the others will not.
_TRIES = 10
_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A board of ``columns`` x ``rows`` inner corners; ``counted``: what the user's numbers meant.

    Its frame has the origin in the first corner, x along the first row, y along the columns.
    """

    columns: int
    rows: int
    square_m: float
    counted: SquareCount = "inner corners"

    def points_m(self) -> FloatArray:
        """(N, 3) the inner corners, row by row, z = 0."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        return np.stack([column, row, np.zeros_like(row)], axis=1) * self.square_m

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows, as OpenCV's detectors take them."""
        return self.columns, self.rows

    def describe(self) -> str:
        """For people: "7x5 inner corners (8x6 squares)"."""
        squares = f"{self.columns + 1}x{self.rows + 1} squares"
        return f"{self.columns}x{self.rows} inner corners ({squares})"


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardImages:
    """``corners_px``: for each image (N, 2) the corners in the board's order, None without any."""

    board: Board
    corners_px: tuple[FloatArray | None, ...]


def parse_board(text: str, square_m: float) -> Board:
    """A board of the size "7x5", read as inner corners until ``find_boards`` has seen it.

    Raises SettingsError for what is no size, and for squares that are no length in metres.
    """
    found = re.fullmatch(r"\s*(\d{1,3})\s*[xX×]\s*(\d{1,3})\s*", text)
    sides = [int(side) for side in found.groups()] if found else []
    if not sides or not all(_SIDE_MIN <= side <= _SIDE_MAX for side in sides):
        raise SettingsError(
            f"{text[:20]!r} is no size of a checkerboard.",
            advice=f"Give its corners as 7x5, {_SIDE_MIN} to {_SIDE_MAX} a side.",
        )
    least, most = _SQUARE_M
    if not least <= square_m <= most:
        raise SettingsError(
            f"squares of {square_m:g} m are not from {least:g} to {most:g} m a side.",
            advice="Give the side of one square in metres: 105 mm is 0.105.",
        )
    return Board(columns=sides[0], rows=sides[1], square_m=square_m)


def find_boards(images: Sequence[ByteArray], board: Board) -> BoardImages:
    """The corners of ``board`` in grey images (H, W).

    Its size may count inner corners or squares: the reading that the images show is taken. Raises
    CalibrationFailed where they show neither.
    """
    readings = [board]
    if min(board.size) > _SIDE_MIN:
        fewer = (board.columns - 1, board.rows - 1)
        readings.append(
            Board(columns=fewer[0], rows=fewer[1], square_m=board.square_m, counted="squares")
        )
    # The first detector takes no part of a larger board, so that it tells the two apart.
    found = [[_quad_corners(image, board.size) for image in images]]
    if len(readings) > 1 and any(corners is None for corners in found[0]):
        found.append([_quad_corners(image, readings[1].size) for image in images])
    counts = [sum(corners is not None for corners in seen) for seen in found]
    best = int(np.argmax(counts))
    size = readings[best].size if counts[best] else None
    corners_px, other_sizes = list(found[best]), Counter[tuple[int, int]]()
    for index, image in enumerate(images):
        if size is None and index >= _TRIES:
            break
        if corners_px[index] is None:
            seen_size, corners = _saddle_corners(image, board.size)
            reading = next((r for r in readings if _is_size(seen_size, r.size)), None)
            if corners is None or reading is None:
                other_sizes.update([] if seen_size is None else [seen_size])
            elif size in (None, reading.size):
                size = reading.size
                corners_px[index] = _in_order(corners, seen_size, size)
    if size is None:
        raise _not_found(readings, len(images), other_sizes)
    seen_board = next(reading for reading in readings if reading.size == size)
    return BoardImages(board=seen_board, corners_px=tuple(corners_px))


def find_board(image: ByteArray, board: Board, *, is_expected: bool = False) -> FloatArray | None:
    """(N, 2) corners in one grey image of many, such as a video's: by the quick detector, and by
    the thorough one only where the board ``is_expected``."""
    corners = _quad_corners(image, board.size, cv2.CALIB_CB_FAST_CHECK)
    if corners is None and is_expected:
        seen, found = _saddle_corners(image, board.size)
        if found is not None and _is_size(seen, board.size):
            return _in_order(found, seen, board.size)
    return corners


def _quad_corners(image: ByteArray, size: tuple[int, int], flags: int = 0) -> FloatArray | None:
    """By the black squares, then the saddle point of the grey values around each corner."""
    flags |= cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(image, size, flags=flags)
    if not found:
        return None
    grid = corners.reshape(size[1], size[0], 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    half = int(np.clip(_WINDOW_FRACTION * min(steps), *_WINDOW_PX))
    refined = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), _UNTIL)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def _saddle_corners(
    image: ByteArray, size: tuple[int, int]
) -> tuple[tuple[int, int] | None, FloatArray | None]:
    """Columns and rows, and corners, of the board that contains one of ``size``: by saddle points
    (Duda and Frese 2018), which finds blurred boards too."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_LARGER
    found, corners, squares = cv2.findChessboardCornersSBWithMeta(image, size, flags)
    if not found:
        return None, None
    rows, columns = squares.shape[:2]
    return (columns, rows), np.asarray(corners, np.float64).reshape(-1, 2)


def _is_size(seen: tuple[int, int] | None, size: tuple[int, int]) -> bool:
    return seen is not None and sorted(seen) == sorted(size)


def _in_order(
    corners: FloatArray, seen: tuple[int, int] | None, size: tuple[int, int]
) -> FloatArray:
    """Corners that were found as rows x columns, in the order of columns x rows."""
    if seen == size:
        return corners
    columns, rows = size
    # A quarter turn, not a transpose: a mirrored board would be seen from behind.
    turned = np.rot90(corners.reshape(columns, rows, 2))
    return np.ascontiguousarray(turned).reshape(-1, 2)


def _not_found(
    readings: list[Board], images: int, other_sizes: Counter[tuple[int, int]]
) -> CalibrationFailed:
    sizes = " or ".join(reading.describe() for reading in readings)
    if not other_sizes:
        return CalibrationFailed(
            f"no board of {sizes} is seen in any of {images} images.",
            advice="Count the inner corners, and show the board whole and with a white rim.",
        )
    (columns, rows), _ = other_sizes.most_common(1)[0]
    return CalibrationFailed(
        f"the images show a board of {columns}x{rows} inner corners, not one of {sizes}.",
        advice=f"Give --board {max(columns, rows)}x{min(columns, rows)}.",
    )
