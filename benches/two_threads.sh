#!/usr/bin/env bash
# How well two threads share one frame: frames a second of one run on two threads against the sum of two runs on one thread
# each, side by side, each on its own processor. Interleaved, median of REPS (9).
#   benches/two_threads.sh [traced|render_total] [SIDE]
set -euo pipefail
stage=${1:-traced}
side=${2:-512}
binary=${CATOPTRA:-target/release/catoptra}
frames=${FRAMES:-8}
time_of() { # processors, threads, scene -> milliseconds of the stage
    taskset -c "$1" "$binary" bench "$3" --size "${side}x$side" --frames "$frames" --raster cpu --threads "$2" --json |
        sed -nE "s/.*\"$stage\": ([0-9.]+).*/\1/p"
}
median() { sort -g | awk '{a[NR]=$1} END {print a[int((NR+1)/2)]}'; }
echo "| scene | $stage on two threads, ms | two alone, ms each | efficiency |"
echo "|---|---|---|---|"
for scene in rolling-box rolling-box-donut two-spheres rolling-box-venus rolling-box-sponza; do
    table=$(mktemp)
    for _ in $(seq "${REPS:-9}"); do
        both=$(time_of 0,1 2 "$scene")
        time_of 0 1 "$scene" >"$table.a" &
        b=$(time_of 1 1 "$scene")
        wait
        a=$(cat "$table.a")
        # Rate of the pair: 1/a + 1/b frames a millisecond.
        awk -v t="$both" -v a="$a" -v b="$b" 'BEGIN {print t, 2 / (1 / a + 1 / b), (1 / t) / (1 / a + 1 / b)}' >>"$table"
    done
    echo "| $scene | $(cut -d' ' -f1 "$table" | median) | $(cut -d' ' -f2 "$table" | median) | $(cut -d' ' -f3 "$table" | median) |"
    rm -f "$table" "$table.a"
done
