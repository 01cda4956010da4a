//! The words of the heaps: WGSL reads each field where Rust wrote it. Every field of this scene has a value of its own, and
//! comes back bit for bit.

use catoptra_engine::{
    Instance, Light, LightKind, Material, Mesh, MeshData, Mip, Physical, RenderScene, TextureRef, Wrap,
    glam::{Affine3, Vec2, Vec3, Vec4},
};
use catoptra_render_hybrid::{BlasKind, raster::testing::SceneProbe, twin::shadow::ShadowPlan};
use std::sync::Arc;

use super::{Allowed, Random, Verdict, followed, probe, scenes};

/// Numbers that the GPU reads by `body` at `x[0]`, against `expected` of each row.
fn reads<const M: usize>(held: &SceneProbe, what: &str, body: &str, expected: &[[f32; M]], fault: (&str, &str)) {
    let rows: Vec<[f32; 1]> = (0..expected.len()).map(|i| [i as f32]).collect();
    let judge = |edits: &[(&str, &str)]| {
        let gpu: Vec<[f32; M]> = held.evaluate(edits, body, &rows).unwrap();
        Verdict::of(&[(what, M)], &gpu, |row| expected[row].map(Allowed::exactly))
    };
    judge(&[]).agrees(what);
    judge(&[fault]).fails(what, fault.1);
}

fn texture_ref(r: &mut Random, k: usize, textures: usize) -> TextureRef {
    let wraps = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];
    TextureRef {
        texture: ((3 * k + 1) % textures) as u32,
        wrap: [wraps[k % 3], wraps[(k + 1) % 3]],
        nearest: k % 2 == 0,
        nearest_min: k % 3 == 0,
        mip: [Mip::None, Mip::Nearest, Mip::Linear][k % 3],
        uv_set: (k / 2 % 2) as u32,
        uv_transform: [r.vec().to_array(), r.vec().to_array()],
    }
}

/// Every field has a value of its own.
fn scene() -> RenderScene {
    let mut r = Random(11);
    let mut s = RenderScene { textures: scenes::textures(&mut r), ..RenderScene::default() };
    let textures = s.textures.len();
    let mut number = 0;
    let mut next = |r: &mut Random| {
        number += 1;
        Some(texture_ref(r, number, textures))
    };
    for n in 0..6 {
        let physical = Physical {
            metallic: r.unit(),
            roughness: r.unit(),
            metallic_roughness_texture: next(&mut r),
            reflectance: r.color(),
            reflectance_texture: next(&mut r),
            reflectance_strength_texture: next(&mut r),
            by_reflectance: n % 2 == 0,
            transmission: r.unit(),
            transmission_texture: next(&mut r),
            blended: n % 3 == 0,
        };
        s.materials.push(Material {
            base_color_texture: next(&mut r),
            emissive_texture: next(&mut r),
            normal_texture: next(&mut r),
            alpha_cutoff: if n % 3 == 2 { 0.0 } else { r.unit() },
            physical: Some(physical),
            attenuation_distance: if n == 0 { f32::INFINITY } else { r.unit() + 0.1 },
            thin: n % 2 == 1,
            schlick: n % 3 == 1,
            unlit: n % 4 == 1,
            priority: n - 3,
            ..scenes::material(&mut r, textures, 0.0)
        });
    }
    for n in 0..3 {
        let mut data = MeshData::default();
        for _ in 0..9 + 3 * n {
            data.positions.push(r.vec());
            data.normals.push(r.direction());
            data.uvs.push(Vec2::new(r.unit(), r.unit()));
            data.uvs1.push(Vec2::new(r.unit(), r.unit()));
            data.colors.push(r.color().extend(r.unit()));
            data.tangents.push(r.direction().extend(1.0));
        }
        data.triangles = (0..3 + n).map(|t| [3 * t, 3 * t + 2, 3 * t + 1]).collect();
        s.meshes.push(Arc::new(Mesh::new(data).unwrap()));
    }
    s.meshes.push(Arc::new(scenes::tetrahedron()));
    for n in 0..12 {
        s.instances.push(Instance {
            stable_id: n as u64,
            mesh: n % 4,
            material: (5 * n + 2) % 6,
            world_from_object: Affine3 {
                matrix3: scenes::transforms()[n as usize % 8].matrix3,
                translation: if n == 0 { Vec3::ZERO } else { r.vec() * 9.0 },
            },
        });
    }
    let kinds = [LightKind::Point, LightKind::Spot { cos_inner: 0.9, cos_outer: 0.7 }, LightKind::Directional];
    for (n, kind) in kinds.into_iter().cycle().take(5).enumerate() {
        let direction_world = r.direction();
        s.lights.push(Light {
            stable_id: n as u64,
            kind,
            position_world: r.vec() * 5.0,
            direction_world,
            up_world: direction_world.any_orthonormal_vector(),
            intensity: r.color() * 9.0,
            radius: r.unit(),
        });
    }
    s
}

