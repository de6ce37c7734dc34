# Everything needs only Python >= 3.10 with venv; no compiler, no LLVM.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out
# processes that share the tests; each keeps to one core (tests/conftest.py) and takes about 1 GB
JOBS ?= auto
SHARED = -n $(JOBS) --maxprocesses 8 --dist worksteal
BIN = $(VENV)/bin
PIP = $(BIN)/pip --disable-pip-version-check --quiet

# the modules that a process has compiled serve the next one: tests start many
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-slow test-lowest test-highest golden benchmarks validation pages docs release clean

demo: $(VENV)/.run
	$(BIN)/python -m sarmitsuba render urban_block -o $(OUT)/urban_block --labels --force
	@echo "The pictures are $(OUT)/urban_block/quicklook.png and labels.png"

test: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@if $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then echo $(BIN)/mypy; $(BIN)/mypy; \
	else echo "mypy left out: the last NumPy for this Python has older type stubs"; fi
	$(BIN)/python -m pytest -m "not slow" $(SHARED)

test-slow: $(VENV)/.test
	$(BIN)/python -m pytest -m slow $(SHARED)

# files, meshes, pictures and focusing, with the lowest and the highest versions that pyproject.toml allows
VERSIONS = tests/scene/test_meshes.py tests/loading/test_mesh_scenes.py tests/files/test_io_files.py \
	tests/loading/test_scene_loader.py tests/scene/test_surface_maps.py tests/view/test_view.py \
	tests/signal/test_focus_windows.py tests/signal/test_metrics.py tests/signal/test_gridding.py \
	tests/signal/test_point_target_focus.py
test-lowest:
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/pip --disable-pip-version-check --quiet install -e . -c tests/lowest.txt \
		pytest pytest-xdist hypothesis miepython
	.venv-lowest/bin/python -m pytest -m "not slow" -W default::DeprecationWarning -n $(JOBS) $(VERSIONS)

test-highest:
	$(PYTHON) -m venv .venv-highest
	.venv-highest/bin/pip --disable-pip-version-check --quiet install --upgrade --upgrade-strategy eager -e . \
		pytest pytest-xdist hypothesis miepython
	.venv-highest/bin/pip --disable-pip-version-check list
	.venv-highest/bin/python -m pytest -m "not slow" -W default::DeprecationWarning -n $(JOBS) $(VERSIONS)

# forty small runs by the commit BASE and by this tree, bit by bit: for every change of structure
BASE ?= HEAD
golden: $(VENV)/.test
	$(BIN)/python benchmarks/studies/golden.py against $(BASE) $(if $(ALLOW),--allow $(ALLOW))

# pages that `make docs` then shows, in docs/generated: every benchmark, a quarter of an hour on two idle cores
benchmarks: $(VENV)/.test
	$(BIN)/python -m benchmarks.run_all

# every case against theory, with its plot; fails when a comparison is out of tolerance
validation: $(VENV)/.run
	$(BIN)/python -m sarmitsuba validate -o docs/generated --force

# those two and the studies that have a page: hours
pages: benchmarks validation
	for study in combinations derivative_combinations numerics effects diffuse_pairs; do \
	$(BIN)/python -m benchmarks.studies.$$study --page || exit 1; done

# the documentation site, with the generated pages that are there; a warning is an error
docs: $(VENV)/.test
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs $(OUT)/site
	@echo "The site is $(OUT)/site/index.html"

# wheel, source package and lock file (versions and hashes) of the last commit in dist/, each package installed by the
# lock and tried as a plain user without a network;
# CUT=1 measures the generated pages, packs the site and then writes the release into CHANGELOG.md and CITATION.cff
release: $(VENV)/.test $(if $(CUT),pages docs)
	$(BIN)/python tools/release.py --python $(PYTHON) $(if $(CUT),--cut --site $(OUT)/site)

clean:
	rm -rf $(VENV) .venv-lowest .venv-highest $(OUT) docs/generated .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist
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
