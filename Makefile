# Every target sets up what it needs in .venv: `make sweep` works on a fresh clone with only Python 3.11 and make.
SHELL := /bin/bash
PYTHON ?= python3.11
SWEEP ?= default
ARGS ?=
BIN := .venv/bin
# key=value words of the command that are no variables of this file: make would drop them silently.
OWN := PYTHON SWEEP ARGS OUT SHELL
WORDS = $(strip $(foreach name,$(filter-out $(OWN),$(.VARIABLES)),$(if $(filter command,$(origin $(name))),'$(name)=$($(name))')))
# Workers run one thread each (same bytes on any machine); these keep libraries from starting more on import.
export HYDRA_FULL_ERROR := 1

TARGETS := help setup sweep which-sweep retry-quarantined verify report test check bench frontier stress mutants ui train \
  finetune docs evidence wheel pictures clean
# make would run the targets before an unknown word, as in "make sweep smoke".
STRAY := $(filter-out $(TARGETS) .venv/%,$(MAKECMDGOALS))
$(if $(STRAY),$(error unknown: $(STRAY). A sweep is named by SWEEP=NAME, its folder by OUT=FOLDER, options by ARGS="..."; make help lists the targets))

.DEFAULT_GOAL := help
.PHONY: $(TARGETS)

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-18s %s\n", $$1, $$2}'
	@echo '  make sweep SWEEP=kitti ARGS="scenes.root=PATH"   any sweep of sweeps/, any override'

# Two stamps, so that a sweep does not wait for the tools that only developers need.
.venv/.runtime: pyproject.toml constraints.txt
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv || python3 -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

.venv/.dev: .venv/.runtime
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

setup: .venv/.runtime  ## install shift3d and its libraries in .venv

sweep: .venv/.runtime  ## run sweeps/$(SWEEP).yaml; the same command resumes
	$(BIN)/shift3d sweep $(SWEEP) $(ARGS) $(WORDS)

# Before anything is installed.
which-sweep:
	@test -n "$(OUT)" || { echo 'which sweep? make $(MAKECMDGOALS) OUT=outputs/NAME-HASH'; exit 2; }

retry-quarantined: which-sweep .venv/.runtime  ## run a sweep's quarantined tasks again: OUT=outputs/NAME-HASH
	$(BIN)/shift3d sweep $(OUT) $(ARGS) $(WORDS) --retry-quarantined

verify: which-sweep .venv/.runtime  ## score a sweep's solutions again at reference accuracy: OUT=outputs/NAME-HASH
	$(BIN)/shift3d verify $(OUT) $(ARGS) $(WORDS)

report: which-sweep .venv/.runtime  ## write a sweep's report page, report.html: OUT=outputs/NAME-HASH
	$(BIN)/shift3d report $(OUT) $(ARGS)

# A worker takes tests in a row, so that each shared set-up is made once; an idle worker takes tests from the other.
# Without bytecode each of the processes that tests start would compile shift3d itself, and pytest every test.
test: .venv/.dev  ## run every test on two cores; ARGS="-n 0 -k WORD"
	env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

check: .venv/.dev  ## check lint, format, types and layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# A plain pytest collects none of these: they take minutes and need an idle machine.
bench: .venv/.dev  ## measure speed, write outputs/bench.json; ARGS="-k render", --quick, "--against FILE"
	$(BIN)/python -m pytest tests/benchmarks -o python_files='bench_*.py' -o python_functions='bench_*' $(ARGS)

frontier: .venv/.runtime  ## measure accuracy against run time (sweeps/accuracy_time.yaml): 15 minutes; ARGS=--quick: 3
	$(BIN)/shift3d frontier $(ARGS) $(WORDS)

stress: .venv/.dev  ## render 10,000 random extreme poses and codes, account for every unresolved beam
	$(BIN)/python tests/stress/extreme_poses.py --count 10000 --workers 2 $(ARGS)

mutants: .venv/.dev  ## break the code at a seeded sample of places, count breaks that tests notice; ARGS="shift3d/attack"
	$(BIN)/python tests/mutants.py $(ARGS)

ui: .venv/.runtime  ## compare runs in MLflow on loopback
	$(BIN)/shift3d ui $(ARGS)

train: .venv/.runtime  ## train a model: ARGS="model=sdf", pointpillars, centerpoint, sst_small or sst; more: shift3d train --help
	$(BIN)/shift3d train $(ARGS) $(WORDS)

finetune: .venv/.runtime  ## attack, fine-tune on the objects found, measure: ARGS="size=small" takes two hours
	$(BIN)/shift3d finetune $(ARGS) $(WORDS)

docs: .venv/.runtime  ## write docs/reference from the code and the configuration
	$(BIN)/python docs/scripts/reference_pages.py

# Current results are skipped, so that nights add up: ONLY=gate, kitti=PATH, real=PATH; ARGS=--plan gives each time.
evidence: .venv/.dev  ## measure the numbers in README and docs, draw their tables; ARGS=--plan, ONLY=NAME
	$(BIN)/python docs/scripts/evidence $(ARGS) $(WORDS)

# build/ is removed first: setuptools would put files from it into the wheel that the tree has lost.
wheel: .venv/.runtime  ## write to dist/ a wheel and its libraries' versions, for other machines (docs/guides/cluster.md)
	rm -rf build dist
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w dist .
	cp constraints.txt dist/

pictures: .venv/.runtime  ## draw the README's pictures again
	$(BIN)/python docs/scripts/pictures.py $(ARGS)

clean:  ## remove .venv and caches (never outputs/)
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache
