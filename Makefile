# Everything needs only Python >= 3.10 with venv; no compiler, no LLVM.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out
# processes that share the tests; each keeps to one core (tests/conftest.py) and takes about 1 GB
JOBS ?= auto
BIN = $(VENV)/bin
PIP = $(BIN)/pip --disable-pip-version-check --quiet

.PHONY: demo test test-slow benchmarks validation docs clean

demo: $(VENV)/.run
	$(BIN)/python -m sarmitsuba render urban_block -o $(OUT)/urban_block --force
	@echo "The picture is $(OUT)/urban_block/quicklook.png"

test: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@if $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then echo $(BIN)/mypy; $(BIN)/mypy; \
	else echo "mypy left out: the last NumPy for this Python has older type stubs"; fi
	$(BIN)/python -m pytest -m "not slow" -n $(JOBS) --maxprocesses 8 --dist worksteal

test-slow: $(VENV)/.test
	$(BIN)/python -m pytest -m slow

# docs/benchmarks.md; a quarter of an hour on two idle cores
benchmarks: $(VENV)/.test
	$(BIN)/python benchmarks/run_all.py

# docs/validation.md and its plots; fails when a comparison is out of tolerance
validation: $(VENV)/.run
	$(BIN)/python -m sarmitsuba validate -o docs

# the documentation site; a warning is an error
docs: $(VENV)/.test
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs $(OUT)/site
	@echo "The site is $(OUT)/site/index.html"

clean:
	rm -rf $(VENV) $(OUT) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.made:
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.run: $(VENV)/.made pyproject.toml
	$(PIP) install -e .
	touch $@

$(VENV)/.test: $(VENV)/.made pyproject.toml
	$(PIP) install -e ".[test]"
	touch $@ $(VENV)/.run
