# Everything happens in .venv; a bare machine needs Python 3.11+, git and make.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: help demo test lint types imports pytest test-slow test-real bench install clean

help:
	@echo "make demo       install, then watch a trained actor fly the mock vehicle"
	@echo "make test       install, then lint, types, import borders and tests"
	@echo "make test-slow  the suites that take minutes"
	@echo "make test-real COMPANION_TEST_CONNECT=URL  missions on an autopilot or simulator of yours"
	@echo "make bench      measure; the results so far are in tests/benchmarks/RESULTS.md"

.venv/pip.stamp:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	@touch $@

# What flies: no torch.
.venv/flight.stamp: .venv/pip.stamp pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

# What trains and tests. torch first and exactly: everyone tests the same build.
.venv/dev.stamp: .venv/pip.stamp pyproject.toml
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable ".[training]" --group dev
	# A client of the mock in tests; its graphics (OpenCV, VTK: 500 MB) are not needed there.
	$(BIN)/python -m pip install --quiet --no-deps "MAVProxy>=1.8.75" defusedxml
	@touch $@ .venv/flight.stamp

install: .venv/dev.stamp

demo: .venv/flight.stamp
	$(BIN)/companion run --connect mock:px4 --map env1 --target 90,50,40 --arm --takeoff 20 --engage

test: lint types imports pytest

lint: .venv/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/dev.stamp
	$(BIN)/mypy

imports: .venv/dev.stamp
	$(BIN)/lint-imports

# Three at a time: flights over sockets take real time, and hardly a core.
pytest: .venv/dev.stamp
	$(BIN)/python -m pytest --numprocesses 3 --dist loadfile

test-slow: .venv/dev.stamp
	$(BIN)/python -m pytest -m slow --timeout=3600

# Arms and flies what is at COMPANION_TEST_CONNECT, and prints what it measured.
test-real: .venv/dev.stamp
	@test -n "$(COMPANION_TEST_CONNECT)" || { echo "COMPANION_TEST_CONNECT=URL is missing"; exit 2; }
	COMPANION_TEST_CONNECT=$(COMPANION_TEST_CONNECT) $(BIN)/python -m pytest -rP -k real \
	    tests/integration/test_real_autopilot.py tests/integration/test_vehicle_contract.py

bench: .venv/dev.stamp
	$(BIN)/python -m pytest tests/benchmarks -o addopts=--import-mode=importlib --benchmark-only \
	    --benchmark-columns=median,iqr,ops
	$(BIN)/python tests/benchmarks/loop.py
	$(BIN)/python tests/benchmarks/mock_speed.py

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis dist build
