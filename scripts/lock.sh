#!/usr/bin/env bash
# Writes the hashed requirement files anew from their .in files and pyproject.toml. Versions stay as they are unless
# the inputs forbid them; `make lock UPGRADE=1` takes the newest allowed ones. No registry address gets into a file.
set -euo pipefail
cd "$(dirname "$0")/.."
compile=(.venv/bin/uv pip compile --quiet --generate-hashes --no-header --no-emit-index-url --no-emit-find-links
  --python-version 3.11 --universal)
[ -z "${UPGRADE:-}" ] || compile+=(--upgrade)
"${compile[@]}" requirements/uv.in --output-file requirements/uv.txt
"${compile[@]}" pyproject.toml requirements/project.in --group dev --output-file requirements/project.txt
