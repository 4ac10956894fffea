# SPDX-License-Identifier: Apache-2.0
# Every target sets up what it needs: .venv from the lock file constraints.txt, nothing else.

PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& { echo "$$p"; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
# what runs by itself and is neither a picture nor the table of the results
BENCHMARKS := $(sort $(filter-out %readme_table.py %_pictures.py %picture_of_team.py %mover_picture.py, \
	$(shell grep -l __main__ benchmarks/*.py)))

.PHONY: help setup run test test-all check format bench lock clean
.DEFAULT_GOAL := help

help:
	@echo "make run       fly the paper's scenario and write its report"
	@echo "make test      the tests; make test-all adds the closed-loop flights"
	@echo "make check     format, lint, types, import contract"
	@echo "make bench     every benchmark, then the tables of the README"
	@echo "make setup     only set up .venv"
	@echo "make lock      take the newest versions into constraints.txt"

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "skyhaul needs Python 3.11 or newer: install python3, or name one with make PYTHON=..."; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "$(PYTHON) has no venv module: install the package python3-venv of your system"; exit 1; }
	@echo "setting up $(VENV), once; this takes a few minutes"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) install --upgrade -c constraints.txt pip
	@$(PIP) install -c constraints.txt hatchling editables
	@$(PIP) install -c constraints.txt --no-build-isolation --editable '.[video]' --group dev
	@touch $@

run: $(READY)
	@$(BIN)/skyhaul run paper

test: $(READY)
	$(BIN)/python -m pytest

test-all: $(READY)
	$(BIN)/python -m pytest -m ''

check: $(READY)
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY)
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: $(READY)
	@$(PIP) install -c constraints.txt --group bench
	@set -e; for b in $(BENCHMARKS); do echo "$$b"; $(BIN)/python $$b; done
	@$(BIN)/python benchmarks/readme_table.py

lock:
	rm -rf build/lock && $(PYTHON) -m venv build/lock
	build/lock/bin/python -m pip install --quiet --upgrade pip hatchling editables
	build/lock/bin/python -m pip install --quiet --editable '.[video,recordings]' --group dev --group bench
	{ echo "# Locked versions of everything that make setup installs; pip reads it as constraints."; \
	  build/lock/bin/python -m pip freeze --all --exclude-editable; } > constraints.txt
	rm -rf build/lock

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache build dist
