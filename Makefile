# Everything sets itself up: a virtual environment in .venv, made anew when pyproject.toml changes.
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.stamp

# A Python that can make virtual environments; set PYTHON=... to choose another.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3.14 python3 python; do \
	$$p -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& echo $$p && break; done)

.PHONY: help demo test test-receiver test-others test-kernels check lint types floors bench bench-peers sim-peers docs clean

help:
	@echo "make demo   simulate 90 s through a city, process them with and without aiding: demo/out"
	@echo "make test   all tests but the slow ones"
	@echo "make check  lint, format, types, import floors"
	@echo "make bench  speed of the correlator and of a whole run"
	@echo "make bench-peers   GNSS-SDR (where installed) and deepgnss on one recording"
	@echo "make sim-peers     RTKLIB and GNSS-SDR (where installed) on what the simulator makes"
	@echo "make docs   docs/config.md and docs/scenario.md from their schemas"

$(STAMP): pyproject.toml
	@test -n "$(PYTHON)" || { echo "deepgnss needs Python 3.11 or newer with its venv module\
	 (Debian, Ubuntu: apt install python3-venv); set PYTHON=/path/to/python3.x" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(STAMP)
	$(BIN)/deepgnss simulate urban_short --output demo
	$(BIN)/deepgnss process demo/rec_L1.bin --config demo/config.yaml --both

# Two test runs side by side, a half of the folders each; kernels also run as plain Python and with
# every index checked (a cache of their own: numba does not tell such code from the usual one).
test: $(STAMP)
	+$(MAKE) --jobs=2 --keep-going --output-sync=target test-receiver test-others test-kernels

test-receiver: $(STAMP)
	$(BIN)/pytest -m "not slow" tests/receiver tests/ins tests/core

test-others: $(STAMP)
	$(BIN)/pytest -m "not slow" --ignore tests/receiver --ignore tests/ins --ignore tests/core

test-kernels: $(STAMP)
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest -q -m "kernel and not slow"
	NUMBA_BOUNDSCHECK=1 XDG_CACHE_HOME=$(CURDIR)/$(VENV)/bounds-checked \
		$(BIN)/pytest -q -m "kernel and not slow"

check: lint types floors

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	cd src && ../$(BIN)/mypy -p deepgnss

floors: $(STAMP)
	$(BIN)/lint-imports

bench: $(STAMP)
	@for script in benchmarks/bench_*.py; do $(BIN)/python $$script || exit 1; done

# On another recording: make bench-peers PEERS="rec.bin --config car.yaml --ranges ranges.csv"
bench-peers: PLACE := demo/peers
bench-peers: PEERS ?= $(PLACE)/rec.bin --config $(PLACE)/config.yaml --ranges $(PLACE)/ranges.csv \
	--set output.interval=0.1
bench-peers: $(STAMP)
	test -n "$(filter-out $(PLACE)/%,$(firstword $(PEERS)))" || test -f $(PLACE)/rec.bin \
		|| $(BIN)/deepgnss simulate open_sky --seconds 60 --output $(PLACE) \
			--set "satellites={systems: [GPS], mask: 10, limit: 9}" \
			--set "streams=[{format: bits2, sample_rate: 4e6}]"
	$(BIN)/python benchmarks/side_by_side.py $(PEERS)

sim-peers: $(STAMP)
	$(BIN)/python benchmarks/simulator_peers.py

docs: $(STAMP)
	$(BIN)/deepgnss config --reference > docs/config.md
	$(BIN)/deepgnss simulate --reference > docs/scenario.md

clean:
	rm -rf $(VENV) demo .pytest_cache .mypy_cache .ruff_cache .hypothesis