/// `y[at..at + 3] = e`, and so on from one place to the next.
fn assign(fields: &[(&str, usize)]) -> String {
    let (mut out, mut at) = (String::new(), 0);
    for (k, (field, count)) in fields.iter().enumerate() {
        out.push_str(&format!("let f{k} = {field};\n"));
        for c in 0..*count {
            let part = if *count == 1 { String::new() } else { format!("[{c}]") };
            out.push_str(&format!("y[{at}] = f32(f{k}{part});\n"));
            at += 1;
        }
    }
    out
}

fn row<const M: usize>(parts: &[&[f32]]) -> [f32; M] {
    parts.concat().try_into().unwrap()
}

fn flag(on: bool) -> f32 {
    f32::from(u8::from(on))
}

#[test]
fn instances_and_vertices() {
    let Some(probe) = probe() else { return };
    let s = scene();
    let held = probe.hold(&s, &followed(&s, BlasKind::Bvh)).unwrap();
    let body = assign(&[
        ("read_instance(u32(x[0])).world_row0", 4),
        ("read_instance(u32(x[0])).world_row1", 4),
        ("read_instance(u32(x[0])).world_row2", 4),
        ("read_instance(u32(x[0])).material", 1),
        ("(material_at(u32(x[0])) - head.materials) / MATERIAL_WORDS", 1),
        ("(dynamic_word(instance_at(u32(x[0])) + 3u).w & INSTANCE_CLOSED) / INSTANCE_CLOSED", 1),
        ("(dynamic_word(instance_at(u32(x[0])) + 3u).w & INSTANCE_CUTOUT) / INSTANCE_CUTOUT", 1),
        ("(dynamic_word(instance_at(u32(x[0])) + 3u).w & INSTANCE_CASTS_SHADOW) / INSTANCE_CASTS_SHADOW", 1),
        ("(dynamic_word(instance_at(u32(x[0])) + 3u).w & INSTANCE_IDENTITY) / INSTANCE_IDENTITY", 1),
    ]);
    let expected: Vec<[f32; 18]> = s
        .instances
        .iter()
        .map(|i| {
            let (m, t) = (i.world_from_object.matrix3, i.world_from_object.translation);
            let rows = [0, 1, 2].map(|k| m.row(k).extend(t[k]).to_array());
            let closed = s.meshes[i.mesh as usize].closed();
            let cutout = s.materials[i.material as usize].is_cutout();
            let identity = i.world_from_object == Affine3::IDENTITY;
            let n = i.material as f32;
            row(&[&rows[0], &rows[1], &rows[2], &[n, n, flag(closed), flag(cutout), 1.0, flag(identity)]])
        })
        .collect();
    reads(&held, "instances", &body, &expected, ("dynamic_word(i + 5u)", "dynamic_word(i + 4u)"));

    // Vertices by the triangles that name them: each instance's second triangle.
    let interpolated = |vertex: &str, word: &str| format!("bitcast<vec4f>(geometry_word(v.{vertex} + {word}))");
    let corner: Vec<(String, usize)> = ["x", "y", "z"]
        .into_iter()
        .flat_map(|c| {
            ["VERTEX_POSITION", "VERTEX_NORMAL", "VERTEX_UV", "VERTEX_COLOR", "VERTEX_TANGENT"].map(|word| {
                (interpolated(c, word), if ["VERTEX_NORMAL", "VERTEX_COLOR"].contains(&word) { 3 } else { 4 })
            })
        })
        .collect();
    let corner: Vec<(&str, usize)> = corner.iter().map(|(f, n)| (f.as_str(), *n)).collect();
    let body = format!("let v = triangle_vertices(read_instance(u32(x[0])), 1u);\n{}", assign(&corner));
    let expected: Vec<[f32; 54]> = s
        .instances
        .iter()
        .map(|i| {
            let mesh = &s.meshes[i.mesh as usize];
            let corners = mesh.triangles()[1].map(|v| {
                let v = v as usize;
                let color = mesh.colors().get(v).copied().unwrap_or(Vec4::ONE);
                let uv = |set: &[Vec2]| set.get(v).copied().unwrap_or_default().to_array();
                [
                    &mesh.positions()[v].extend(color.w).to_array()[..],
                    &mesh.normals()[v].to_array(),
                    &uv(mesh.uvs()),
                    &uv(mesh.uvs1()),
                    &color.truncate().to_array(),
                    &mesh.tangents().get(v).map_or([0.0; 4], |t| t.to_array()),
                ]
                .concat()
            });
            corners.concat().try_into().unwrap()
        })
        .collect();
    reads(
        &held,
        "vertices",
        &body,
        &expected,
        ("geometry_word(instance.first_index + primitive)", "geometry_word(instance.first_index)"),
    );
}

