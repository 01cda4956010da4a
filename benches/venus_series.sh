#!/usr/bin/env bash
# The thesis's table 5.1: time of the traced layer of room, rolling box and mirror statue against the statue's triangles, for
# both kinds of tree. Median of 5 interleaved runs of some frames each.
#   benches/venus_series.sh FOLDER_OF_venus_N.glb [SIDE]
set -euo pipefail
folder=${1:?usage: venus_series.sh FOLDER [SIDE]}
side=${2:-512}
binary=${CATOPTRA:-target/release/catoptra}
traced() { # file, tree -> milliseconds of the traced layer
    "$binary" bench rolling-box-venus --statue "$1" --blas "$2" --size "${side}x$side" --frames 5 --raster cpu --json |
        sed -nE 's/.*"traced": ([0-9.]+).*/\1/p'
}
median() { sort -g | awk '{a[NR]=$1} END {print a[int((NR+1)/2)]}'; }
sizes="640 1582 3152 6292 12570 18846 25124 31402"
table=$(mktemp)
for _ in 1 2 3 4 5; do
    for n in $sizes; do
        for tree in bvh kdtree; do
            echo "$n $tree $(traced "$folder/venus_$n.glb" $tree)" >>"$table"
        done
    done
done
echo "| triangles of the statue | BVH, ms | kd-tree, ms |"
echo "|---|---|---|"
for n in $sizes; do
    echo "| $n | $(awk -v n="$n" '$1==n && $2=="bvh" {print $3}' "$table" | median) | $(awk -v n="$n" '$1==n && $2=="kdtree" {print $3}' "$table" | median) |"
done
rm -f "$table"
