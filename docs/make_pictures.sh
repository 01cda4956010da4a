#!/usr/bin/env bash
# Makes every picture of README and docs/ anew, from the release binary. Needs ImageMagick's `montage` and `convert`.
set -euo pipefail
cd "$(dirname "$0")/.."
catoptra=${CATOPTRA:-target/release/catoptra}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
pictures=docs/pictures
mkdir -p $pictures
# The real ImageMagick, wherever it stands in PATH.
im() { env PATH="/usr/bin:$PATH" "$@"; }

# README: the five scenes at 512x512, shrunk from 1024x1024.
"$catoptra" render all --frame 30 --size 1024x1024 --raster cpu --out "$out/full" >/dev/null
for scene in rolling-box rolling-box-donut two-spheres rolling-box-venus rolling-box-sponza; do
    im convert "$out/full/$scene-0030.png" -filter Box -resize 50% -strip -define png:compression-level=9 "$pictures/$scene.png"
    # docs/scenes.md: final against direct light only, and the animation, as the thesis's figures 5.2 to 5.6.
    "$catoptra" render $scene --frame 30 --size 512x512 --raster cpu --layer direct --out "$out/direct" >/dev/null
    im montage "$out/full/$scene-0030.png" "$out/direct/$scene-direct-0030.png" -filter Box -resize 320x320 \
        -tile 2x1 -geometry +2+2 -depth 8 -strip "$pictures/$scene-final-direct.png"
    frames=()
    for k in 0 30 60 90 120 150; do
        "$catoptra" render $scene --frame $k --size 384x384 --raster cpu --out "$out/frames" >/dev/null
        frames+=("$out/frames/$scene-$(printf %04d $k).png")
    done
    im montage "${frames[@]}" -filter Box -resize 192x192 -tile 3x2 -geometry +2+2 -depth 8 -strip "$pictures/$scene-frames.png"
done

# README: what each stage adds to one scene.
scene=two-spheres
layers=(depth normal albedo mask moments direct indirect traced)
strip=()
for layer in "${layers[@]}"; do
    "$catoptra" render $scene --frame 30 --size 512x512 --raster cpu --layer $layer --out "$out/layers" >/dev/null
    strip+=(-label "$layer" "$out/layers/$scene-$layer-0030.png")
done
strip+=(-label final "$out/full/$scene-0030.png")
im montage "${strip[@]}" -filter Box -resize 200x200 -tile 3x3 -geometry +3+3 -depth 8 -strip "$pictures/stages.png"

for f in $pictures/*.png; do
    size=$(stat -c %s "$f")
    [ "$size" -le 307200 ] || { echo "$f is $size bytes, over 300 KiB"; exit 1; }
done
