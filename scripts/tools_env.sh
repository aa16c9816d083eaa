#!/usr/bin/env bash
# Makes .venv-tools: Supervision, Datumaro and Hugging Face's datasets, which the tests use to load our datasets.
# A second run does nothing until a requirement file changes. Needs .venv (make setup).
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'tools: %s\n' "$*" >&2; }
stop() { say "$*"; exit 1; }

mkdir -p build
if command -v flock >/dev/null; then exec 9>build/.tools.lock; flock 9; fi

inputs=(requirements/tools.txt scripts/tools_env.sh)
want="$(printf '%s\n' "$PWD"; cat "${inputs[@]}")"
want="$(printf '%s' "$want" | sha256sum | cut -d' ' -f1)"
stamp=.venv-tools/infrablend-tools.stamp
if [ "$(cat "$stamp" 2>/dev/null)" = "$want" ] && .venv-tools/bin/python -c '' 2>/dev/null; then exit 0; fi

say "installing Supervision, Datumaro and datasets into .venv-tools: about 210 MB to download. To skip this: make test ALL=1 TOOLS=0"

if [ -e .venv-tools ]; then
  [ -f .venv-tools/pyvenv.cfg ] || [ -z "$(ls -A .venv-tools)" ] || stop ".venv-tools is no environment; move it away"
  rm -rf .venv-tools
fi
.venv/bin/python -m venv .venv-tools || { rm -rf .venv-tools; stop "could not make .venv-tools"; }

registry="the package registry could not be used, or gave other files than the locked ones: check the network and pip's
tools: settings and run the same command again, or do without: make test ALL=1 TOOLS=0"
install=(.venv-tools/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes
  --only-binary :all:)
log=build/tools-env.log
"${install[@]}" -r requirements/tools.txt >"$log" 2>&1 || { tail -n 5 "$log" >&2; stop "$registry"; }
.venv-tools/bin/python -W ignore -c 'import supervision, datumaro, datasets' >/dev/null ||
  stop "Supervision, Datumaro or datasets does not import; the lines above show the reason"

printf '%s\n' "$want" >"$stamp.new"
mv "$stamp.new" "$stamp"
say "ready: .venv-tools"
