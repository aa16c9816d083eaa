# `make demo` and `make test` are the two commands a newcomer needs; each sets up .venv first if need be.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help

# TOOLS=0 leaves out torch, Ultralytics and the libraries of .venv-tools; the tests that need it are then skipped, loudly.
TOOLS ?= 1
# Further arguments for pytest: make test ARGS="-k masks".
ARGS ?=

.PHONY: help setup train tools demo test check bench lock reference clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' Makefile

setup: ## Install everything, locked, into .venv; nothing to do the second time
	@scripts/setup.sh

train: setup ## Install torch and Ultralytics into .venv: infrablend train (the download size is said first)
	@scripts/train_env.sh

tools: train ## The same, and in .venv-tools other libraries that load our datasets
	@scripts/tools_env.sh

demo: setup ## Render drones into a small virtual thermal world; the last line is the picture's path
	@scripts/demo.sh

test: setup $(if $(filter-out 0,$(TOOLS)),tools) ## Run all tests
	@$(if $(filter-out 0,$(TOOLS)),INFRABLEND_REQUIRE_TOOLS=1) .venv/bin/python -m pytest $(ARGS)

check: setup ## Lint, format, types, import layers, rules of the tree
	.venv/bin/ruff check src tests scripts $(wildcard bench examples)
	.venv/bin/ruff format --check src tests scripts $(wildcard bench examples)
	.venv/bin/mypy
	.venv/bin/lint-imports
	.venv/bin/python scripts/write_reference.py --check
	.venv/bin/python -m pytest -q -m "not slow" tests/architecture

bench: setup ## Measure speed, error, boxes and memory; writes build/bench
	@.venv/bin/python bench/bench.py

lock: setup ## Write requirements/*.txt anew (UPGRADE=1: newest allowed versions)
	@scripts/lock.sh

reference: setup ## Write docs/reference/recipe.md and cli.md anew from the code
	@.venv/bin/python scripts/write_reference.py

clean: ## Remove what the make commands wrote, except the environments
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests scripts $(wildcard bench examples) -name __pycache__ -prune -exec rm -rf {} +
