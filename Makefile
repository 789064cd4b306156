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

# What computes takes only what nothing else wants of the cores. Next to it what waits for processes, wires and time: it
# needs little of a core, and has it at once when it wakes; then, one by one, what loads the machine itself. Last, alone, what
# asserts milliseconds.
IDLE := nice -n 19 $(if $(shell command -v chrt),chrt --idle 0)
pytest: $(STAMP)
	@log=$$(mktemp) && trap 'rm -f "$$log"' EXIT; \
	{ $(BIN)/python -m pytest -q -n 3 --dist loadfile --no-loadscope-reorder -m "realtime and not alone and not singly" \
	    $(PYTEST_ARGS); \
	  waited=$$?; $(BIN)/python -m pytest -q -m "realtime and singly" $(PYTEST_ARGS) && exit $$waited; } > "$$log" 2>&1 & \
	waiting=$$!; \
	$(IDLE) $(BIN)/python -m pytest -q -n $$(($$(nproc) + 1)) --dist worksteal -m "not realtime and not study" \
	  $(PYTEST_ARGS); computed=$$?; \
	wait $$waiting; waited=$$?; cat "$$log"; exit $$((computed || waited))
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
	$(BIN)/python -m pip install -q --no-compile --no-deps --require-hashes -r requirements.lock
	$(BIN)/python -m pip install -q --no-deps --no-build-isolation -e .
	touch $(STAMP)

clean:
	rm -rf $(VENV) build dist docs/_build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
