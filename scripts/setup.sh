#!/usr/bin/env bash
# Makes .venv, and .venv-blender for Blender beside it, from the committed, hashed requirement files; a second run does
# nothing until one of them changes. Needs Python 3.11 with its venv module and a package registry, nothing else.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'setup: %s\n' "$*" >&2; }
stop() { say "$*"; exit 1; }

[ "$(uname -s)" = Linux ] || say "this system is $(uname -s): only Linux is tested; continuing anyway"

# One set-up at a time, also under `make -j`.
mkdir -p build
if command -v flock >/dev/null; then exec 9>build/.setup.lock; flock 9; fi

# Inputs that .venv must have been built from; the path is one because a moved environment does not work.
blender=src/infrablend/blender/requirements.txt
inputs=(requirements/uv.txt requirements/project.txt "$blender" pyproject.toml scripts/setup.sh)
want="$(printf '%s\n' "$PWD"; cat "${inputs[@]}")"
want="$(printf '%s' "$want" | sha256sum | cut -d' ' -f1)"
stamp=.venv/infrablend-setup.stamp
works() { .venv/bin/python -c '' && .venv-blender/bin/python -c ''; } 2>/dev/null
if [ "$(cat "$stamp" 2>/dev/null)" = "$want" ] && [ -x .venv/bin/infrablend ] && works; then exit 0; fi

# --- Python -----------------------------------------------------------------------------------------------------
python=
for candidate in ${PYTHON:+"$PYTHON"} python3.11 python3 python; do
  if "$candidate" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' >/dev/null 2>&1
  then python="$candidate"; break; fi
done
[ -n "$python" ] || stop "found no Python 3.11 (Blender's module exists for no other version); install it" \
  "(Debian 12: apt-get install python3 python3-venv), or name it: make setup PYTHON=/path/to/python3.11"
"$python" -c 'import ensurepip, venv' >/dev/null 2>&1 ||
  stop "$python lacks the venv module; install it (Debian 12: apt-get install python3-venv)"

# --- system libraries -------------------------------------------------------------------------------------------
mapfile -t missing < <("$python" src/infrablend/rendering/engine/system_libraries.py)
if [ "${#missing[@]}" -gt 0 ]; then
  line="apt-get install -y --no-install-recommends ${missing[*]}"
  if ! command -v apt-get >/dev/null; then
    stop "Blender needs the system libraries of the Debian packages ${missing[*]}; install what holds them here"
  elif [ "$(id -u)" = 0 ]; then as_root=(env)
  elif sudo -n true 2>/dev/null; then as_root=(sudo -n env)
  else stop "Blender needs system libraries. Run this, then again what you ran:
sudo apt-get update && sudo $line"
  fi
  say "installing system libraries: ${missing[*]}"
  as_root+=(DEBIAN_FRONTEND=noninteractive)
  log=build/apt.log
  # Package lists may be absent or stale: fetch them only if the first try fails.
  # shellcheck disable=SC2086
  if ! "${as_root[@]}" $line >"$log" 2>&1; then
    "${as_root[@]}" apt-get update >>"$log" 2>&1 || true
    "${as_root[@]}" $line >>"$log" 2>&1 || { tail -n 15 "$log" >&2; stop "could not install them; see $log. The line was: $line"; }
  fi
  mapfile -t missing < <("$python" src/infrablend/rendering/engine/system_libraries.py)
  [ "${#missing[@]}" -eq 0 ] || stop "installed, but these still do not load: ${missing[*]}"
fi

# --- environment ------------------------------------------------------------------------------------------------
home="$(.venv/bin/python -c 'import sys; print(sys.prefix, *sys.version_info[:2])' 2>/dev/null || true)"
if [ "$home" != "$PWD/.venv 3 11" ] || ! grep -qF "$PWD/.venv" .venv/bin/activate 2>/dev/null; then
  if [ -e .venv ]; then
    [ -f .venv/pyvenv.cfg ] || [ -z "$(ls -A .venv)" ] || stop ".venv is there but is no environment; move it away"
    say ".venv was moved, is broken or has another Python: creating it again"
    rm -rf .venv
  fi
  "$python" -m venv .venv || { rm -rf .venv; stop "$python could not make .venv"; }
fi
rm -f "$stamp"

registry="The package registry could not be used, or gave other files than the locked ones: check the network and any
proxy or mirror settings of pip and uv, then run the same command again; what is already downloaded is kept."

if ! uv_version="$(.venv/bin/uv --version 2>/dev/null)" ||
   ! grep -q "^uv==$(printf '%s' "$uv_version" | cut -d' ' -f2) " requirements/uv.txt; then
  say "installing uv and pip (about 25 MB)"
  .venv/bin/python -m pip --version >/dev/null 2>&1 || .venv/bin/python -m ensurepip >/dev/null
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes --only-binary :all: \
    -r requirements/uv.txt || stop "$registry"
fi

# Mirrors and certificates that are configured for pip only also apply to uv.
index="${PIP_INDEX_URL:-$(.venv/bin/python -m pip config get global.index-url 2>/dev/null || true)}"
if [ -n "$index" ] && [ -z "${UV_DEFAULT_INDEX:-}${UV_INDEX_URL:-}" ]; then export UV_DEFAULT_INDEX="$index"; fi
if [ -n "${PIP_CERT:-}" ] && [ -z "${SSL_CERT_FILE:-}" ]; then export SSL_CERT_FILE="$PIP_CERT"; fi
export UV_HTTP_TIMEOUT="${UV_HTTP_TIMEOUT:-300}"

say "installing the packages of requirements/project.txt (about 355 MB to download the first time, 1.3 GB on disk)"
free_mb="$(df -Pm . | awk 'NR == 2 { print $4 }')"
[ "${free_mb:-9999}" -ge 3000 ] || say "only $free_mb MB free on this disk: that may not be enough"
# Compiled at once: where PYTHONDONTWRITEBYTECODE is set, as in many containers, every process would compile numpy and
# Blender's scripts again, which doubles the time it takes to start.
.venv/bin/uv --quiet pip sync --python .venv/bin/python --require-hashes --compile-bytecode \
  requirements/uv.txt requirements/project.txt || stop "$registry"
# The sync removes what `make train` and scripts/extra_env.sh added.
rm -f .venv/infrablend-{train,studio,browser,ray,s3,docs}.stamp

# The build back end is among the locked packages, so nothing is fetched unlocked for building.
.venv/bin/uv --quiet pip install --python .venv/bin/python --no-deps --no-build-isolation --offline --editable . ||
  stop "could not install the project itself; the lines above show the reason"
.venv/bin/infrablend --version >/dev/null || stop "the installed command does not start; the lines above show the reason"

# --- Blender ----------------------------------------------------------------------------------------------------
# An environment that was copied or moved with the checkout does not start, and neither does one of other pins.
blender_want="$(printf '%s\n' "$PWD"; cat "$blender")"
blender_want="$(printf '%s' "$blender_want" | sha256sum | cut -d' ' -f1)"
blender_stamp=.venv-blender/infrablend-setup.stamp
if [ "$(cat "$blender_stamp" 2>/dev/null)" != "$blender_want" ] || ! works; then
  say "installing Blender into .venv-blender (about 400 MB to download the first time, 950 MB on disk)"
  rm -rf .venv-blender
  .venv/bin/infrablend blender install --out .venv-blender --python "$python" >/dev/null || stop "$registry"
  printf '%s\n' "$blender_want" >"$blender_stamp"
fi

printf '%s\n' "$want" >"$stamp.new"
mv "$stamp.new" "$stamp"
say "ready: .venv/bin/infrablend"
