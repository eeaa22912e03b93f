"""The cache holds what was used last, and computes each value once."""

import pytest

from fusion_core.model.bounded_cache import BoundedCache


def test_a_value_is_computed_once_while_it_is_cached() -> None:
    cache: BoundedCache[str, int] = BoundedCache(2)
    computed: list[str] = []

    def value_of(key: str) -> int:
        def compute() -> int:
            computed.append(key)
            return len(computed)

        return cache.get_or_compute(key, compute)

    assert [value_of(key) for key in "aba"] == [1, 2, 1]
    # "b" was used longest ago, so it is dropped.
    assert value_of("c") == 3
    assert value_of("a") == 1
    assert value_of("b") == 4
    assert "".join(computed) == "abcb"
    assert len(cache) == 2


def test_none_is_a_value_and_a_failure_is_not() -> None:
    cache: BoundedCache[int, None] = BoundedCache(1)
    assert cache.get_or_compute(1, lambda: None) is None

    def fail() -> None:
        raise RuntimeError("computed")

    assert cache.get_or_compute(1, fail) is None
    with pytest.raises(RuntimeError, match="computed"):
        cache.get_or_compute(2, fail)
    assert len(cache) == 1


def test_a_capacity_is_needed() -> None:
    with pytest.raises(ValueError, match="capacity"):
        BoundedCache(0)
