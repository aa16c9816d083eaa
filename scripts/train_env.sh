#!/usr/bin/env bash
# Adds what training needs to .venv: Ultralytics (AGPL-3.0, no part of InfraBlend), YOLOX and torch, the extras `train`
# and `train-yolox`.
# A second run does nothing until a requirement file changes. Needs .venv (make setup).
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'train: %s\n' "$*" >&2; }
stop() { say "$*"; exit 1; }

mkdir -p build
if command -v flock >/dev/null; then exec 9>build/.setup.lock; flock 9; fi

inputs=(requirements/{project,train,torch,torch-cpu}.txt requirements/torchvision-stand-in/{pyproject.toml,torchvision/*.py}
  scripts/train_env.sh)
want="$(printf '%s\n' "$PWD"; cat "${inputs[@]}")"
want="$(printf '%s' "$want" | sha256sum | cut -d' ' -f1)"
stamp=.venv/infrablend-train.stamp
if [ "$(cat "$stamp" 2>/dev/null)" = "$want" ]; then exit 0; fi

say "installing Ultralytics and torch into .venv. To download: about 270 MB (1.1 GB on disk) if pip's settings lead to the
train: CPU build of torch (PIP_FIND_LINKS or a mirror that has it); otherwise on Linux about 2.7 GB (4.5 GB on disk),
train: because the registry's own build includes CUDA. To skip this: make test ALL=1 TOOLS=0"

registry="the package registry could not be used, or its files differ from the locked ones: check the network and pip's
train: settings and run the same command again, or skip this: make test ALL=1 TOOLS=0"
# pip instead of uv, because pip's settings may select the small build of torch.
install=(.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes
  --only-binary :all:)
log=build/train-env.log
"${install[@]}" -r requirements/train.txt >"$log" 2>&1 || { tail -n 5 "$log" >&2; stop "$registry"; }
if ! "${install[@]}" -r requirements/torch-cpu.txt >>"$log" 2>&1 || ! .venv/bin/python -W ignore -c 'import torch' 2>>"$log"
then
  say "no CPU build of torch is available (see $log): installing the registry's default build"
  "${install[@]}" -r requirements/torch.txt >>"$log" 2>&1 || { tail -n 5 "$log" >&2; stop "$registry"; }
fi
# pixeltable-yolox 0.4.3 names a plugin of mkdocstrings that it does not contain, which would end `make docs`.
sed -i.bak '/^\[mkdocstrings/,/^$/d' .venv/lib/python*/site-packages/pixeltable_yolox-*.dist-info/entry_points.txt
# Ultralytics and its `yolo` import torchvision. The registry has no CPU build of it for Linux, and the CUDA one does not
# work with torch's CPU build; the stand-in has the one operator that detection needs.
if ! .venv/bin/python -W ignore -c 'import torchvision' 2>>"$log"; then
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-index --no-build-isolation \
    --force-reinstall requirements/torchvision-stand-in >>"$log" 2>&1 || { tail -n 5 "$log" >&2; stop "$registry"; }
fi
YOLO_CONFIG_DIR="$PWD/build" .venv/bin/python -W ignore -c 'import torch, torchvision, ultralytics' >/dev/null ||
  stop "torch, torchvision or Ultralytics does not import; the lines above show why"

printf '%s\n' "$want" >"$stamp.new"
mv "$stamp.new" "$stamp"
say "ready: infrablend train"
