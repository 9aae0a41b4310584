PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
READY_DEV := $(VENV)/ready-dev
LATEST := .venv-latest
OLDEST := .venv-oldest
# Two workers on two cores: threads of the linear algebra would only wait for one another.
TESTS := -m pytest -n 2 --dist loadfile --no-loadscope-reorder
ONE_THREAD := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1

.PHONY: demo test test-browser browser test-latest test-oldest constraints check lint types house kernels bench bench-slam bench-map bench-uses paper docs clean

demo: $(READY)  ## install, run the main job on the real Motorcycle pair, say where the pictures are
	$(BIN)/tspslam run --out runs/motorcycle

test: $(READY_DEV)  ## every check and every test
	$(MAKE) -j 2 check kernels
	$(ONE_THREAD) $(BIN)/python $(TESTS) --ignore=tests/test_house.py --ignore=tests/test_jit.py

browser:  ## install Chromium where the system's own packages have it, for the tests that need a browser
	for name in chromium chromium-browser google-chrome; do command -v $$name && exit 0; done; \
	apt-get update -qq && apt-get install -y -qq chromium

test-browser: browser $(READY_DEV)  ## the report and the viewer in a real browser; `make test` skips these where there is none
	$(ONE_THREAD) $(BIN)/python -m pytest -q tests/browser

test-latest: | $(LATEST)/bin/python  ## every test with the newest packages of today
	$(LATEST)/bin/python -m pip install --quiet --upgrade --upgrade-strategy eager -e '.[dev,docs]'
	$(ONE_THREAD) $(LATEST)/bin/python $(TESTS)

test-oldest: | $(OLDEST)/bin/python  ## every test with the oldest packages that pyproject.toml allows; PYTHON=3.11 or 3.12, which they know
	$(OLDEST)/bin/python .ci/floors.py > $(OLDEST)/floors.txt
	$(OLDEST)/bin/python -m pip install --quiet --prefer-binary -c $(OLDEST)/floors.txt -e '.[dev,docs]'
	$(ONE_THREAD) $(OLDEST)/bin/python $(TESTS)

constraints: | $(LATEST)/bin/python  ## take the versions of `make test-latest` as those of `make test`
	grep '^#' constraints.txt > $(LATEST)/constraints.txt
	$(LATEST)/bin/python -m pip freeze --exclude-editable >> $(LATEST)/constraints.txt
	cp $(LATEST)/constraints.txt constraints.txt

check: types lint house  ## format, lint, strict types, import arrows

types: $(READY_DEV)
	$(BIN)/mypy

lint: $(READY_DEV)
	$(BIN)/ruff format --check src tests conftest.py benchmarks examples experiments docs
	$(BIN)/ruff check src tests conftest.py benchmarks examples experiments docs

house: $(READY_DEV)
	$(BIN)/python -m pytest -q tests/test_house.py

kernels: $(READY_DEV)  # beside the types, so that both cores work; later tests find kernels compiled
	$(ONE_THREAD) $(BIN)/python -m pytest -q tests/test_jit.py

bench-slam: $(READY_DEV)  ## the camera path beside the true one; DATA=FOLDER for a recording of your own
	$(BIN)/python -m benchmarks.slam $(if $(DATA),--data '$(DATA)',--docs docs)

bench-map: $(READY_DEV)  ## the map of a sequence beside the true surface; DATA=FOLDER for a recording of your own
	$(BIN)/python -m benchmarks.mapping $(if $(DATA),'$(DATA)',--docs docs)
	$(if $(DATA),,$(BIN)/python -m benchmarks.mapping_candidates --docs docs)

bench-uses: $(READY_DEV)  ## denoising, segments, quality and recognition beside named baselines, by docs/uses_protocol.rst
	for use in signals mesh cloud segment quality recognise; do $(BIN)/python -m benchmarks.uses.$$use --docs docs || exit 1; done

bench: $(READY_DEV)  ## figures against named references, beside the committed baseline; fails where a ratio is too large
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.limits

paper: $(READY_DEV)  ## every figure and table of the paper; DATA=FOLDER for frames of your own
	$(BIN)/python -m experiments $(if $(DATA),--data '$(DATA)',--docs docs)

docs: $(READY_DEV)
	$(BIN)/python -m sphinx -W -b html docs docs/_build/html

$(VENV)/bin/python $(LATEST)/bin/python $(OLDEST)/bin/python:
	$(PYTHON) -m venv $(@:/bin/python=)

$(READY): pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e .
	touch $@

$(READY_DEV): pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev,docs]'
	touch $@ $(READY)

clean:
	rm -rf $(VENV) $(LATEST) $(OLDEST) runs docs/_build .pytest_cache .mypy_cache .ruff_cache .hypothesis
