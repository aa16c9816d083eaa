# `make demo` and `make test` are the two commands a newcomer needs; each sets up .venv first.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
MAKEFLAGS += --no-print-directory
# Tests start hundreds of processes, and each would compile the package again.
unexport PYTHONDONTWRITEBYTECODE
.DEFAULT_GOAL := help

# ALL=1 runs all tests, with coverage, as continuous integration does; without it, those that take ten minutes together.
ALL ?= 0
# With ALL=1, TOOLS=0 leaves out torch, Ultralytics and the libraries of .venv-tools; the summary lists what is skipped.
TOOLS ?= 1
# Further arguments for pytest: make test ARGS="-k masks".
ARGS ?=
# Test processes side by side: auto takes one per core, as far as the memory allows; 0 runs the tests one by one.
TEST_WORKERS ?= auto
# Least share of lines, %, that the tests of units, properties and storage execute.
COVERAGE_FLOOR := 91

pytest = .venv/bin/python -m pytest
# Workers take tests from each other at the end, so that none is left with a long file.
parallel = -n $(TEST_WORKERS) --dist worksteal
# Suites that run again with the oldest numpy: those that compute pixels and read and write files.
numpy1 = $(addprefix tests/unit/,annotation compositing config formats)
coverage = --cov=infrablend --cov-report= --cov-fail-under=$(COVERAGE_FLOOR)
# What is set by 1 and left alone by 0.
all = $(filter-out 0,$(ALL))
tools = $(and $(all),$(filter-out 0,$(TOOLS)))

.PHONY: help setup train studio ray s3 tools demo test check bench lock reference docs clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' Makefile

setup: ## Install everything, locked, into .venv; does nothing the second time
	@scripts/setup.sh

train: setup ## Install torch and Ultralytics into .venv: infrablend train (shows the download size first)
	@scripts/train_env.sh

studio: setup ## Install NiceGUI into .venv: infrablend studio
	@scripts/extra_env.sh studio

ray: setup ## Install Ray into .venv: infrablend generate --executor ray
	@scripts/extra_env.sh ray

s3: setup ## Install s3fs into .venv, and an S3 server for tests: infrablend generate --out s3://...
	@scripts/extra_env.sh s3

tools: train studio ## Also install what only tests need: libraries that load our datasets, a driver for Chromium
	@scripts/tools_env.sh
	@scripts/extra_env.sh browser
	@scripts/extra_env.sh docs
	@scripts/extra_env.sh ray || echo "Ray is not there: its tests will be skipped" >&2
	@scripts/extra_env.sh s3 || echo "s3fs is not there: the tests of object storage will be skipped" >&2

demo: setup ## Render drones into a small virtual thermal world; the last line is the path of the picture
	@scripts/demo.sh

test: setup $(and $(tools),tools) $(if $(ARGS),,$(and $(all),build/numpy1/done)) ## Run the tests; ALL=1 runs all of them
ifeq ($(all),)
	@$(pytest) $(parallel) $(ARGS)
else
	@$(if $(tools),INFRABLEND_REQUIRE_TOOLS=1) $(pytest) --all $(parallel) $(if $(ARGS),$(ARGS),$(coverage))
	@$(if $(ARGS),,PYTHONPATH=$(CURDIR)/build/numpy1 $(pytest) --all $(parallel) $(numpy1))
endif

build/numpy1/done: requirements/numpy1.txt | setup
	@rm -rf build/numpy1
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --only-binary :all: \
	  --target build/numpy1 -r $<
	@PYTHONPATH=build/numpy1 .venv/bin/python -c 'import numpy; assert numpy.__version__.startswith("1.")'
	@touch $@

check: setup ## Lint, format, types, import layers, rules of the tree
	.venv/bin/ruff check src tests scripts $(wildcard bench examples)
	.venv/bin/ruff format --check src tests scripts $(wildcard bench examples)
	for system in linux darwin win32; do .venv/bin/mypy --platform $$system --cache-dir .mypy_cache/$$system; done
	.venv/bin/mypy --config-file tests/mypy.ini
	.venv/bin/lint-imports
	.venv/bin/python scripts/write_reference.py --check
	.venv/bin/python -m pytest -q -m "not slow" tests/architecture

bench: setup ## Measure speed, error, boxes and memory; writes build/bench
	@.venv/bin/python bench/bench.py

lock: setup ## Regenerate requirements/*.txt (UPGRADE=1: newest allowed versions)
	@scripts/lock.sh

reference: setup ## Regenerate docs/reference/recipe.md and cli.md from the code
	@.venv/bin/python scripts/write_reference.py

docs: setup ## Build the documentation as a site, build/site; a broken link or a page outside the navigation is an error
	@scripts/extra_env.sh docs
	@NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --quiet
	@printf '%s\n' build/site/index.html

clean: ## Remove the files that make wrote, except the environments
	rm -rf build dist .coverage .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests scripts $(wildcard bench examples) -name __pycache__ -prune -exec rm -rf {} +
