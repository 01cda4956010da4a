#!/bin/sh
# The table of docs/gpu-tracer.md: the tracers over one raster lane, five scenes, software Vulkan or a real GPU.
# Usage: [SIZE=512x512] [FRAMES=8] [ROUNDS=2] benches/gpu_tracers.sh [CATOPTRA]
# Rounds go through the tracers in turn, with the layer and without (rays below an absurd weight end). Of the shortest frame and
# layer by the clock the least of all rounds is printed; of processor time, which other programs move less, the mean of all, and
# for the layer what it adds to a frame without. On a real GPU only the clock tells.
set -eu
catoptra=${1:-target/release/catoptra}
size=${SIZE:-512x512}
frames=${FRAMES:-8}
rounds=${ROUNDS:-2}
folder=$(mktemp -d)
trap 'rm -r "$folder"' EXIT
"$catoptra" info
for round in $(seq "$rounds"); do
    for tracer in cpu gpu gpu-fragment; do
        for weight in '' '--min-weight 1e9'; do
            # shellcheck disable=SC2086
            "$catoptra" bench all --size "$size" --frames "$frames" --raster gpu --tracer "$tracer" --stages $weight \
                --json "$folder/${weight:+without.}$tracer.$round.json" > /dev/null
        done
    done
done
python3 - "$folder" <<'PY'
import glob, json, os, sys

runs = {False: {}, True: {}}
for path in sorted(glob.glob(sys.argv[1] + "/*.json")):
    without = os.path.basename(path).startswith("without.")
    for s in json.load(open(path))["scenes"]:
        runs[without].setdefault((s["scene"], s["tracer"]), []).append(s)

def processors(of):
    times = [r["processor_ms"] for r in of]
    return sum(times) / len(times) if None not in times else None

print("| scene | tracer | processor ms: frame | layer | Mray a processor's second: reflection, refraction | wall ms: frame | layer |")
print("|---|---|---|---|---|---|---|")
order = "cpu gpu gpu-fragment rayquery".split()
rays = {}
for scene, tracer in sorted(runs[False], key=lambda k: (k[0], order.index(k[1]))):
    own = runs[False][scene, tracer]
    frame, base = processors(own), processors(runs[True][scene, tracer])
    layer = frame - base if None not in (frame, base) else None
    # The fragment pass cannot count: its rays are those of the pass before it.
    counted = [own[0]["rays"][k] for k in ("reflection", "refraction")]
    rays[scene] = counted if sum(counted) else rays.get(scene, counted)
    # Less than the clock of processor time can tell is nothing.
    told = layer is not None and layer > 5 and sum(rays[scene]) > 0
    rate = ", ".join(f"{n / layer / 1e3:.2g}" for n in rays[scene]) if told else ""
    ms = lambda v: "" if v is None else f"{v:.0f}"
    wall = [min(r["frame_ms"]["least"] for r in own), min(r["stages_least_ms"]["traced"] for r in own)]
    print(f"| {scene} | {tracer} | {ms(frame)} | {ms(layer)} | {rate} | {ms(wall[0])} | {ms(wall[1])} |")
PY
