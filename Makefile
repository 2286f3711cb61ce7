# Two commands do everything on a fresh machine: `make study` and `make test`.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out/thesis
# numpy and scipy bring a thread pool each; on small matrices two pools fight.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: study test test-fast test-slow fuzz lint types docs bench clean

study: $(VENV)/installed
	$(BIN)/interarea study thesis --out $(OUT)

# Everything that decides whether a change lands.
test: lint types test-fast test-slow

# Three processes, of which one often waits for a browser, an emulator or a disk, share what is built; a file's tests stay
# together, so that its fixtures are made once. Which slow files come first says tests/conftest.py.
WORKERS ?= 3
test-fast test-slow: export INTERAREA_CACHE ?= $(CURDIR)/build/cache
# Each process, and each command that a test starts, would compile all of Python again, 10 s to collect the tests.
test-fast test-slow: export PYTHONDONTWRITEBYTECODE :=

test-fast: $(VENV)/installed-test
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile --durations=15

test-slow: $(VENV)/installed-test
	$(BIN)/python -m pytest -q -m slow -n $(WORKERS) --dist loadfile --no-loadscope-reorder --durations=15

# An hour of random FMI calls under sanitizers, then foreign FMUs, every injected fault, 500 kills of sweeps; seeds go on from hour to hour.
fuzz: $(VENV)/installed-test
	$(BIN)/python tests/fuzz/run_fuzz.py --minutes 60 --calls 100000000 --seeds out/fuzz/seeds.json
	-$(BIN)/python tests/foreign/fetch.py
	INTERAREA_EVERY_FAULT=1 $(BIN)/python -m pytest -q -m "" tests/foreign tests/faults tests/hostile tests/sweep/test_sweep_kills.py \
	    tests/unit/models/importers/test_import_broken.py tests/explorer/test_page_bits.py tests/fuzz/test_memory.py
	$(BIN)/python tests/sweep/kills.py --kills 500

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# mypy does not see through an editable install, so it checks a wheel's content. What it checked before stays in build/mypy.
types: $(VENV)/installed-test
	rm -rf build/typecheck && mkdir -p build/typecheck
	$(BIN)/pip install --quiet --no-deps --target build/typecheck -C platforms=none .
	cd build/typecheck && ../../$(BIN)/python -m mypy --cache-dir ../mypy --config-file ../../pyproject.toml \
	    -p interarea

# The site, from disk: build/docs/index.html. A warning is an error.
docs: $(VENV)/installed-docs
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs build/docs

# A benchmark that misses what it wants says so with exit code 1; the others still run.
bench: $(VENV)/installed-bench
	-$(BIN)/python benchmarks/bench_cli.py
	-$(BIN)/python benchmarks/control/lmi_engine.py
	-$(BIN)/python benchmarks/control/lmi_engine.py --ftc
	-$(BIN)/python benchmarks/control/unseen_points.py
	-$(BIN)/python benchmarks/bench_master.py
	-$(BIN)/python benchmarks/bench_plant.py
	-$(BIN)/python benchmarks/bench_devices.py
	-$(BIN)/python benchmarks/bench_batch.py --case two-area-thesis --case new-england --scenarios 16
	-$(BIN)/python benchmarks/bench_sweep.py
	-$(BIN)/python benchmarks/bench_pool.py
	-$(BIN)/python benchmarks/bench_export.py --cold
	-$(BIN)/python benchmarks/peers/compare_andes.py
	-$(BIN)/python benchmarks/peers/compare_tops.py
	-$(BIN)/python benchmarks/records/book_readings.py

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip

$(VENV)/installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/pip install --quiet -e ".[build]"
	touch $@

$(VENV)/installed-test: $(VENV)/bin/python pyproject.toml
	$(BIN)/pip install --quiet -e ".[test,cluster,docs]"
	touch $@ $(VENV)/installed

$(VENV)/installed-docs: $(VENV)/bin/python pyproject.toml
	$(BIN)/pip install --quiet -e ".[build,docs]"
	touch $@ $(VENV)/installed

$(VENV)/installed-bench: $(VENV)/installed-test
	$(BIN)/pip install --quiet -e ".[test,cluster,bench]"
	touch $@

clean:
	rm -rf build out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
