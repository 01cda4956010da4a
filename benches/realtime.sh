#!/bin/sh
# The tables of docs/realtime.md: the five scenes, time against VPLs, triangles, pixels and threads. CPU lane, two threads.
# Usage: benches/realtime.sh [CATOPTRA [FOLDER_OF_STATUES]]
set -eu
catoptra=${1:-target/release/catoptra}
statues=${2:-../shared/assets/venus}
frames=${FRAMES:-20}
bench() {
    "$catoptra" bench "$@" --frames "$frames" --raster cpu | sed -n 's/^\([^:]*\): \([0-9.]*\) ms a frame.*/\1 \2 ms/p'
}
"$catoptra" info
echo "# five scenes, 1024x1024"
bench all --size 1024x1024 --threads 2
echo "# VPLs: rolling-box"
for n in 16 32 64 128 256 512 1024; do printf '%s VPLs: ' "$n"; bench rolling-box --size 1024x1024 --threads 2 --vpls "$n"; done
echo "# triangles: rolling-box-venus"
for statue in "$statues"/*.glb; do
    [ -e "$statue" ] || continue
    printf '%s: ' "$(basename "$statue")"
    bench rolling-box-venus --size 1024x1024 --threads 2 --statue "$statue"
done
echo "# pixels"
for size in 512x512 512x1024 1024x1024 1024x2048 2048x2048; do
    printf '%s: ' "$size"
    bench rolling-box --size "$size" --threads 2
done
echo "# threads: one run of two threads, then two runs of one thread side by side"
bench rolling-box --size 1024x1024 --threads 2
bench rolling-box --size 1024x1024 --threads 1 &
bench rolling-box --size 1024x1024 --threads 1
wait
