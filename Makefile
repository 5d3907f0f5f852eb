# Every target makes its own virtual environment in .venv by need; only python3 (3.11 or newer) has to be there.
PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed

.PHONY: demo test fast fuzz lint types wheel

demo: $(INSTALLED)
	$(BIN)/python examples/demo.py

test: $(INSTALLED)
	$(BIN)/python -m pytest -rs

fast: $(INSTALLED)
	$(BIN)/python -m pytest -rs -m "not slow"

# All of the damage campaign, about 20 minutes on two cores; FUZZ=--short takes about one.
fuzz: $(INSTALLED)
	$(BIN)/python -m tests.fuzz $(FUZZ)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

wheel: $(INSTALLED)
	rm -rf dist
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable ".[dev]"
	touch $@
