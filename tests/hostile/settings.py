"""Settings files whose numbers Python or the work cannot take."""

from pathlib import Path

NUMBERS = {
    "largest": "1e308",
    "lowest": "-1e308",
    "far": "-1e7",
    "thousands of digits": "9" * 4_000,
    "too many digits": "9" * 10_000,
    "too many hexadecimal digits": "0x" + "f" * 10_000,
}


def write_number(path: Path, number: str) -> Path:
    """``mount.delta_z_min_m`` is ``number``, one of NUMBERS' values."""
    path.write_text(f"[mount]\ndelta_z_min_m = {number}\n", encoding="utf-8")
    return path


def write_swapped_ends(path: Path) -> Path:
    """A range whose low end lies above its high end, which is the default."""
    return write_number(path, "2.0")


def write_wide_search(path: Path) -> Path:
    """Each within its bounds, and together hours of work for ``map``."""
    path.write_text("[loops]\nwindow_max_m = 100.0\n[submaps]\nresolution_m = 0.01\n", "utf-8")
    return path


def write_nested_key(path: Path) -> Path:
    """A key of thousands of parts."""
    path.write_text("[mount]\nx" + ".a" * 5_000 + " = 1\n", "utf-8")
    return path
