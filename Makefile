# Two commands do everything on a fresh machine: `make demo` and `make test`; `make help` lists all.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
ROS ?= jazzy

TASK ?= herding
ifeq ($(TASK),herding)
SHEEP ?= 100
FLOCK ?= strombom
endif
CONTROLLER ?= policy
SHEPHERDS ?= 3
PRESET ?= default
SEED ?= 0
STEPS ?= 1000
OUT ?= out/demo
PORT ?= 8080

.PHONY: help demo console test test-system setup generate docs lint train paper table beyond bench bench-learning clean browser
.DEFAULT_GOAL := demo

demo: $(VENV)/.demo  # a learned policy herds 100 sheep; pictures in out/demo/
	$(BIN)/shepherd demo --task $(TASK) --controller $(CONTROLLER) --shepherds $(SHEPHERDS) \
	  $(if $(SHEEP),--sheep $(SHEEP)) $(if $(FLOCK),--flock $(FLOCK)) --preset $(PRESET) --seed $(SEED) --steps $(STEPS) --out $(OUT)

console: $(VENV)/.demo  # everything runs until Ctrl-C, with a page in the browser to show and drive it
	$(BIN)/shepherd console --controller $(CONTROLLER) --sheep $(SHEEP) --shepherds $(SHEPHERDS) \
	  --flock $(FLOCK) --preset $(PRESET) --seed $(SEED) --steps $(STEPS) --port $(PORT)

# Three workers also on two cores, as tests of nodes wait; what one compiles serves all.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest -n 3 --dist loadgroup

test: setup browser  # all tests but those of whole systems
	$(PYTEST) -m 'not system'

test-system: setup browser  # builds, commands of the manual, pages in a browser, searches, trainings, signals
	$(PYTEST) -m system

help:  # this list
	@sed -n 's/^\([a-z-]*\):[^#]*  # /\1: /p' $(MAKEFILE_LIST)

setup: $(VENV)/.installed  # the environment with all that tests and other targets need

# Packages are compiled by all cores at the end, not one after another, without what nothing here imports.
# torch without GPU libraries, which take gigabytes; where it cannot be reached, that of PyPI
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
REACHED = $(BIN)/python -c "from urllib.request import urlopen as u; u('$(TORCH_INDEX)', timeout=5)"
INSTALL = if $(REACHED) 2>/dev/null; then export PIP_EXTRA_INDEX_URL=$(TORCH_INDEX); fi; \
  $(BIN)/python -m pip install --no-compile --constraint constraints.txt --editable
COMPILE = $(BIN)/python -m compileall -q -j 0 -x '/(tests?|pip|sympy)/' $(VENV)/lib >/dev/null || true

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo: setup.py package.xml constraints.txt | $(BIN)/python
	@echo 'make: what the demo needs goes into $(VENV): 0.5 GB to download, 2 GB on disk'
	@$(INSTALL) '.[$(ROS),fast]' && { $(COMPILE); }
	@touch $@

$(VENV)/.installed: setup.py package.xml constraints.txt | $(BIN)/python
	@echo 'make: what tests need goes into $(VENV): 0.7 GB to download, 2.5 GB on disk'
	@$(INSTALL) '.[$(ROS),fast,envs,docs,dev]' && { $(COMPILE); }
	@touch $@ $(VENV)/.demo

browser:  # Chromium, in which the tests look at pages, and Node.js, with which they decode
	@if ! { { command -v chromium || command -v chromium-browser || command -v google-chrome; } && \
	    command -v chromedriver && command -v node && command -v npm; } >/dev/null; then \
	  as=; [ "$$(id -u)" = 0 ] || as=sudo; \
	  { $$as apt-get update -q && \
	    $$as apt-get install -q -y --no-install-recommends chromium chromium-driver nodejs npm; } || \
	    { echo 'make browser: apt-get cannot install Chromium and Node.js here; put chromium,' \
	      'chromedriver, node and npm on PATH' >&2; exit 1; }; \
	fi

