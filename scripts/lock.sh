#!/usr/bin/env bash
# Regenerates the hashed requirement files from their .in files and pyproject.toml. Versions change only if the inputs
# forbid them; `make lock UPGRADE=1` selects the newest allowed ones. No registry address is written to a file.
set -euo pipefail
cd "$(dirname "$0")/../requirements"
compile=(../.venv/bin/uv pip compile --quiet --generate-hashes --no-header --no-emit-index-url --no-emit-find-links
  --python-version 3.11)
[ -z "${UPGRADE:-}" ] || compile+=(--upgrade)

"${compile[@]}" --universal uv.in --output-file uv.txt
"${compile[@]}" --universal ../pyproject.toml project.in --group ../pyproject.toml:dev --output-file project.txt

# Blender's environment: nothing in it is shared with .venv.
"${compile[@]}" --universal blender.in --output-file ../src/infrablend/blender/requirements.txt
"${compile[@]}" --universal --no-deps numpy1.in --output-file numpy1.txt
"${compile[@]}" --universal --no-deps --constraints project.txt tools.in --output-file tools.txt
"${compile[@]}" --universal --no-deps --constraints project.txt train.in --output-file train.txt
"${compile[@]}" --universal --constraints project.txt studio.in --output-file studio.txt
"${compile[@]}" --universal --constraints project.txt --constraints studio.txt browser.in --output-file browser.txt
"${compile[@]}" --universal --constraints project.txt --constraints studio.txt ray.in --output-file ray.txt
"${compile[@]}" --universal --constraints project.txt --constraints studio.txt --constraints ray.txt s3.in --output-file s3.txt
"${compile[@]}" --universal --constraints project.txt --constraints studio.txt --constraints ray.txt --constraints s3.txt docs.in --output-file docs.txt

# Requirements of torch and torchvision that another file pins or that it does not need on this project's paths.
unneeded=(numpy pillow triton sympy mpmath networkx jinja2 markupsafe fsspec filelock setuptools typing-extensions)
"${compile[@]}" --universal "${unneeded[@]/#/--no-emit-package=}" torch.in --output-file torch.txt
