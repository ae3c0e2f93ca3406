# make demo: everything that is needed, then the main job.  make test: style, types and tests.  make bench: timing.
PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2
BIN = $(VENV)/bin

.PHONY: demo bench test style clean

$(BIN)/aerotact: pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "no $(PYTHON): install Python 3.11 or newer, or say make PYTHON=..."; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$(PYTHON) is older than 3.11; say make PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(BIN)/pytest: $(BIN)/aerotact
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(BIN)/aerotact
	$(BIN)/aerotact compare ryll2019/property-shaping --seeds 1 --jobs $(JOBS) --output results/demo

bench: $(BIN)/aerotact
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	for ocp in H O; do $(BIN)/aerotact bench --ocp $$ocp --horizon 10 --horizon 20 --horizon 40 --horizon 80 \
	    --blocks tilt_hex --blocks tilt_rotor --output benchmarks/results || exit 1; done

style: $(BIN)/pytest
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: style
	$(BIN)/pytest -n $(JOBS) -m 'not slow'

clean:
	rm -rf $(VENV) results build dist