generate: setup  # every committed file that follows from code: schemas, parameters, cards, reference
	$(BIN)/python scripts/generate.py

lint: setup  # ruff, import-linter, mypy, codespell
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/lint-imports --no-cache && \
	  $(BIN)/mypy && $(BIN)/codespell

# The policy `general` from nothing: PPO from scratch learns to drive; DAgger teaches two modes, to
# drive as that policy and to hold as drover; PPO makes it faster; DAgger again, with more small
# teams and noise, then with goals of all sizes that move. A training that was interrupted goes on,
# and rows that are there stay.
TRAINED ?= out/train
SAMPLES ?= 5000000
ROUNDS ?= 90
FINE_SAMPLES ?= 400000
SMALL_TEAM_ROUNDS ?= 24
LAST_ROUNDS ?= 28
DRIVES := $(TRAINED)/drives/best.safetensors
HOLDS := $(TRAINED)/holds/best.safetensors
FAST := $(TRAINED)/fast/best.safetensors
SMALL_TEAMS := $(TRAINED)/small_teams/best.safetensors
SMALL := --policy.observation.layout ring --policy.network.padding circular \
  --policy.network.filters-1 16 --policy.network.filters-2 32 --policy.network.hidden 128
WORLDS := --sheep-min 10 --repulsion-min 0.5 --repulsion-max 4 --noise-max 2 \
  --noise-free-share 0.4 --home-distance-max 9
JUDGED := --eval-steps 500 --return-weight 0 --goal-weight 2 --path-weight 0.2

train: setup  # the policy `general` from nothing: hours on one core; out/train/
	$(BIN)/shepherd train ppo $(SMALL) --actor-learning-rate 2.5e-4 --critic-learning-rate 6e-4 \
	  --samples $(SAMPLES) --goal-radius-max 6 --home-share 0.35 --seed 2 --out $(TRAINED)/drives
	$(BIN)/shepherd train dagger --pretrained $(DRIVES) --policy.decision-interval 0.5 \
	  --policy.network.modes 2 --policy.sample-std 0.08 --teacher composite:policy:$(DRIVES),drover \
	  --rounds $(ROUNDS) --teacher-rounds 4 $(WORLDS) --sheep-max 200 --team-exponent 1 \
	  --example-team-exponent 1 --home-share 0.2 --episode-steps 260 --clip-speed 1 \
	  --buffer-size 120000 --eval-episodes 36 --eval-steps 500 --eval-noise 1.5 \
	  --out $(TRAINED)/holds
	$(BIN)/shepherd train ppo --pretrained $(HOLDS) --new-critic --critic-warmup 8 \
	  --critic-input state --learn-share 0.5 --update-epochs 2 --policy.network.min-std 0.1 \
	  --policy.network.max-std 0.12 --actor-learning-rate 5e-5 $(WORLDS) --sheep-max 200 \
	  --team-exponent 1 --home-share 0.35 --episode-steps 260 --effort 0.002 --effort-from home \
	  --teacher composite:idle,drover --label-weight 5 --groups 8 --worlds 12 \
	  --samples $(FINE_SAMPLES) --eval-freq 25 --eval-episodes 36 --eval-noise 1.5 \
	  --eval-sheep 100,200 --eval-shepherds 1,3,6 $(JUDGED) --time-weight 2 --out $(TRAINED)/fast
	$(BIN)/shepherd train dagger --pretrained $(FAST) --teacher composite:policy:$(FAST),drover \
	  --rounds $(SMALL_TEAM_ROUNDS) --teacher-rounds 1 --example-interval 2 --learning-rate 2e-4 \
	  $(WORLDS) --sheep-max 250 --team-exponent 1.5 --example-team-exponent 0.5 --home-share 0.4 \
	  --episode-steps 320 --clip-speed 1 --buffer-size 120000 --eval-freq 4 --eval-episodes 24 \
	  --eval-noise 1.7 --eval-sheep 100 --eval-shepherds 1,3 --eval-sample-std 0.08 $(JUDGED) \
	  --time-weight 1 --out $(TRAINED)/small_teams
	$(BIN)/shepherd train dagger --pretrained $(SMALL_TEAMS) \
	  --teacher composite:policy:$(SMALL_TEAMS),drover,0.85,1.15 --teacher-goal-max 6 \
	  --policy.observation.range-min 1.5 --rounds $(LAST_ROUNDS) --teacher-rounds 1 \
	  --example-interval 2 --learning-rate 2e-4 $(WORLDS) --sheep-max 300 --goal-radius-min 3 \
	  --goal-speed-max 0.2 --goal-still-share 0.7 --team-exponent 1.5 \
	  --example-team-exponent 0.5 --home-share 0.4 --episode-steps 320 --clip-speed 1 \
	  --buffer-size 120000 --eval-freq 4 --eval-episodes 16 --eval-noise 1.7 --eval-sheep 100 \
	  --eval-shepherds 1,6 --eval-sample-std 0.08 $(JUDGED) --eval-steps 400 --time-weight 1 \
	  --out $(TRAINED)/general
	$(BIN)/shepherd evaluate table --sheep 100 --shepherds 1 3 6 --episodes 32 --workers 2 \
	  --controllers policy:$(TRAINED)/general/best.safetensors pierson strombom --out $(TRAINED)/rows

