// Mirrors and glass by a stack of weighted rays. Twin: trace/whitted.rs, which goes wave by wave; sums differ in their order
// alone. Source: Whitted, "An Improved Illumination Model for Shaded Display", CACM 1980.

// A ray on its way, and what it will be worth.
struct Branch {
    ray: Ray,
    weight: vec3f,
    // Interfaces behind it; with hidden ones.
    depth: u32,
    crossed: u32,
    refraction: bool,
    // Metres from the camera to the ray's start, along the path.
    way: f32,
    inside: Media,
}

// Siblings that wait: one a level of depth, and no more than log2(3 / min_weight) + 1, since the lesser of two goes first
// and is worth at most half of their parent. The stack is as long as one of both bounds: raster/tracer/layout.rs.
var<private> branches: array<Branch, BRANCH_STACK>;

struct Interface {
    reflected: vec3f,
    transmitted: vec3f,
    transmitted_direction: vec3f,
    passes: bool,
    hidden: bool,
    behind: Media,
}

fn ior_of(instance: u32) -> f32 {
    if instance == NONE {
        return 1.0;
    }
    return bitcast<f32>(dynamic_word(material_at(instance) + 23u).x);
}

// Keeps a direction that interpolated normals sent below the true surface just above it.
fn above_horizon(r: vec3f, n_geometric: vec3f) -> vec3f {
    let cos = dot(r, n_geometric);
    if cos >= LEAST_COSINE {
        return r;
    }
    return normalize_or(r + n_geometric * (LEAST_COSINE - cos), n_geometric);
}

// Splits light that travels along unit `d` at a surface.
fn split(s: SurfacePoint, d: vec3f, inside: Media) -> Interface {
    let m = material_at(s.instance);
    let optics = dynamic_word(m + 23u);
    let cos_i = clamp(dot(s.n_shading, -d), 0.0, 1.0);
    var tint = s.base_color;
    if (optics.z & MATERIAL_SCHLICK) != 0u {
        tint = schlick(s.base_color, cos_i);
    }
    var out = Interface(tint * s.look.mirror, vec3f(0.0), d, false, false, inside);
    let glass = (1.0 - s.look.mirror) * s.look.transmission;
    if glass <= 0.0 {
        return out;
    }
    out.passes = true;
    if (optics.z & MATERIAL_THIN) != 0u {
        out.transmitted = vec3f(glass);
        return out;
    }
    if (dynamic_word(instance_at(s.instance) + 3u).w & INSTANCE_CLOSED) == 0u {
        // A thin pane: both faces at once, with the light that bounces between them.
        let f = fresnel_dielectric(cos_i, 1.0 / bitcast<f32>(optics.x));
        let r = 2.0 * f / (1.0 + f);
        out.reflected += vec3f(glass * r);
        out.transmitted = s.base_color * (glass * (1.0 - r));
        return out;
    }
    let c = crossing(inside, s.instance, s.front);
    out.behind = c.behind;
    if c.before == c.after {
        out.hidden = true;
        return out;
    }
    let eta = ior_of(c.before) / ior_of(c.after);
    let f = fresnel_dielectric(cos_i, eta);
    out.reflected += vec3f(glass * f);
    let t = refract_travel(d, s.n_shading, eta);
    out.passes = f < 1.0 && t.w > 0.0;
    out.transmitted = s.base_color * (glass * (1.0 - f));
    out.transmitted_direction = -above_horizon(-t.xyz, s.n_geometric);
    return out;
}

fn worth(weight: vec3f) -> bool {
    return max(weight.x, max(weight.y, weight.z)) >= trace.min_weight;
}

fn sum(weight: vec3f) -> f32 {
    return weight.x + weight.y + weight.z;
}

fn choose(a: Branch, b: Branch, second: bool) -> Branch {
    if second {
        return b;
    }
    return a;
}

// What is left of light behind `metres` of what fills the place.
fn transmittance(inside: Media, metres: f32) -> vec3f {
    let medium = current_medium(inside);
    if medium == NONE {
        return vec3f(1.0);
    }
    let absorption = bitcast<vec4f>(dynamic_word(material_at(medium) + 22u));
    return beer_lambert(absorption.xyz, absorption.w, metres);
}

// The rays that go on from a surface, at most two.
struct Children {
    count: u32,
    // The lesser of two: a ray that waits is then worth at least as much as all that go before it.
    first: Branch,
    second: Branch,
}

