#!/usr/bin/env bash
# The table of docs/vpl-convergence.md: VPLs with traced visibility against the path tracer of the same bounces.
# usage: docs/vpl_convergence.sh [path of catoptra]   (default: target/release/catoptra, built if it is missing)
set -euo pipefail
cd "$(dirname "$0")/.."
catoptra=${1:-target/release/catoptra}
[ -x "$catoptra" ] || cargo build --release -q
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
what=(rolling-box --frame 30 --size 48x48)
seeds="1 2 3 4 5 6 7 8"

for seed in 101 102; do
    "$catoptra" reference "${what[@]}" --spp 8192 --bounces 2 --seed $seed --out "$out/reference-$seed.exr" >/dev/null
done
figure() { sed -E "s/.*$1=([^ ]+).*/\1/"; }
median() { sort -g | awk '{v[NR]=$1} END {printf "%.2e", (v[int((NR+1)/2)]+v[int(NR/2)+1])/2}'; }

noise=$("$catoptra" compare "$out/reference-101.exr" "$out/reference-102.exr")
echo "two references of 8,192 samples: relMSE $(figure relmse <<<"$noise"), FLIP $(figure flip_mean <<<"$noise")"
echo
echo "| VPLs | relMSE, no bound | FLIP mean | relMSE, bound 200 | FLIP mean | relMSE, bound 20 | FLIP mean |"
echo "|---|---|---|---|---|---|---|"
for n in 64 256 1024 4096 16384; do
    row="| $n |"
    for bound in off 200 20; do
        : >"$out/figures"
        for seed in $seeds; do
            "$catoptra" render "${what[@]}" --raster cpu --shadows traced --shadow-samples 1024 --vpls $n --bounces 2 \
                --vpl-shadows traced --vpl-bound $bound --seed "$seed" --format exr --out "$out/$seed" >/dev/null
            "$catoptra" compare "$out/$seed"/*.exr "$out/reference-101.exr" >>"$out/figures"
        done
        row+=" $(figure relmse <"$out/figures" | median) | $(figure flip_mean <"$out/figures" | median) |"
    done
    echo "$row"
done
