# `make demo` and `make test` do all the set-up that they need; a second call reuses it.

VENV := .venv
PYTHON := $(VENV)/bin/python
READY := $(VENV)/.ready
READY_FOR_TESTS := $(VENV)/.ready-for-tests

# Each of some hundred processes of the tests would compile the sources anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all lint types pytest clean

demo: $(READY)
	@$(VENV)/bin/scanloom view

# What is slow, and more examples of each property, are left to test-all.
test: PYTEST := -m "not slow"
test-all: PYTEST := --hypothesis-profile=thorough
# The type checker uses one core: it runs beside the tests, not before them.
MAKEFLAGS += --jobs=2
test test-all: types pytest

lint: $(READY_FOR_TESTS)
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

types: lint
	$(PYTHON) -m mypy

# One more than a small machine has cores: the process with the tests in a browser mostly waits.
pytest: lint
	$(PYTHON) -m pytest -n 3 --dist loadfile $(PYTEST)

$(READY): pyproject.toml .ci/setup
	bash .ci/setup $(VENV)
	@touch $@

$(READY_FOR_TESTS): pyproject.toml .ci/setup
	bash .ci/setup $(VENV) tests
	@touch $(READY) $@

clean:
	rm -rf $(VENV) out build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .benchmarks
	find app fusion_core tests -name __pycache__ -type d -prune -exec rm -rf {} +
