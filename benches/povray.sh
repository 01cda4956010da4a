#!/bin/sh
# Direct light and mirrors only, 1024x1024, two threads: POV-Ray's trace time beside ours, in one run on one machine.
# Usage: benches/povray.sh [CATOPTRA]   (Debian: apt-get install povray)
set -eu
catoptra=${1:-target/release/catoptra}
here=$(dirname "$0")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for scene in two-spheres rolling-box-venus; do
    "$catoptra" export "$scene" --frame 30 "$work/$scene.glb" >/dev/null
    python3 "$here/povray_scene.py" "$work/$scene.glb" "$work/$scene.pov"
    for run in 1 2 3; do
        povray +I"$work/$scene.pov" +O"$work/$scene.png" +W1024 +H1024 +WT2 -A -D +Q9 2>&1 |
            sed -n "s/^ *Trace Time: */$scene: POV-Ray /p"
    done
    # One shadow ray a light, as POV-Ray's point lights have.
    "$catoptra" bench "$scene" --frames 10 --size 1024x1024 --raster cpu --threads 2 --no-indirect --shadows traced \
        --shadow-samples 1
    if [ -n "${KEEP:-}" ]; then cp "$work/$scene.png" "$KEEP/"; fi
done
