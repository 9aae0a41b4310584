PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
READY_DEV := $(VENV)/ready-dev

.PHONY: demo test check bench bench-slam paper docs clean

demo: $(READY)  ## install, run the main job on the real Motorcycle pair, say where the pictures are
	$(BIN)/tspslam run --out runs/motorcycle

test: $(READY_DEV)  ## every check and every test
	$(MAKE) check
	$(BIN)/python -m pytest -n 2

check: $(READY_DEV)  ## format, lint, strict types, import arrows
	$(BIN)/ruff format --check src tests benchmarks examples experiments docs
	$(BIN)/ruff check src tests benchmarks examples experiments docs
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_house.py

bench-slam: $(READY_DEV)  ## the camera path beside the true one; DATA=FOLDER for a recording of your own
	$(BIN)/python -m benchmarks.slam $(if $(DATA),--data '$(DATA)',--docs docs)

bench: $(READY_DEV)  ## figures against named references, beside the committed baseline
	$(BIN)/python -m benchmarks

paper: $(READY_DEV)  ## every figure and table of the paper; DATA=FOLDER for frames of your own
	$(BIN)/python -m experiments $(if $(DATA),--data '$(DATA)',--docs docs)

docs: $(READY_DEV)
	$(BIN)/python -m sphinx -W -b html docs docs/_build/html

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(READY): pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e .
	touch $@

$(READY_DEV): pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e '.[dev,docs]'
	touch $@ $(READY)

clean:
	rm -rf $(VENV) runs docs/_build .pytest_cache .mypy_cache .ruff_cache .hypothesis
