# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

CONTROLLER ?= strombom
SHEEP ?= 100
SHEPHERDS ?= 3
FLOCK ?= strombom
PRESET ?= default
SEED ?= 0
STEPS ?= 1000
OUT ?= out/demo

.PHONY: demo test setup lint table bench bench-learning clean browser
.DEFAULT_GOAL := demo

demo: setup
	$(BIN)/shepherd demo --controller $(CONTROLLER) --sheep $(SHEEP) --shepherds $(SHEPHERDS) \
	  --flock $(FLOCK) --preset $(PRESET) --seed $(SEED) --steps $(STEPS) --out $(OUT)

test: setup browser
	$(BIN)/python -m pytest -n 2 --dist loadgroup

setup: $(VENV)/.installed

$(VENV)/.installed: setup.py package.xml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[jazzy,fast,envs,dev]'
	touch $@

browser:  # Chromium, in which the tests look at pages
	@if ! { { command -v chromium || command -v chromium-browser || command -v google-chrome; } && \
	    command -v chromedriver; } >/dev/null; then \
	  as=; [ "$$(id -u)" = 0 ] || as=sudo; \
	  { $$as apt-get update -q && \
	    $$as apt-get install -q -y --no-install-recommends chromium chromium-driver; } || \
	    { echo 'make browser: apt-get cannot install Chromium here; put chromium and' \
	      'chromedriver on PATH' >&2; exit 1; }; \
	fi

lint: setup
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/codespell

table: setup  # the table of heuristics in README.md, about half an hour
	$(BIN)/shepherd evaluate --out out/table.md

bench: setup
	$(BIN)/python benchmarks/core.py && $(BIN)/python benchmarks/ring.py

bench-learning: setup  # about five minutes on cores of its own
	$(BIN)/python benchmarks/learning.py

clean:
	rm -rf $(VENV) out build install log
