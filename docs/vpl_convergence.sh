#!/usr/bin/env bash
# The table of docs/vpl-convergence.md: VPLs with traced visibility against the path-traced reference of the same bounces.
set -euo pipefail
cd "$(dirname "$0")/.."
catoptra=${CATOPTRA:-target/release/catoptra}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
scene=rolling-box; frame=30; size=96x96; bounces=2
"$catoptra" reference $scene --frame $frame --size $size --bounces $bounces --spp "${SPP:-4096}" --out "$out/truth.exr" >/dev/null 2>&1
relmse() { # options of render
    "$catoptra" render $scene --frame $frame --size $size --raster cpu --shadows traced --shadow-samples 256 --format exr \
        --bounces $bounces --out "$out" "$@" >/dev/null 2>&1
    "$catoptra" compare "$out/$scene-00$frame.exr" "$out/truth.exr" | grep -oE 'relmse=[^ ]+' | cut -d= -f2
}
echo "| VPLs | relMSE, bound off | relMSE, bound 20 |"
echo "|---|---|---|"
for n in 64 256 1024 4096 16384; do
    off=$(relmse --vpls $n --vpl-shadows traced --vpl-bound off)
    bound=$(relmse --vpls $n --vpl-shadows traced)
    echo "| $n | $off | $bound |"
done