// What `branch` begins at the surface that it met, `way` metres from the camera.
fn children(branch: Branch, s: SurfacePoint, way: f32) -> Children {
    var out: Children;
    if !((s.look.mirror > 0.0 || s.look.transmission > 0.0) && branch.depth < trace.max_depth) {
        return out;
    }
    let along = branch.ray.direction;
    let optics = split(s, along, branch.inside);
    let weight = branch.weight;
    let depth = branch.depth;
    let crossed = branch.crossed + 1u;
    if optics.hidden {
        if branch.crossed < 4u * trace.max_depth && worth(weight) {
            out.count = 1u;
            out.first = Branch(leaving_ray(s, along), weight, depth, crossed, true, way, optics.behind);
        }
        return out;
    }
    let through = weight * optics.transmitted;
    let back = weight * optics.reflected;
    let goes_through = optics.passes && worth(through);
    let goes_back = any(optics.reflected != vec3f(0.0)) && worth(back);
    let refracted = Branch(
        leaving_ray(s, optics.transmitted_direction), through, depth + 1u, crossed, true, way, optics.behind);
    let r = above_horizon(reflect_view(-along, s.n_shading), s.n_geometric);
    let reflected = Branch(leaving_ray(s, r), back, depth + 1u, crossed, false, way, branch.inside);
    let back_first = goes_back && !(goes_through && sum(through) < sum(back));
    out.count = u32(goes_through) + u32(goes_back);
    out.first = choose(refracted, reflected, back_first);
    out.second = choose(refracted, reflected, !back_first);
    return out;
}

fn camera_branch(ray: Ray) -> Branch {
    return Branch(ray, vec3f(1.0), 0u, 0u, false, 0.0, empty_media());
}

// What a ray and all that it begins bring; of a ray from the camera, what it sees is known and brings nothing itself.
fn traced_radiance(start: Branch, starts_at_camera: bool, seen: Hit, pixel: u32) -> vec3f {
    var radiance = vec3f(0.0);
    var branch = start;
    var hit = seen;
    var from_camera = starts_at_camera;
    var waiting = 0u;
    // Each turn ends one ray and begins at most two; depth and crossings bound them.
    for (var turn = 0u; turn < trace.ray_cap; turn += 1u) {
        if !from_camera {
            hit = closest_hit(branch.ray);
            count_ray(select(RAYS_REFLECTION, RAYS_REFRACTION, branch.refraction));
            branch.weight *= transmittance(branch.inside, hit.t);
        }
        var next: Children;
        if hit.instance == NONE {
            radiance += branch.weight * frame.background;
        } else {
            let way = branch.way + hit.t;
            let s = surface_at(branch.ray.direction, hit, pixel_width(way));
            if !from_camera {
                radiance += branch.weight * shade(s, -branch.ray.direction, pixel);
            }
            next = children(branch, s, way);
        }
        from_camera = false;
        if next.count > 1u {
            branches[min(waiting, BRANCH_STACK - 1u)] = next.second;
            waiting += 1u;
        }
        if next.count > 0u {
            branch = next.first;
            continue;
        }
        if waiting == 0u {
            return radiance;
        }
        waiting -= 1u;
        branch = branches[waiting];
    }
    capped = true;
    return radiance;
}

// Twin: trace/surface.rs, PixelCone.
fn pixel_width(way: f32) -> f32 {
    let pixel = 2.0 * frame.half_height / f32(frame.size.y);
    return select(pixel * way, pixel, frame.orthographic != 0u);
}

// The triangle that the rasteriser saw at a pixel, and the ray to it.
struct Seen {
    // Instance NONE: nothing was seen.
    hit: Hit,
    ray: Ray,
}

fn seen_at(pixel: vec2u) -> Seen {
    let seen = textureLoad(visibility, pixel, 0).xy;
    let ray = camera_ray(frame, vec2f(pixel) + 0.5);
    if seen.x == 0u {
        return Seen(Hit(0.0, 0.0, 0.0, NONE, NONE), Ray(ray.origin, 0.0, ray.direction, FAR_AWAY));
    }
    let instance = read_instance(seen.x - 1u);
    let vertices = triangle_vertices(instance, seen.y);
    let p0 = point_world_from_object(instance, float3(geometry_word(vertices.x)));
    let p1 = point_world_from_object(instance, float3(geometry_word(vertices.y)));
    let p2 = point_world_from_object(instance, float3(geometry_word(vertices.z)));
    let uv = plane_barycentrics(ray.origin, ray.direction, p0, p1, p2);
    let place = p0 * (1.0 - uv.x - uv.y) + p1 * uv.x + p2 * uv.y;
    let hit = Hit(distance(frame.eye_world, place), uv.x, uv.y, seen.x - 1u, seen.y);
    return Seen(hit, Ray(ray.origin, 0.0, ray.direction, FAR_AWAY));
}

fn trace_pixel(pixel: vec2u) -> vec3f {
    let seen = seen_at(pixel);
    if seen.hit.instance == NONE {
        return vec3f(0.0);
    }
    return traced_radiance(camera_branch(seen.ray), true, seen.hit, pixel.y * frame.size.x + pixel.x);
}
