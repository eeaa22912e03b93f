"""Settings come in links and files of strangers: every number is bounded on both sides."""

import importlib
import math
import pkgutil
import types
import typing
from collections.abc import Iterator

import pytest
from pydantic import ValidationError
from pydantic.fields import FieldInfo

import fusion_core
import scanloom
from fusion_core.registration.pl_icp import PlIcpSettings
from fusion_core.settings import StageSettings, ends, under_current_names
from fusion_core.slam.particle_filter import ParticleSettings
from fusion_core.slam.submaps import SubmapSettings

for package in (fusion_core, scanloom):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)


def subclasses(settings_class: type[StageSettings]) -> Iterator[type[StageSettings]]:
    for subclass in settings_class.__subclasses__():
        yield subclass
        yield from subclasses(subclass)


# Those of the project: other tests declare classes of their own.
CLASSES = sorted(
    {
        c
        for c in subclasses(StageSettings)
        if c.__module__.split(".")[0] in ("scanloom", "fusion_core")
    },
    key=lambda settings_class: (settings_class.__qualname__, settings_class.__module__),
)
of_each_class = pytest.mark.parametrize("settings_class", CLASSES, ids=lambda c: c.__qualname__)


def parts_of(annotation: object) -> list[object]:
    """The types that an annotation is made of; a Literal's choices are none."""
    if typing.get_origin(annotation) is typing.Literal:
        return []
    arguments = [part for part in typing.get_args(annotation) if part is not types.NoneType]
    return [part for one in arguments for part in parts_of(one)] or [annotation]


def bounds_of(field: FieldInfo) -> tuple[list[float], list[float]]:
    found = ([], [])
    for side, names in enumerate((("ge", "gt"), ("le", "lt"))):
        for constraint in field.metadata:
            values = (getattr(constraint, name, None) for name in names)
            found[side].extend(value for value in values if value is not None)
    return found


def test_there_are_settings() -> None:
    assert len(CLASSES) > 25


@of_each_class
def test_a_number_has_two_finite_bounds(settings_class: type[StageSettings]) -> None:
    for name, field in settings_class.model_fields.items():
        for part in parts_of(field.annotation):
            if part in (int, float):
                low, high = bounds_of(field)
                assert len(low) == len(high) == 1, name
                assert math.isfinite(low[0]), name
                assert math.isfinite(high[0]), name
                assert low[0] < high[0], name
            else:
                # Neither text nor a collection without a limit to its length.
                assert part is bool or issubclass(part, StageSettings), name


@of_each_class
def test_the_ends_of_a_range_are_in_order(settings_class: type[StageSettings]) -> None:
    for low, high in ends(settings_class):
        least, most = (bounds_of(settings_class.model_fields[name]) for name in (low, high))
        above, below = most[1][0], least[0][0]
        if least[1][0] <= most[0][0]:
            # Their bounds keep them in order.
            continue
        middle = 0.5 * (max(below, most[0][0]) + min(above, least[1][0]))
        settings_class(**{low: middle - 1e-3, high: middle})
        with pytest.raises(ValidationError, match=f"{low} .*{high}"):
            settings_class(**{low: middle, high: middle - 1e-3})


def test_the_ends_of_a_range_are_found_by_their_names() -> None:
    class Ranges(StageSettings):
        a_min_m: float = 0.0
        a_max_m: float = 1.0
        min_b: float = 0.0
        max_b: float = 1.0
        minute: float = 0.0
        maxute: float = 1.0
        alone_min: float = 5.0

    assert ends(Ranges) == [("a_min_m", "a_max_m"), ("min_b", "max_b")]


@pytest.mark.parametrize(
    ("settings_class", "values", "named"),
    [
        (
            SubmapSettings,
            {"max_range_m": 200.0, "resolution_m": 0.04},
            "max_range_m = 200 over res",
        ),
        (
            ParticleSettings,
            {"max_range_m": 100.0, "resolution_m": 0.02},
            "max_range_m = 100 over res",
        ),
        (
            PlIcpSettings,
            {"search_translation_m": 50.0, "search_step_rad": 0.001},
            "poses to search",
        ),
    ],
)
def test_products_that_make_the_work_are_bounded(
    settings_class: type[StageSettings], values: dict[str, float], named: str
) -> None:
    for name, value in values.items():
        low, high = bounds_of(settings_class.model_fields[name])
        assert low[0] <= value <= high[0]
    with pytest.raises(ValidationError, match=named):
        settings_class(**values)


FORMER_NAMES = [
    (settings_class, name, extra["formerly"])
    for settings_class in CLASSES
    for name, field in settings_class.model_fields.items()
    if isinstance(extra := field.json_schema_extra, dict) and extra.get("formerly")
]


def test_a_former_name_is_read_as_the_present_one() -> None:
    for settings_class, name, former in FORMER_NAMES:
        assert former not in settings_class.model_fields
        assert under_current_names(settings_class, {former: 1}) == ({name: 1}, {former: name})


def test_no_former_name_stands_for_two_settings() -> None:
    pairs = [(settings_class, former) for settings_class, _, former in FORMER_NAMES]
    assert len(set(pairs)) == len(pairs) > 50