#[test]
fn materials() {
    let Some(probe) = probe() else { return };
    let s = scene();
    let held = probe.hold(&s, &followed(&s, BlasKind::Bvh)).unwrap();
    let words: Vec<(String, usize)> =
        [("0u", 4), ("1u", 4), ("2u", 4), ("3u", 2), ("13u", 4), ("20u", 3), ("21u", 1), ("22u", 4), ("23u", 1)]
            .map(|(w, n)| {
                let part = ["", ".x", ".xy", ".xyz", ""][n];
                (format!("bitcast<vec4f>(dynamic_word(m + {w})){part}"), n)
            })
            .to_vec();
    let mut words: Vec<(&str, usize)> = words.iter().map(|(f, n)| (f.as_str(), *n)).collect();
    words.extend([
        ("bitcast<f32>(dynamic_word(m + 3u).w)", 1),
        ("dynamic_word(m + 3u).z", 1),
        ("bitcast<i32>(dynamic_word(m + 23u).y)", 1),
        ("(dynamic_word(m + 23u).z & MATERIAL_SCHLICK) / MATERIAL_SCHLICK", 1),
        ("(dynamic_word(m + 23u).z & MATERIAL_THIN) / MATERIAL_THIN", 1),
        ("(dynamic_word(m + 20u).w & PHYSICAL) / PHYSICAL", 1),
        ("(dynamic_word(m + 20u).w & PHYSICAL_BLENDED) / PHYSICAL_BLENDED", 1),
        ("(dynamic_word(m + 20u).w & PHYSICAL_REFLECTANCE) / PHYSICAL_REFLECTANCE", 1),
        ("(dynamic_word(m + 20u).w & PHYSICAL_BY_REFLECTANCE) / PHYSICAL_BY_REFLECTANCE", 1),
        ("dynamic_word(m + 21u).y", 1),
    ]);
    let body = format!("let m = head.materials + u32(x[0]) * MATERIAL_WORDS;\n{}", assign(&words));
    let expected: Vec<[f32; 37]> = s
        .materials
        .iter()
        .map(|m| {
            let p = m.physical.unwrap();
            row(&[
                &m.base_color.extend(m.diffuse).to_array(),
                &m.specular.extend(m.shininess).to_array(),
                &m.emissive.extend(m.ambient).to_array(),
                &[m.mirror, m.transmission, m.normal_scale, m.alpha, p.metallic, p.roughness],
                &p.reflectance.to_array(),
                &[p.transmission],
                &m.attenuation_color.extend(m.attenuation_distance.min(f32::MAX)).to_array(),
                &[m.ior, m.alpha_cutoff, flag(m.unlit), m.priority as f32, flag(m.schlick), flag(m.thin)],
                // All seven textures.
                &[1.0, flag(p.blended), 1.0, flag(p.by_reflectance), 127.0],
            ])
        })
        .collect();
    reads(&held, "materials", &body, &expected, ("const MATERIAL_THIN: u32 = 2u;", "const MATERIAL_THIN: u32 = 4u;"));

    // Seven textures each, and the texels that they name.
    let body = format!(
        "let r = material_texture(head.materials + (u32(x[0]) / 7u) * MATERIAL_WORDS, u32(x[0]) % 7u);\n{}",
        assign(&[
            ("r.uv_row0", 3),
            ("r.uv_row1", 3),
            ("vec2u(r.width, r.height)", 2),
            ("vec2u(r.wrap_u, r.wrap_v)", 2),
            ("(r.flags & TEXTURE_NEAREST) / TEXTURE_NEAREST", 1),
            ("(r.flags & TEXTURE_SRGB) / TEXTURE_SRGB", 1),
            ("(r.flags & TEXTURE_UV1) / TEXTURE_UV1", 1),
            ("(r.flags & TEXTURE_NEAREST_MIN) / TEXTURE_NEAREST_MIN", 1),
            ("(r.flags & TEXTURE_MIP_NEAREST) / TEXTURE_MIP_NEAREST", 1),
            ("(r.flags & TEXTURE_MIP_LINEAR) / TEXTURE_MIP_LINEAR", 1),
            ("texel_linear(r.first_texel + r.width * r.height - 1u, (r.flags & TEXTURE_SRGB) != 0u)", 4),
            ("texel_linear(texture_level(r, texture_last_level(r)).first_texel, (r.flags & TEXTURE_SRGB) != 0u)", 4),
        ])
    );
    let expected: Vec<[f32; 24]> = s
        .materials
        .iter()
        .flat_map(|m| {
            let p = m.physical.unwrap();
            // In the order of SLOT_*.
            let textures = [
                m.base_color_texture,
                m.emissive_texture,
                m.normal_texture,
                p.metallic_roughness_texture,
                p.transmission_texture,
                p.reflectance_texture,
                p.reflectance_strength_texture,
            ];
            textures.map(|r| {
                let r = r.unwrap();
                let t = &s.textures[r.texture as usize];
                let last = t.level_count() - 1;
                let smallest = if last == 0 {
                    t.texel_linear(0, 0)
                } else {
                    let texel = *t.mips().last().unwrap();
                    catoptra_engine::Texture::new(1, 1, vec![texel], t.srgb()).unwrap().texel_linear(0, 0)
                };
                row(&[
                    &r.uv_transform[0],
                    &r.uv_transform[1],
                    &[t.width() as f32, t.height() as f32, r.wrap[0] as u32 as f32, r.wrap[1] as u32 as f32],
                    &[flag(r.nearest), flag(t.srgb()), flag(r.uv_set == 1), flag(r.nearest_min)],
                    &[flag(r.mip == Mip::Nearest), flag(r.mip == Mip::Linear)],
                    &t.texel_linear(t.width() - 1, t.height() - 1).to_array(),
                    &smallest.to_array(),
                ])
            })
        })
        .collect();
    reads(
        &held,
        "textures",
        &body,
        &expected,
        ("4u * u32(slot > SLOT_TRANSMISSION)", "3u * u32(slot > SLOT_TRANSMISSION)"),
    );
}

