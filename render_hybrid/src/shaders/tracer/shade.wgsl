// Light at a hit: direct (Blinn-Phong under shadowed lights) and indirect (VPLs), by the functions of the raster passes.
// Twin: trace/shade.rs.

fn read_light(light: u32) -> Light {
    let at = head.lights + light * LIGHT_WORDS;
    let a = dynamic_word(at);
    let b = dynamic_word(at + 1u);
    let c = dynamic_word(at + 2u);
    let d = dynamic_word(at + 3u);
    return Light(
        float3(a), a.w, float3(b), bitcast<f32>(b.w), float3(c), bitcast<f32>(c.w), d.x, d.y, d.z, d.w);
}

fn read_view(view: u32) -> ShadowView {
    let at = head.views + view * VIEW_WORDS;
    let a = dynamic_word(at);
    let b = dynamic_word(at + 1u);
    let c = dynamic_word(at + 2u);
    let d = dynamic_word(at + 3u);
    return ShadowView(
        float3(a), bitcast<f32>(a.w), float3(b), bitcast<f32>(b.w), float3(c), c.w, float3(d), bitcast<f32>(d.w));
}

fn read_vpl(vpl: u32) -> Vpl {
    let a = vpl_word(3u * vpl);
    let b = vpl_word(3u * vpl + 1u);
    let c = vpl_word(3u * vpl + 2u);
    return Vpl(float3(a), bitcast<f32>(a.w), float3(b), b.w, float3(c), bitcast<f32>(c.w));
}

fn moments_visibility(light: Light, point_world: vec3f) -> f32 {
    var face = 0u;
    if light.view_count == 6u {
        face = cube_face(point_world - light.position_world);
    }
    let view = read_view(light.first_view + face);
    let options = vec3f(trace.min_variance, trace.light_bleed_reduction, f32(trace.evsm));
    if light.view_count == 6u {
        return view_visibility(moment_faces, light.first_layer + face, view, point_world, options);
    }
    return view_visibility(moment_maps, light.first_layer, view, point_world, options);
}

// Fraction of the light's disc that rays reach. Twin: trace/visibility.rs.
fn traced_visibility(light: Light, index: u32, s: SurfacePoint, wi: vec3f, pixel: u32) -> f32 {
    let disc = float3(dynamic_word(head.lights + index * LIGHT_WORDS + 4u)).x;
    let samples = select(1u, trace.shadow_samples, disc > 0.0);
    let turn = hash_combine(hash_combine(trace.seed, pixel), index);
    let rotation = 2.0 * PI * unit_f32(turn);
    let basis = orthonormal_basis(wi);
    var lit = 0u;
    for (var i = 0u; i < samples; i += 1u) {
        let at = select(vogel_disc(i, samples, rotation), vec2f(0.0), samples == 1u);
        let across = (basis[0] * at.x + basis[1] * at.y) * disc;
        let far_away = light.kind == LIGHT_DIRECTIONAL;
        let to_target = select(light.position_world - s.position_world, wi, far_away) + across;
        if dot(s.n_geometric, to_target) <= 0.0 {
            continue;
        }
        let origin = offset_origin(s, to_target);
        let direction = select(light.position_world + across - origin, to_target, far_away);
        count_ray(RAYS_SHADOW);
        lit += u32(!occluded(Ray(origin, 0.0, direction, select(1.0, FAR_AWAY, far_away))));
    }
    return f32(lit) / f32(samples);
}

// Radiance towards `wo`.
fn shade(s: SurfacePoint, wo: vec3f, pixel: u32) -> vec3f {
    let m = material_at(s.instance);
    if dynamic_word(m + 3u).z != 0u {
        return s.emission;
    }
    let matte = matte_weight(s.look);
    var radiance = s.emission + s.base_color * frame.ambient * (bitcast<f32>(dynamic_word(m + 2u).w) * matte);
    let diffuse = s.base_color * (s.look.diffuse * matte / PI);
    let specular = s.look.specular;
    for (var i = 0u; i < frame.light_count; i += 1u) {
        let light = read_light(i);
        let arriving = incident(light, s.position_world);
        let cos_i = dot(s.n_shading, arriving.wi);
        if cos_i <= 0.0 || !any(arriving.irradiance > vec3f(0.0)) {
            continue;
        }
        var reflected = diffuse;
        if any(specular > vec3f(0.0)) {
            reflected += specular * blinn_phong_lobe(s.n_shading, arriving.wi, wo, s.look.shininess);
        }
        if !any(reflected > vec3f(0.0)) {
            continue;
        }
        var visible = 1.0;
        if TRACED_SHADOWS {
            visible = traced_visibility(light, i, s, arriving.wi, pixel);
        } else if trace.visibility == VISIBILITY_MOMENTS {
            visible = moments_visibility(light, s.position_world);
        }
        radiance += reflected * arriving.irradiance * (cos_i * visible);
    }
    if !any(diffuse > vec3f(0.0)) {
        return radiance;
    }
    var sum = vec3f(0.0);
    for (var i = 0u; i < trace.vpl_count; i += 1u) {
        let vpl = read_vpl(i);
        var irradiance = vpl_irradiance(vpl, s.position_world, s.n_shading, trace.geometry_term_max);
        if !any(irradiance > vec3f(0.0)) {
            continue;
        }
        let center = vpl.position_world + vpl.normal_world * vpl.error;
        if TRACED_VPLS {
            let to_vpl = center - s.position_world;
            if dot(s.n_geometric, to_vpl) <= 0.0 {
                continue;
            }
            let origin = offset_origin(s, to_vpl);
            count_ray(RAYS_VPL);
            if occluded(Ray(origin, 0.0, center - origin, 1.0)) {
                continue;
            }
        } else if trace.map_size != 0u {
            irradiance *= vpl_visibility(vpl_maps, vpl.map, trace.map_size, s.position_world - center, s.n_shading);
        }
        sum += irradiance;
    }
    return radiance + diffuse * sum;
}
