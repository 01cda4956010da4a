// Nested glass: which medium a ray is in, by a priority stack. Twin: trace/media.rs.
// Source: Schmidt & Budge, "Simple Nested Dielectrics in Ray Traced Images", JGT 2002.

// Volumes that a ray is inside of, in the order of entry.
struct Media {
    instances: array<u32, MEDIA_CAPACITY>,
    count: u32,
}

fn empty_media() -> Media {
    return Media();
}

fn priority_of(instance: u32) -> i32 {
    return bitcast<i32>(dynamic_word(material_at(instance) + 23u).y);
}

// The volume that fills the place: the highest priority, among equals the one entered last. NONE: air.
fn current_medium(media: Media) -> u32 {
    var own = media.instances;
    var best = NONE;
    var highest = 0;
    for (var i = 0u; i < min(media.count, MEDIA_CAPACITY); i += 1u) {
        let priority = priority_of(own[i]);
        if best == NONE || priority >= highest {
            best = own[i];
            highest = priority;
        }
    }
    return best;
}

fn entered_media(media: Media, instance: u32) -> Media {
    var out = media;
    if out.count < MEDIA_CAPACITY {
        out.instances[out.count] = instance;
        out.count += 1u;
    }
    return out;
}

// Without the last entry of `instance`.
fn left_media(media: Media, instance: u32) -> Media {
    var own = media.instances;
    var at = NONE;
    for (var i = 0u; i < min(media.count, MEDIA_CAPACITY); i += 1u) {
        if own[i] == instance {
            at = i;
        }
    }
    if at == NONE {
        return media;
    }
    for (var i = at; i + 1u < min(media.count, MEDIA_CAPACITY); i += 1u) {
        own[i] = own[i + 1u];
    }
    return Media(own, media.count - 1u);
}

fn is_inside(media: Media, instance: u32) -> bool {
    var own = media.instances;
    var found = false;
    for (var i = 0u; i < min(media.count, MEDIA_CAPACITY); i += 1u) {
        found = found || own[i] == instance;
    }
    return found;
}

struct MediaCrossing {
    // Instance whose medium the ray is in, and whose lies behind the surface; NONE: air.
    before: u32,
    after: u32,
    behind: Media,
}

// The media on both sides of a surface of `instance`. Twin: trace/media.rs, crossing.
fn crossing(inside: Media, instance: u32, front: bool) -> MediaCrossing {
    var outer = inside;
    // A ray that meets a back without having met the front started inside.
    if !front && !is_inside(inside, instance) {
        outer = entered_media(inside, instance);
    }
    var behind: Media;
    if front {
        behind = entered_media(inside, instance);
    } else {
        behind = left_media(outer, instance);
    }
    return MediaCrossing(current_medium(outer), current_medium(behind), behind);
}
