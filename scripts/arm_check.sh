#!/usr/bin/env bash
# Runs InfraBlend on Linux for Arm (64 bit), emulated, and compares what it makes with what this machine makes.
#
#     scripts/arm_check.sh [WORK]        WORK holds the emulated system and what it makes [build/arm]
#
# Needs root on Debian or Ubuntu with the packages `debootstrap`, `qemu-user-static` and `binfmt-support`, and 2 GB in
# WORK. Debian for arm64 gets the wheels that requirements/project.txt names by hash, and this project's own wheel. Then
# four recipes make six pictures each, over backgrounds that this machine draws; `check` reads them; and the unit tests of
# compositing, annotation and formats run. Takes about an hour, so `make test` does not run it. Exits with 1 if a label
# differs, or a test fails; pixels that differ are counted.
set -euo pipefail
cd "$(dirname "$0")/.."
project=$PWD
work=$(mkdir -p "${1:-build/arm}" && cd "${1:-build/arm}" && pwd)
system=$work/system
differs=0
recipes="hit-uav-people hit-uav-cars deer-above hit-uav-drone"

for program in debootstrap qemu-aarch64-static; do
  command -v "$program" > /dev/null || { echo "no $program: apt-get install debootstrap qemu-user-static binfmt-support" >&2; exit 3; }
done
[ -e /proc/sys/fs/binfmt_misc/qemu-aarch64 ] || { echo "programs for Arm do not start: update-binfmts --enable qemu-aarch64" >&2; exit 3; }
[ "$(id -u)" = 0 ] || { echo "not root: run it with sudo" >&2; exit 3; }

step() { printf '\n== %s\n' "$*"; }
on_arm() { chroot "$system" /usr/bin/env -i PATH=/usr/bin:/bin:/usr/sbin:/sbin HOME=/root LANG=C.UTF-8 "$@"; }

# Runs a command that may end with 1: a kind of object found no place in these few pictures.
made() { "$@" || [ $? = 1 ]; }

step "Debian for arm64"
if ! [ -e "$work/debian-is-there" ]; then
  rm -rf "$system"
  debootstrap --arch=arm64 --variant=minbase --include=python3,python3-venv bookworm "$system" > "$work/debootstrap.log"
  touch "$work/debian-is-there"
fi
mount -t proc proc "$system/proc"
mount --rbind /dev "$system/dev"
trap 'umount -R "$system/dev"; umount "$system/proc"' EXIT
on_arm uname -m
on_arm python3 --version

step "Wheels"
mkdir -p "$system/wheels"
version=$(on_arm python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])')
# flyr, which reads files for tests of radiometry, has no wheel.
sed '/^flyr==/,/# via/d' requirements/project.txt > "$work/requirements.txt"
.venv/bin/python -m pip download --quiet --dest "$system/wheels" --require-hashes --no-deps --only-binary=:all: \
  --implementation cp --python-version "$version" --platform manylinux_2_34_aarch64 --platform manylinux_2_28_aarch64 \
  --platform manylinux_2_17_aarch64 --platform manylinux2014_aarch64 -r "$work/requirements.txt"
.venv/bin/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir "$system/wheels" "$project"
# Debian's Python 3.11.2 has the filters of tarfile for which pyproject.toml asks for 3.11.4.
on_arm sh -ec 'rm -rf /env; python3 -m venv /env; \
  /env/bin/pip install --quiet --no-index --no-deps --no-compile --ignore-requires-python /wheels/*.whl'
on_arm /env/bin/infrablend --version

step "Backgrounds, drawn here"
rm -rf "$work/world"
.venv/bin/infrablend world --engine lattice --layout hit-uav --count 6 --out "$work/world"
rm -rf "$system/world" && cp -r "$work/world" "$system/world"

for recipe in $recipes; do
  step "$recipe"
  rm -rf "$work/here-$recipe" "$system/runs-$recipe"
  made .venv/bin/infrablend generate "$recipe" --data "$work/world" --out "$work/here-$recipe" --workers 1
  made on_arm /env/bin/infrablend generate "$recipe" --data /world --out "/runs-$recipe" --workers 2
  on_arm /env/bin/infrablend check "/runs-$recipe"
done

step "Comparison"
PYTHONPATH=scripts .venv/bin/python -c "
import sys
from pathlib import Path
from compare_runs import compare
work, *recipes = sys.argv[1:]
equal = [compare(name, Path(work, f'here-{name}'), Path(work, 'system', f'runs-{name}')) for name in recipes]
sys.exit(not all(equal))
" "$work" $recipes || differs=1

step "Unit tests"
rm -rf "$system/project" && mkdir "$system/project"
# Of the working tree, as the wheel.
tar -c --exclude=__pycache__ pyproject.toml src tests docs README.md | tar -x -C "$system/project"
on_arm sh -ec 'cd /project && /env/bin/python -m pytest -q -n 2 -p no:cacheprovider tests/unit/compositing tests/unit/annotation tests/unit/formats'
exit $differs
