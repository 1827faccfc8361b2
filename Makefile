# Every target prepares .venv by itself. Another interpreter: make test PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
# pip says nothing for as long as it takes.
INSTALLING := Installing into $(VENV); the first time this takes a minute or two
CORE := $(VENV)/.installed-core
DEV := $(VENV)/.installed-dev

# Tests start many processes, and each would compile the package's bytecode again.
unexport PYTHONDONTWRITEBYTECODE

# `train` never writes into a used folder, so every `make swim` gets a new one.
RUN := runs/swim-$(shell date +%Y%m%d-%H%M%S)

.DEFAULT_GOAL := help
.PHONY: help swim test test-all test-slow test-shapes test-rounding test-jax test-mutants test-wheel test-matrix traces check bench docs format clean
.DELETE_ON_ERROR:

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' Makefile

swim: $(CORE) ## evolve the swimmer of Iwadate 2010 and film its story (RUN=folder)
	$(BIN)/evo-cpg train configs/iwadate2010_swimmer.yaml --out $(RUN)
	$(BIN)/evo-cpg render $(RUN) --story --size 1280x720

test: $(DEV) ## run the fast tests
	$(BIN)/pytest

test-all: test-slow test-shapes test-jax ## run everything: fast and slow, shapes, and plain JAX; long

test-slow: $(DEV) ## run the fast and the slow tests, all compiled as for users
	EVO_CPG_TESTS_OPTIMISED=3 $(BIN)/pytest -m "slow or not slow"

test-shapes: $(DEV) ## run the fast tests with the shapes of all arrays checked
	EVO_CPG_TESTS_SHAPES=1 $(BIN)/pytest

test-mutants: $(DEV) ## put mistakes into the code, one at a time, and see whether the tests notice
	$(BIN)/python benchmarks/mutants.py

test-rounding: $(DEV) ## run the fast tests seven times, each with another rounding; about 40 minutes
	$(BIN)/python benchmarks/rounding.py

test-jax: $(DEV) ## physics, oscillators and their derivatives on plain JAX, without native code
	$(BIN)/pytest --engine=jax tests/creature/algebra tests/physics tests/control

test-wheel: $(DEV) ## build and install the wheel in an empty environment, and go through the commands there
	$(BIN)/pytest -m "slow or not slow" --numprocesses=0 tests/package

traces: $(DEV) ## record the reference motions of all animals anew, and print which animals moved
	$(BIN)/python benchmarks/traces.py

test-matrix: ## run the tests on all interpreters, oldest and newest dependencies (PYTHONS=..., PYTEST=...)
	$(PYTHON) benchmarks/matrix.py --pytest='$(PYTEST)' build/matrix $(PYTHONS)

check: $(DEV) docs ## format, lint, types, layers, language, size and docs, as CI does
	$(BIN)/ruff format --check .
	$(BIN)/ruff check --no-cache .  # cached import sorting misses modules that came later
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/python docs/tools/language.py
	$(BIN)/python docs/tools/budget.py

bench: $(DEV) ## run the benchmark suite
	$(BIN)/python -m benchmarks

docs: $(DEV) ## build the documentation into docs/_build/html
	$(BIN)/python docs/tools/generate.py --check
	$(BIN)/sphinx-build --quiet --fresh-env --fail-on-warning --keep-going -b html docs docs/_build/html
	@echo docs/_build/html/index.html

format: $(DEV) ## format the code, mend what ruff can, and write the generated pages
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/python docs/tools/generate.py

clean: ## remove environments, builds and caches; runs/ stays
	rm -rf $(VENV) build dist docs/_build .hypothesis .import_linter_cache .pytest_cache .ruff_cache

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(CORE): pyproject.toml constraints.txt | $(BIN)/python
	@echo "$(INSTALLING)"
	$(PIP) -e .
	touch $@

$(DEV): pyproject.toml constraints.txt | $(BIN)/python
	@echo "$(INSTALLING)"
	$(PIP) -e '.[dev,docs]'
	touch $(CORE) $@
