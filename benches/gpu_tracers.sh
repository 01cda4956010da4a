#!/bin/sh
# The table of docs/gpu-tracer.md: the tracers over one raster lane, five scenes, software Vulkan or a real GPU.
# Usage: [SIZE=512x512] [FRAMES=8] [ROUNDS=2] benches/gpu_tracers.sh [CATOPTRA]
# Rounds go through the tracers in turn; of the shortest frame and the shortest layer the least of all rounds is printed, of
# processor time the mean of all.
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
        "$catoptra" bench all --size "$size" --frames "$frames" --raster gpu --tracer "$tracer" --stages \
            --json "$folder/$tracer.$round.json" > /dev/null
    done
done
python3 - "$folder" <<'PY'
import glob, json, sys

rows = {}
for path in sorted(glob.glob(sys.argv[1] + "/*.json")):
    for s in json.load(open(path))["scenes"]:
        rows.setdefault((s["scene"], s["tracer"]), []).append(s)

def least(runs, key, part):
    return min(r[key][part] for r in runs)

print("| scene | tracer | frame, ms | processors, ms | layer, ms | rays a frame: reflection, refraction | Mray/s of the layer: reflection, refraction |")
print("|---|---|---|---|---|---|---|")
counts = {}
for (scene, tracer), runs in sorted(rows.items(), key=lambda r: (r[0][0], "cpu gpu gpu-fragment".split().index(r[0][1]))):
    layer = least(runs, "stages_least_ms", "traced")
    rays = [runs[0]["rays"][k] for k in ("reflection", "refraction")]
    # The fragment pass cannot count: its rays are those of the compute pass.
    counts[scene] = rays if sum(rays) else counts.get(scene, rays)
    rays = counts[scene]
    rate = ", ".join(f"{n / layer / 1e3:.3g}" for n in rays) if layer > 0 and sum(rays) else ""
    processors = [r["processor_ms"] for r in runs if r["processor_ms"] is not None]
    mean = f"{sum(processors) / len(processors):.0f}" if processors else ""
    print(f"| {scene} | {tracer} | {least(runs, 'frame_ms', 'least'):.0f} | {mean} | {layer:.1f} | {rays[0]:,}, {rays[1]:,} | {rate} |")
PY
