"""How long something lasts, with the digits that it deserves."""

_MINUTE_S, _HOUR_S = 60, 3600


def duration_text(duration_s: float) -> str:
    """0.37 s, 42 s, 44 min 32 s, 2 h 5 min."""
    if duration_s < 1.0:
        # "0 s" would say that there is one instant.
        return f"{duration_s:.2f} s" if duration_s > 0.0 else "0 s"
    seconds = round(duration_s)
    if seconds < _MINUTE_S:
        return f"{seconds} s"
    if seconds < _HOUR_S:
        minutes, rest = divmod(seconds, _MINUTE_S)
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, minutes = divmod(round(duration_s / _MINUTE_S), 60)
    return f"{hours:,} h {minutes} min" if minutes else f"{hours:,} h"
