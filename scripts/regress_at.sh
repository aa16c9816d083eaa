#!/usr/bin/env bash
# Run today's attacks on the command line against the sources of an earlier commit, where they have to fail.
#
#     scripts/regress_at.sh [COMMIT] [PYTEST OPTIONS]      default: cb6733f, the commit that was attacked
#
# Prints the outcome of each test and why it failed. One that passes there proves nothing about what was mended since.
# Two tests of functions that did not exist yet are left out.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
commit=${1:-cb6733f}
shift || true
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
git -C "$root" archive "$commit" src | tar -x -C "$folder"

tests=(tests/unit/pipeline/test_folder_attacks.py tests/unit/test_hostile_names.py tests/unit/test_input_attacks.py)
helpers=(
    tests/__init__.py tests/clips.py tests/command_line.py tests/flat_renderer.py tests/killing.py tests/run_files.py tests/samples.py
)
for file in "${tests[@]}" "${helpers[@]}"; do
    mkdir -p "$folder/$(dirname "$file")"
    cp "$root/$file" "$folder/$file"
done
# Pictures of datasets that are made on reading belong in the temporary folder, as in the tests of today.
export XDG_CACHE_HOME="$folder/cache" PYTHONPATH="$folder/src:$folder" OMP_NUM_THREADS=1
cd "$folder"
ulimit -v 16000000 # an earlier version reads /dev/zero until memory is full
"$root/.venv/bin/python" -c 'import infrablend, sys; sys.exit(0 if infrablend.__file__.startswith(sys.argv[1]) else 1)' "$folder"
"$root/.venv/bin/python" -m pytest -c /dev/null --rootdir="$folder" -p no:cacheprovider --timeout 60 -v --tb=line \
    -k "not one_part_of_a_path and not distinct_names" "$@" "${tests[@]}" 2>&1 | grep -E --line-buffered '::|^(/|E )|(passed|failed)' || true
