#!/usr/bin/env bash
# Adds an extra to .venv: `studio` (NiceGUI), `ray`, `s3` or `docs` (MkDocs). With `browser`, what the tests of the studio need: Playwright, and
# Debian's Chromium if packages can be installed here; the tests are skipped without it.
# A second run does nothing until a requirement file changes.
set -euo pipefail
cd "$(dirname "$0")/.."

what="${1:-studio}"
say() { printf '%s: %s\n' "$what" "$*" >&2; }
stop() { say "$*"; exit 1; }
case "$what" in
  studio) module=nicegui title="NiceGUI (about 30 MB to download)" ;;
  browser) module=playwright title="Playwright for tests (about 50 MB to download)" ;;
  ray) module=ray title="Ray (about 75 MB to download)" ;;
  s3) module=s3fs title="s3fs, and an S3 server for tests (about 30 MB to download)" ;;
  docs) module=mkdocstrings title="MkDocs, its theme and mkdocstrings (about 15 MB to download)" ;;
  *) stop "unknown argument; expected studio, browser, ray, s3 or docs" ;;
esac

mkdir -p build
if command -v flock >/dev/null; then exec 9>build/.setup.lock; flock 9; fi

if [ "$what" = browser ] && ! command -v chromium >/dev/null; then
  line="apt-get install -y --no-install-recommends chromium"
  if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    say "no Chromium here: the tests of the studio's pages will be skipped. To run them: sudo $line"
  else
    say "installing Chromium for the tests of the studio's pages (about 90 MB to download)"
    log=build/apt-chromium.log
    # shellcheck disable=SC2086
    if ! DEBIAN_FRONTEND=noninteractive $line >"$log" 2>&1; then
      apt-get update >>"$log" 2>&1 || true
      # shellcheck disable=SC2086
      DEBIAN_FRONTEND=noninteractive $line >>"$log" 2>&1 ||
        say "Chromium could not be installed (see $log): the tests of the studio's pages will be skipped"
    fi
  fi
fi

inputs=(requirements/project.txt "requirements/$what.txt" scripts/extra_env.sh)
want="$(printf '%s\n' "$PWD"; cat "${inputs[@]}")"
want="$(printf '%s' "$want" | sha256sum | cut -d' ' -f1)"
stamp=.venv/infrablend-$what.stamp
if [ "$(cat "$stamp" 2>/dev/null)" = "$want" ]; then exit 0; fi

say "installing $title into .venv"
log=build/$what-env.log
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --only-binary :all: \
  -r "requirements/$what.txt" >"$log" 2>&1 || {
  tail -n 5 "$log" >&2
  stop "the package registry could not be used, or its files differ from the locked ones: check the network and pip's
$what: settings and run the same command again"
}
.venv/bin/python -W ignore -c "import $module" >/dev/null || stop "$module does not import; the lines above show why"

printf '%s\n' "$want" >"$stamp.new"
mv "$stamp.new" "$stamp"
say "ready"
