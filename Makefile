# `make demo` and `make test` need python3 (3.10 or later, with venv) and nothing else; both create .venv here.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet install --constraint constraints.txt

.PHONY: demo test test-lab lint check-python open3d-libraries clean
.DELETE_ON_ERROR:

check-python:
	@command -v $(PYTHON) >/dev/null || { echo "make: $(PYTHON) not found; install Python 3.10 or later"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo "make: $(PYTHON) is older than 3.10; name a newer one: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "make: $(PYTHON) has no venv; on Debian: apt-get install python3-venv"; exit 1; }

$(VENV)/ready: pyproject.toml constraints.txt | check-python
	@echo "creating $(VENV) (torch is the bulk of it) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) --editable ".[network,plots]"
	@touch $@

$(VENV)/ready-to-test: $(VENV)/ready
	@echo "installing what the tests need ..."
	@$(PIP) --editable ".[test]"
	@touch $@

# Refine the shipped chair, judge it before and after, and draw it.
demo: $(VENV)/ready
	@$(BIN)/tso demo -o demo

# open3d loads these when it is imported; rendering and training on meshes need it, refining does not.
open3d-libraries: $(VENV)/ready-to-test
	@$(BIN)/python -c 'import open3d' 2>/dev/null || { \
	  test "$$(id -u)" = 0 && command -v apt-get >/dev/null && echo "installing open3d's system libraries ..." && \
	  apt-get -qq update && apt-get -qq install -y libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 >/dev/null; } || true
	@$(BIN)/python -c 'import open3d' 2>/dev/null || { \
	  echo "make: open3d cannot be imported; on Debian: sudo apt-get install libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1"; exit 1; }

lint: $(VENV)/ready-to-test
	@$(BIN)/ruff check --quiet tso_cli tso_lab tests examples docs
	@$(BIN)/ruff format --quiet --check tso_cli tso_lab tests examples docs
	@$(BIN)/mypy
	@$(BIN)/lint-imports

# Two processes of one thread each: torch's threads wait for one another on a busy machine.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

# The product and a quick part of the laboratory.
test: open3d-libraries lint
	@$(PYTEST) -m "not slow"

# What takes longer: studies, records, trainings in several processes, the commands of the pages.
test-lab: open3d-libraries
	@$(PYTEST) -m slow

clean:
	rm -rf $(VENV) demo
