# Every target sets up what it needs first. No make on this machine? `python3 setup/bootstrap.py` is `make setup`.

PYTHON ?= python3
BIN := .venv/bin
MESH ?=
SECONDS ?= 60

.PHONY: help setup setup-dev setup-bench demo test check format fuzz bench serve lock clean

help:  ## what can be made
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup:  ## .venv with the locked packages, and the system's EGL and Mesa libraries
	@$(PYTHON) setup/bootstrap.py

setup-dev:  ## the same with the tools for tests and checks
	@$(PYTHON) setup/bootstrap.py --dev

setup-bench:  ## the same with what the benchmarks compare with: libigl, Nested Cages, VTK; and matplotlib
	@$(PYTHON) setup/bootstrap.py --bench

demo: setup  ## upload, preprocess, render: writes demo/*.png, *.svg, *.json; MESH=path for a mesh of your own
	@$(BIN)/silhouette demo $(MESH) --out demo

test: setup-dev  ## all tests
	@$(BIN)/python -m pytest -n 2 --dist loadgroup

check: setup-dev  ## style, types, import directions
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

format: setup-dev  ## rewrite the sources in the project's format
	@$(BIN)/ruff check --fix-only --quiet . ; $(BIN)/ruff format .

fuzz: setup-dev  ## fuzz every reader of strangers' bytes, then the service by its OpenAPI document; SECONDS=60 for each
	@$(BIN)/python -m tests.fuzz --seconds $(SECONDS)

bench: setup-bench  ## all benchmarks and the tables in docs/results; MESH=path for one mesh of your own
	@if [ -n "$(MESH)" ]; then for table in preprocessing hulls table2 table1; do \
	  $(BIN)/python -m benchmarks.tables.$$table "$(MESH)" || exit 1; done; \
	else $(BIN)/python -m benchmarks; fi

serve: setup  ## the service on http://127.0.0.1:8000
	@$(BIN)/silhouette serve

lock: setup-dev  ## resolve the locked versions again (needs uv)
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header -q pyproject.toml requirements/build.in -o requirements/run.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header -q --extra dev pyproject.toml requirements/build.in -o requirements/dev.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header -q --extra dev --extra bench pyproject.toml requirements/build.in -o requirements/bench.lock

clean:  ## remove what was built
	rm -rf .venv build dist demo *.egg-info .pytest_cache .mypy_cache .ruff_cache
