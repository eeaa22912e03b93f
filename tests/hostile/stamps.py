"""Recordings whose sensors' clocks jump, while their log has every message in its place."""

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from tests.hostile.drive import SCAN, SCANS, START_NS, STEP_MS, restamped, write_drive

YEAR_NS = 365 * 24 * 3600 * NS_PER_S


def one_ahead(path, *, topic=SCAN, number=2, ahead_ns=YEAR_NS, **drive):
    """One message of ``topic`` is stamped ``ahead_ns`` after its time (or before, if negative)."""

    def change(name, place, value):
        if (name, place) != (topic, number):
            return value
        return restamped(value, START_NS + number * STEP_MS * NS_PER_MS + ahead_ns)

    return write_drive(path, change, **drive)


def backwards(path, *, topic=SCAN, **drive):
    """The stamps of ``topic`` run backwards from first to last."""

    def change(name, place, value):
        if name != topic:
            return value
        return restamped(value, START_NS + (SCANS - 1 - place) * STEP_MS * NS_PER_MS)

    return write_drive(path, change, **drive)
