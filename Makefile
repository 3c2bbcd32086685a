# Everything runs in .venv, which `make setup` makes. `make help` lists the targets.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
RESULTS := carosac-results
JOBS ?= 2
PYTEST := $(BIN)/python -m pytest -q -rs -n $(JOBS) --dist loadfile --no-loadscope-reorder

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-slow lint bench bars learning docs docs-commands linkcheck clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## install the toolkit and all it needs into .venv
	@echo "Set-up is complete. The command is $(BIN)/carosac, the interpreter $(BIN)/python."

$(STAMP): pyproject.toml constraints.txt
	@echo "1/3 Making a virtual environment in $(VENV)."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "2/3 Installing the toolkit in place with all its extras, and the tools for tests and"
	@echo "    documentation, at the versions of constraints.txt."
	@echo "    This takes some minutes and about 3 GB of disk."
	@PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install -qq \
		--constraint constraints.txt --editable '.[all,dev,docs]'
	@echo "3/3 Checking that the installed packages fit together."
	@$(BIN)/python -m pip check
	@touch $@

demo: $(STAMP)  ## compare five controllers on one fast move, with an animation and a report
	@$(BIN)/carosac compare --seeds 6 --animation kinematic_solver mpc td3 --output $(RESULTS)/demo

test: $(STAMP)  ## run the test suite
	@$(BIN)/python -m tests.warm_kernels
	$(PYTEST) -m "not slow"

test-slow: $(STAMP)  ## run the tests that `test` leaves out, some minutes
	@$(BIN)/python -m tests.warm_kernels
	$(PYTEST) -m slow

lint: $(STAMP)  ## check style, formatting and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

bench: $(STAMP)  ## reference suite against its committed table, and speed of all parts
	$(BIN)/carosac compare --suite reference --output $(RESULTS)/reference-1
	$(BIN)/python -m benchmarks.reference $(RESULTS)/reference-1
	@$(BIN)/python -m pip install -qq --constraint constraints.txt mujoco
	$(BIN)/python -m benchmarks.statics
	$(BIN)/python -m benchmarks.limits
	$(BIN)/python -m benchmarks.simulator
	$(BIN)/python -m benchmarks.viewer
	$(BIN)/python -m benchmarks.workspace
	$(BIN)/python -m benchmarks.learning --parts throughput
	$(BIN)/python -m benchmarks.figures --write

bars: $(STAMP)  ## run the slow acceptance measurements but `learning`; figures go to RESULTS.md
	$(BIN)/python -m benchmarks.bars
	$(BIN)/python -m benchmarks.limits_bar
	$(BIN)/python -m benchmarks.studies
	$(BIN)/python -m benchmarks.simulator_bars
	$(BIN)/python -m benchmarks.calibration_tachymeter
	$(BIN)/python -m benchmarks.calibration_lengths
	$(BIN)/python -m benchmarks.calibration_rests
	$(BIN)/python -m benchmarks.calibration_hangprinter
	$(BIN)/python -m benchmarks.calibration_identify
	$(BIN)/python -m benchmarks.calibration_oscillations
	$(BIN)/python -m benchmarks.calibration_candidates
	$(BIN)/python -m benchmarks.estimators
	$(BIN)/python -m benchmarks.controllers
	$(BIN)/python -m benchmarks.mpc_friction
	$(BIN)/python -m benchmarks.similarity
	$(BIN)/python -m benchmarks.similarity --no-counts
	$(BIN)/python -m benchmarks.any_robot
	$(BIN)/python -m benchmarks.commands
	$(BIN)/python -m benchmarks.figures --write

# Preset `paper` takes days and a real recording has to be brought: see benchmarks/learning.py.
# The policy with seed 9 has learned nothing: it is the feedforward, without correction.
learning: $(STAMP)  ## train every preset but `paper` anew, some hours, and measure the policies
	for robot in carosac scampi; do for preset in carosac residual; do \
		$(BIN)/carosac train --preset $$preset --robot $$robot --seeds 3 --workers $(JOBS) \
			--output $(RESULTS)/learning/$$robot-$$preset || exit; done; done
	for robot in carosac scampi; do for seed in 0 1 2; do \
		$(BIN)/carosac distill --robot $$robot --seed $$seed \
			--output $(RESULTS)/distilled/$$robot-$$seed || exit; done; done
	$(BIN)/carosac train --preset residual --seed 9 --steps 256 --set environment.correction=0 \
		--output $(RESULTS)/feedforward
	$(BIN)/python -m benchmarks.learning --parts curves bars --runs $(RESULTS)/learning/*
	$(BIN)/python -m benchmarks.learning --parts drive --seeds 15 --policies \
		$(RESULTS)/feedforward/realtime/policy.onnx \
		$(RESULTS)/learning/*-residual/*/realtime/policy.onnx
	$(BIN)/python -m benchmarks.learning --parts inference low
	$(BIN)/python -m benchmarks.approximate_mpc --networks \
		$(RESULTS)/distilled/*-[0-9]/network.onnx
	$(BIN)/python -m benchmarks.figures --write

docs: $(STAMP)  ## build the documentation into docs/_build
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	$(BIN)/python docs/links.py docs/_build/html
	@echo "Open docs/_build/html/index.html"

linkcheck: $(STAMP)  ## try every external link of the documentation, over the network
	$(BIN)/python -m sphinx -q -b linkcheck docs docs/_build/linkcheck

docs-commands: $(STAMP)  ## run every command of README and docs, some with shorter settings
	$(BIN)/python docs/commands.py --jobs $(JOBS)

clean:  ## remove what the other targets made, but not .venv
	rm -rf $(RESULTS) docs/_build docs/_gallery docs/gallery.md build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
