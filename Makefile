# Two commands on a fresh machine: `make demo` and `make test`. Both make the environment first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.PHONY: demo test lint pytest quick studies bench reliability docs pictures schemas lock clean

demo: $(STAMP)
	$(BIN)/pmabench demo --out demo-run

test: lint pytest

# First what computes, on every core; then what waits for processes, wires and time, two files next to each other; last
# what asserts milliseconds or loads the machine, with nothing next to it.
pytest: $(STAMP)
	$(BIN)/python -m pytest -q -n auto --dist worksteal -m "not realtime and not study" $(PYTEST_ARGS)
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder -m "realtime and not alone" $(PYTEST_ARGS)
	$(BIN)/python -m pytest -q -m "realtime and alone" $(PYTEST_ARGS)

quick: $(STAMP)
	$(BIN)/python -m pytest -q -x -m "not slow"

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# What is said of intervals and of the ways to K_u, over hundreds of simulated campaigns: some ten minutes.
studies: $(STAMP)
	$(BIN)/python -m pytest -q -s -n auto --timeout=3600 -m study tests --ignore tests/benchmarks

bench: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -s tests/benchmarks --benchmark-enable

# All parts, or PART=kill,power; writes docs/reliability.md. See tests/reliability/README.md.
reliability: $(STAMP)
	$(BIN)/python -m tests.reliability $(PART)

docs: $(STAMP)
	$(BIN)/python -m sphinx -q -W --keep-going docs docs/_build
	@echo docs/_build/index.html

pictures: $(STAMP)
	$(BIN)/python -m tests.pictures

schemas: $(STAMP)
	$(BIN)/python -m pmabench schema --all --out docs/schemas

lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --extra dev pyproject.toml -o requirements.lock

$(STAMP): requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --no-compile --require-hashes -r requirements.lock
	$(BIN)/python -m pip install -q --no-deps --no-build-isolation -e .
	touch $(STAMP)

clean:
	rm -rf $(VENV) build dist docs/_build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
