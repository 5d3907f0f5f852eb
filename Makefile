# Every target makes its own virtual environment in .venv by need; only python3 (3.11 or newer) has to be there.
PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed

# Processes that share the tests, a module at a time: one for each core; `make test JOBS=0` runs them in this one.
JOBS ?= auto
PYTEST := $(BIN)/python -m pytest -rs -n $(JOBS) --dist loadscope --no-loadscope-reorder --durations=25

.PHONY: coverage demo docs test fast fuzz lint mutants qgis types wheel

demo: $(INSTALLED)
	$(BIN)/python examples/demo.py

test: $(INSTALLED)
	$(PYTEST)

fast: $(INSTALLED)
	$(PYTEST) -m "not slow"

# Lines of the package that the suite runs in its own processes; build/coverage/index.html shows which it does not.
coverage: $(INSTALLED)
	$(PYTEST) --cov --cov-report=term:skip-covered --cov-report=html:build/coverage

# Changes of the program that a test must notice, made one at a time in this very folder and put back.
mutants: $(INSTALLED)
	$(BIN)/python -m tests.mutants

# All of the damage campaign, about 17 minutes on two idle cores; FUZZ=--short takes about one.
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

# The documentation site, in build/site; a link or heading that is not there is an error.
docs: $(INSTALLED)
	$(BIN)/pip install --quiet --editable ".[docs]"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

# The QGIS plugin, to be installed from its ZIP.
qgis:
	mkdir -p build
	rm -rf build/orthoscale_qgis.zip qgis/orthoscale_qgis/__pycache__
	cd qgis && $(PYTHON) -m zipfile -c ../build/orthoscale_qgis.zip orthoscale_qgis

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable ".[dev]"
	touch $@
