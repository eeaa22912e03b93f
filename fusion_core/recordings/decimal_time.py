"""Times written as decimal seconds, to nanoseconds without a float in between."""

from decimal import Decimal, InvalidOperation

from fusion_core.model.conventions import NS_PER_S

# The text of a time is never longer; parsing millions of digits would take long.
_MAX_DIGITS = 40
# int64 holds fewer nanoseconds; a larger exponent would take memory before that shows.
_END_S = 10_000_000_000
_END_NS = 1 << 63


def ns_from_decimal_seconds(text: str) -> int | None:
    """Nanoseconds of "1305031102.175304" or "1.305e9", rounded to the nearest.

    None for what is no number, is negative, or does not fit into int64.
    """
    if len(text) > _MAX_DIGITS:
        return None
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        return None
    if not seconds.is_finite() or not 0 <= seconds < _END_S:
        return None
    ns = round(seconds * NS_PER_S)
    return ns if ns < _END_NS else None
