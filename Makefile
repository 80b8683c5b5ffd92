# Everything happens in a private environment, .venv; a fresh machine needs Python 3.11 (or newer) and make.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin

.PHONY: help run test test-fast lint bench clean

help:
	@echo "make run        set up, a short design campaign on real worker processes, its best designs and its report"
	@echo "make test       set up, run all tests"
	@echo "make test-fast  the same without the slow ones"
	@echo "make lint       ruff, mypy, import rules"
	@echo "make bench      every benchmark, one table each"

run: .venv/.run
	@echo "a design campaign of about a minute, on real worker processes"
	$(BIN)/luxloop run

test: .venv/.dev
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

test-fast: .venv/.dev
	$(BIN)/python -m pytest -q -n 2 --dist loadfile -m "not slow"

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# what is no benchmark, and what asks for a folder or for data of others, is left out
NO_BENCH := __init__ processes cells mitsuba_scene blind_null blind_records tutorial_wafer
bench: .venv/.dev
	@failed=""; for file in $(filter-out $(NO_BENCH:%=benchmarks/%.py),$(wildcard benchmarks/*.py)); do \
	  echo; echo "== $$file"; $(BIN)/python $$file || failed="$$failed $$file"; done; \
	  test -z "$$failed" || { echo "failed:$$failed"; exit 1; }

.venv/pyvenv.cfg:
	@test -n "$(PYTHON)" || { echo "make: no python3.11 found; set PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv .venv || { rm -rf .venv; echo "make: no venv: on Debian and Ubuntu it is the package python3-venv"; exit 1; }

.venv/.run: pyproject.toml constraints.txt | .venv/pyvenv.cfg
	@echo "setting up in .venv: packages, then kernels are compiled (two to four minutes, once)"
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[all]"
	$(BIN)/python -m containers.warm_up
	@touch $@

.venv/.dev: pyproject.toml constraints.txt | .venv/pyvenv.cfg
	@echo "setting up in .venv: packages, then kernels are compiled (two to four minutes, once)"
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[dev]"
	$(BIN)/python -m containers.warm_up
	@touch $@ .venv/.run

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