# What the paper shows, with intervals and a verdict on each of its statements, in out/paper/:
# in PRESET, or several, the first one drawn. An interrupted run goes on where it was. Seeds from
# 3000 on were used by no search. QUICK=1: where the statements look, 50 episodes, in out/quick/.
WORKERS ?= 2
CURVES ?= docs/curves
paper: PRESET := $(if $(QUICK),third,third default table_literal)
SHIPPED = $(patsubst checkpoints/%.safetensors,policy:%,$(wildcard checkpoints/$(1)_*.safetensors))
PRIMARY_third := $(call SHIPPED,third)
PRIMARY_default := policy:paper_network policy:reynolds
PRIMARY_table_literal := $(PRIMARY_default)
ifdef QUICK
PAPER := out/quick
SHORT := --quick
else
PAPER := out/paper
SHORT := --stop-early
endif

# One preset: its primary policies, if there are any, and the baselines.
define evaluate_preset
$(BIN)/shepherd evaluate paper $(SHORT) --preset $(1) --seed 3000 --workers $(WORKERS) \
  --controllers strombom pierson $(if $(PRIMARY_$(1)),policy --primary $(PRIMARY_$(1))) \
  --out $(PAPER)/rows

endef

paper: setup  # all statements of the paper: hours; out/paper/results/README.md
	$(foreach preset,$(PRESET),$(call evaluate_preset,$(preset)))
	$(BIN)/shepherd figures $(PAPER)/rows --presets $(PRESET) --report --curves $(CURVES) \
	  --out $(PAPER)/results --command 'make paper$(if $(QUICK), QUICK=1)'

POLICIES ?= policy:strombom policy:paper_network policy:reynolds policy:imitation policy:general
beyond: setup  # sweeps that the paper does not have, all controllers: many hours; out/rows/
	$(BIN)/shepherd evaluate beyond --workers $(WORKERS) --policies $(POLICIES) --out out/rows

table: setup  # teams and flocks, all controllers: hours; out/rows/table.md
	$(BIN)/shepherd evaluate table --workers $(WORKERS) --policies $(POLICIES) --out out/rows

bench: setup  # all of them, about half an hour on cores of its own; out/bench/
	$(BIN)/pip install -q -c constraints.txt --editable '.[bench]' && $(BIN)/python benchmarks/run_all.py

bench-learning: setup  # about five minutes on cores of its own
	$(BIN)/python benchmarks/learning.py

docs: setup  # the manual; out/docs/index.html
	$(BIN)/python -m sphinx -q -W --keep-going docs out/docs

clean:
	rm -rf $(VENV) out build dist install log
