"""Numbers as text: with the digits that a standard deviation leaves, and with what they count."""

import math


def with_deviation(value: float, sd: float) -> tuple[str, str]:
    """``value`` and its standard deviation ``sd`` >= 0 as text, both to the second significant
    digit of the deviation: it is never shown as nothing, nor the value finer than it is known.

    A deviation of 0 is a value that is taken as exact; it is shown to four digits. Raises
    ValueError where one of the two is not finite, or ``sd`` is negative.
    """
    if not math.isfinite(value) or not 0.0 <= sd < math.inf:
        raise ValueError(f"need a finite number and a deviation from 0 on, got {value}, {sd}")
    if sd == 0.0:
        return f"{value:z.4g}", "0"
    # The exponent as rounded: 0.0996 is 0.10, not 0.100.
    exponent = int(f"{sd:.1e}".partition("e")[2])
    decimals = max(0, 1 - exponent)
    return f"{value:z.{decimals}f}", f"{sd:.{decimals}f}"


def counted(number: int, what: str) -> str:
    """A number of things, in words that agree with it; ``what``: one of them."""
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"
