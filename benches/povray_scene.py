#!/usr/bin/env python3
"""Turns a GLB that `catoptra export` wrote into a scene for POV-Ray: the same triangles with their normals, mirrors, glass,
lights and camera; direct light only. Materials' colours are one a mesh (vertex colours of the first vertex).

    povray_scene.py SCENE.glb SCENE.pov
"""

import json
import struct
import sys

KINDS = {5121: ("B", 1), 5123: ("H", 2), 5125: ("I", 4), 5126: ("f", 4)}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def load(path):
    data = open(path, "rb").read()
    length, = struct.unpack_from("<I", data, 12)
    gltf = json.loads(data[20 : 20 + length])
    return gltf, data[20 + length + 8 :]


def accessor(gltf, blob, index):
    a = gltf["accessors"][index]
    view = gltf["bufferViews"][a["bufferView"]]
    kind, size = KINDS[a["componentType"]]
    width = WIDTHS[a["type"]]
    stride = view.get("byteStride", size * width)
    start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
    return [struct.unpack_from(f"<{width}{kind}", blob, start + i * stride) for i in range(a["count"])]


def local(node):
    if "matrix" in node:
        m = node["matrix"]
        return [[m[4 * c + r] for c in range(4)] for r in range(4)]
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    s, t = node.get("scale", [1, 1, 1]), node.get("translation", [0, 0, 0])
    r = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return [[r[i][j] * s[j] for j in range(3)] + [t[i]] for i in range(3)] + [[0, 0, 0, 1]]


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def point(m, p, w=1):
    return [sum(m[i][k] * p[k] for k in range(3)) + m[i][3] * w for i in range(3)]


def vec(v):
    return "<" + ",".join(f"{x:.9g}" for x in v) + ">"


def material(gltf, index, tint):
    m = gltf.get("materials", [{}])[index] if index is not None else {}
    pbr = m.get("pbrMetallicRoughness", {})
    base = [c * t for c, t in zip(pbr.get("baseColorFactor", [1, 1, 1, 1])[:3], tint)]
    extensions = m.get("extensions", {})
    glass = extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0)
    mirror = pbr.get("metallicFactor", 1) if pbr.get("roughnessFactor", 1) == 0 else 0
    if glass > 0:
        ior = extensions.get("KHR_materials_ior", {}).get("ior", 1.5)
        return (
            f"texture {{ pigment {{ rgb {vec(base)} transmit {glass:g} }} finish {{ ambient 0 diffuse {1 - glass:g} "
            f"reflection {{ 0, 1 fresnel on }} conserve_energy }} }} interior {{ ior {ior:g} }}"
        )
    diffuse = (1 - mirror) * 1.0
    reflection = vec([c * mirror for c in base])
    return f"texture {{ pigment {{ rgb {vec(base)} }} finish {{ ambient 0 diffuse {diffuse:g} reflection {reflection} }} }}"


def main(source, target):
    gltf, blob = load(source)
    out = ["#version 3.7;", "global_settings { assumed_gamma 1 max_trace_level 8 adc_bailout 1/512 }"]

    def visit(index, parent):
        node = gltf["nodes"][index]
        m = times(parent, local(node))
        if "mesh" in node:
            for p in gltf["meshes"][node["mesh"]]["primitives"]:
                mesh(p, m)
        light = node.get("extensions", {}).get("KHR_lights_punctual")
        if light:
            lamp(gltf["extensions"]["KHR_lights_punctual"]["lights"][light["light"]], m)
        if "camera" in node:
            camera(gltf["cameras"][node["camera"]], m)
        for child in node.get("children", []):
            visit(child, m)

    def mesh(p, m):
        positions = [point(m, v) for v in accessor(gltf, blob, p["attributes"]["POSITION"])]
        # Rigid and evenly scaled bodies: normals turn like points.
        normals = [point(m, v, 0) for v in accessor(gltf, blob, p["attributes"]["NORMAL"])]
        numbers = [v[0] for v in accessor(gltf, blob, p["indices"])]
        faces = [numbers[i : i + 3] for i in range(0, len(numbers), 3)]
        # One texture for each colour that vertices have.
        colors = [(1.0, 1.0, 1.0)] * len(positions)
        if "COLOR_0" in p["attributes"]:
            colors = [c[:3] for c in accessor(gltf, blob, p["attributes"]["COLOR_0"])]
        for color in sorted(set(colors)):
            own = [f for f in faces if colors[f[0]] == color]
            out.append(f"mesh2 {{ vertex_vectors {{ {len(positions)}, {','.join(map(vec, positions))} }}")
            out.append(f"normal_vectors {{ {len(normals)}, {','.join(map(vec, normals))} }}")
            out.append(f"face_indices {{ {len(own)}, {','.join(map(vec, own))} }}")
            out.append(f"inside_vector y {material(gltf, p.get('material'), color)} }}")

    def lamp(light, m):
        at = point(m, (0, 0, 0))
        towards = point(m, (0, 0, -1))
        # POV-Ray's fade gives 2/(1 + d²/f²): with a small f that is 2f²/d².
        fade = 0.01
        color = [c * light.get("intensity", 1) / (2 * fade * fade) / 3.14159265 for c in light.get("color", [1, 1, 1])]
        cone = ""
        if light["type"] == "spot":
            s = light.get("spot", {})
            inner, outer = (s.get(k, d) * 180 / 3.14159265 for k, d in [("innerConeAngle", 0), ("outerConeAngle", 0.785)])
            cone = f" spotlight point_at {vec(towards)} radius {inner:g} falloff {outer:g}"
        out.append(f"light_source {{ {vec(at)} rgb {vec(color)}{cone} fade_distance {fade} fade_power 2 }}")

    def camera(c, m):
        # POV-Ray's space is left-handed: x to the left mends it.
        eye, right, up, ahead = (point(m, p, w) for p, w in [((0, 0, 0), 1), ((1, 0, 0), 0), ((0, 1, 0), 0), ((0, 0, -1), 0)])
        half = 2.0 * __import__("math").tan(c["perspective"]["yfov"] / 2)
        out.append(
            f"camera {{ perspective location {vec(eye)} direction {vec(ahead)} up {vec([half * u for u in up])} "
            f"right {vec([half * r for r in right])} }}"
        )

    scene = gltf["scenes"][gltf.get("scene", 0)]
    identity = [[float(i == j) for j in range(4)] for i in range(4)]
    for index in scene["nodes"]:
        visit(index, identity)
    open(target, "w").write("\n".join(out) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:3])
