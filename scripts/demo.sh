#!/usr/bin/env bash
# A small example of the main task: a virtual thermal world in HIT-UAV's layout, drones rendered into it, a contact sheet.
# All output is in build/demo; the last line printed is the path of the sheet.
# DEMO_IMAGES and DEMO_NAME (a folder in build/) change the size and the place.
set -euo pipefail
cd "$(dirname "$0")/.."

out="build/$(basename "${DEMO_NAME:-demo}")"
sheet="$out/contact_sheet.png"
infrablend=.venv/bin/infrablend
# A demo starts from an empty folder; only this script uses it.
rm -rf "$out"
mkdir -p "$out"

step() { printf '\n== %s\n' "$*"; }

step "a virtual thermal world: backgrounds with exact labels, no download"
"$infrablend" world --out "$out/world" --count "${DEMO_IMAGES:-12}" --seed 0

step "drones into it, as the paper does for HIT-UAV-drone"
"$infrablend" generate hit-uav-drone --data "$out/world" --out "$out/run" --seed 0

step "a contact sheet with boxes, oriented boxes and masks"
"$infrablend" preview "$out/run" --out "$sheet" >/dev/null

[ -s "$sheet" ] || { printf 'demo: %s was not written\n' "$sheet" >&2; exit 1; }
printf '%s\n' "$sheet"