#[test]
fn lights_and_their_views() {
    let Some(probe) = probe() else { return };
    let s = scene();
    let held = probe.hold(&s, &followed(&s, BlasKind::Bvh)).unwrap();
    let plan = ShadowPlan::new(&s.lights, s.bounds_world(), &Default::default());
    let body = format!(
        "let l = read_light(u32(x[0]));\n{}",
        assign(&[
            ("l.position_world", 3),
            ("l.kind", 1),
            ("l.direction_world", 3),
            ("l.cos_inner", 1),
            ("l.intensity", 3),
            ("l.cos_outer", 1),
            ("l.first_view", 1),
            ("l.view_count", 1),
            ("bitcast<f32>(dynamic_word(head.lights + u32(x[0]) * LIGHT_WORDS + 4u).x)", 1),
            ("bitcast<vec3f>(dynamic_word(head.lights + u32(x[0]) * LIGHT_WORDS + 5u).xyz)", 3),
        ])
    );
    let expected: Vec<[f32; 18]> = s
        .lights
        .iter()
        .zip(&plan.lights)
        .map(|(l, maps)| {
            let (kind, inner, outer) = match l.kind {
                LightKind::Point => (0.0, 1.0, -1.0),
                LightKind::Spot { cos_inner, cos_outer } => (1.0, cos_inner, cos_outer),
                LightKind::Directional => (2.0, 1.0, -1.0),
            };
            row(&[
                &l.position_world.extend(kind).to_array(),
                &l.direction_world.extend(inner).to_array(),
                &l.intensity.extend(outer).to_array(),
                &[maps.first as f32, maps.count as f32, l.radius],
                &l.up_world.to_array(),
            ])
        })
        .collect();
    reads(&held, "lights", &body, &expected, ("light * LIGHT_WORDS;", "light * (LIGHT_WORDS - 1u);"));

    let body = format!(
        "let v = read_view(u32(x[0]));\n{}",
        assign(&[
            ("v.origin_world", 3),
            ("v.far", 1),
            ("v.right_scaled", 3),
            ("v.perspective", 1),
            ("v.up_scaled", 3),
            ("v.size", 1),
            ("v.forward", 3),
            ("v.softness", 1),
        ])
    );
    let expected: Vec<[f32; 16]> = plan
        .views
        .iter()
        .map(|v| {
            row(&[
                &v.origin_world.extend(v.far).to_array(),
                &v.right_scaled.extend(v.perspective).to_array(),
                &v.up_scaled.extend(v.size as f32).to_array(),
                &v.forward.extend(v.softness).to_array(),
            ])
        })
        .collect();
    assert!(expected.len() > 6, "a point light has six");
    reads(&held, "views", &body, &expected, ("view * VIEW_WORDS;", "view * (VIEW_WORDS + 1u);"));
}
