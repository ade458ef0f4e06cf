# Everything lives in .venv. `make run` and `make test` set it up by themselves.
PYTHON ?= python3
WORKERS ?= $(shell nproc 2>/dev/null || echo 2)
OUT ?= runs/first_light

BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
PROJECTS := $(wildcard pyproject.toml plugins/*/pyproject.toml)
PLUGINS := $(patsubst %/pyproject.toml,%,$(wildcard plugins/*/pyproject.toml))

.PHONY: help install run test slow lint format docs dist clean
.DEFAULT_GOAL := help

help:  ## show this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /\1\t/' | expand -t 12

install: .venv/run.stamp  ## set up .venv with avrare and its plugins (no torch)

run: .venv/run.stamp  ## estimate how likely the lane change breaks its rules, and one that takes many drives by Monte Carlo
	$(BIN)/avrare run scenarios/lane_change.yaml scenarios/lane_change_rare.yaml \
		--workers $(WORKERS) --out $(OUT)
	@echo 'see it: $(BIN)/avrare report $(OUT)/lane_change --open'

test: .venv/test.stamp  ## run the tests of the core and of every plugin, but for the slow ones
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

slow: .venv/test.stamp  ## run the slow tests: statistics over many seeds, fits, whole commands
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m slow

lint: .venv/test.stamp  ## style, types and layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: .venv/test.stamp  ## mend what can be mended
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: .venv/test.stamp  ## build the documentation site in build/docs
	$(BIN)/mkdocs build --strict

dist: .venv/run.stamp  ## build the wheels of avrare and of its plugins in dist/
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist . $(PLUGINS:%=./%)
	@ls dist

clean:  ## remove .venv and what the tools left
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache

.venv/python.stamp:
	@$(PYTHON) -c 'import sys; sys.exit("avrare needs Python 3.11 or newer, this is " + sys.version.split()[0] + "; try make PYTHON=python3.12") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv .venv
	$(PIP) hatchling editables
	@touch $@

.venv/run.stamp: .venv/python.stamp $(PROJECTS) constraints.txt
	@echo "installing avrare and its plugins into .venv ..."
	$(PIP) --no-build-isolation --editable '.[plot]' $(addprefix --editable ./,$(PLUGINS)) \
		--editable './plugins/avrare-mpc[fast]'
	@touch $@

.venv/test.stamp: .venv/run.stamp
	@echo "installing what the tests need (torch among it: this takes a few minutes) ..."
	$(PIP) 'torch==2.13.0'
	$(PIP) --no-build-isolation --editable '.[plot,test,lint,docs]' --editable './plugins/avrare-pem-training[train]' \
		--editable './plugins/avrare-fmi[test]' --editable './plugins/avrare-imm[test]' --editable './plugins/avrare-gymnasium[box2d]' \
		--editable './plugins/avrare-highway-env[render]' --editable './plugins/avrare-policy[onnx]' \
		--editable './plugins/avrare-ray[ray]' --editable './plugins/avrare-recordings[commonroad,mcap]'
	@touch $@
