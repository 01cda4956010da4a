//! Lights (`KHR_lights_punctual`) and cameras.

use super::{
    document::{Document, Node, extension, item, own_extras},
    error::GltfError,
    report::Ignored,
};
use crate::{
    camera::Projection,
    components::{CameraProjection, LightSource},
    light::LightKind,
    math,
};
use glam::Vec3;
use serde::Deserialize;
use serde_json::Value;

const LIGHTS: &str = "KHR_lights_punctual";

#[derive(Deserialize)]
pub(super) struct LightList {
    #[serde(default)]
    lights: Vec<LightDef>,
}

#[derive(Deserialize)]
struct LightDef {
    #[serde(rename = "type")]
    kind: String,
    color: Option<[f32; 3]>,
    intensity: Option<f32>,
    spot: Option<Spot>,
    range: Option<f32>,
    extras: Option<Value>,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Spot {
    inner_cone_angle: Option<f32>,
    outer_cone_angle: Option<f32>,
}

#[derive(Deserialize)]
struct LightIndex {
    light: u32,
}

/// The document's lights.
pub(super) fn lights(document: &Document) -> Result<LightList, GltfError> {
    Ok(extension(&document.extensions, LIGHTS, "file")?.unwrap_or(LightList { lights: Vec::new() }))
}

/// Light of a node: candela or lux as they stand, colour times intensity.
pub(super) fn light(
    node: &Node,
    list: &LightList,
    place: &str,
    ignored: &mut Ignored,
) -> Result<Option<LightSource>, GltfError> {
    let Some(LightIndex { light }) = extension(&node.extensions, LIGHTS, place)? else {
        return Ok(None);
    };
    let def = item(&list.lights, light, "light", place)?;
    let place = &format!("light {light}");
    let own = own_extras(&def.extras);
    let own = |name: &str| own.and_then(|o| o.get(name)).and_then(Value::as_f64).map(|v| v as f32);
    let kind = match def.kind.as_str() {
        "point" => LightKind::Point,
        "directional" => LightKind::Directional,
        "spot" => {
            let spot = def.spot.as_ref();
            let inner = spot.and_then(|s| s.inner_cone_angle).unwrap_or(0.0);
            let outer = spot.and_then(|s| s.outer_cone_angle).unwrap_or(std::f32::consts::FRAC_PI_4);
            // Exactly a half turn is allowed, and writers round it up.
            if !(inner >= 0.0 && inner <= outer && outer <= 1.000_01 * std::f32::consts::FRAC_PI_2) {
                return Err(GltfError::invalid(place, format!("cone angles {inner} and {outer} are no cone")));
            }
            let cos_inner = own("cos_inner").unwrap_or_else(|| math::cos(inner));
            let cos_outer = own("cos_outer").unwrap_or_else(|| math::cos(outer));
            if !(cos_inner <= 1.0 && cos_outer <= cos_inner && cos_outer >= -1.0) {
                return Err(GltfError::invalid(place, format!("cone cosines {cos_inner} and {cos_outer} are no cone")));
            }
            LightKind::Spot { cos_inner, cos_outer }
        }
        other => return Err(GltfError::invalid(place, format!("light type {other:?} does not exist"))),
    };
    let intensity = Vec3::from(def.color.unwrap_or([1.0; 3])) * def.intensity.unwrap_or(1.0);
    if !intensity.is_finite() || intensity.min_element() < 0.0 {
        return Err(GltfError::invalid(place, "intensity is negative or not finite"));
    }
    let radius = own("radius").unwrap_or(0.0);
    if !(radius >= 0.0 && radius.is_finite()) {
        return Err(GltfError::invalid(place, format!("radius {radius}")));
    }
    if def.range.is_some() {
        ignored.note("range of lights");
    }
    Ok(Some(LightSource { kind, intensity, radius }))
}

/// Camera of a node. The aspect ratio is the picture's, not the file's.
pub(super) fn camera(document: &Document, node: &Node, place: &str) -> Result<Option<CameraProjection>, GltfError> {
    let Some(index) = node.camera else {
        return Ok(None);
    };
    let def = item(&document.cameras, index, "camera", place)?;
    let place = &format!("camera {index}");
    let (projection, near) = match (def.kind.as_str(), &def.perspective, &def.orthographic) {
        ("perspective", Some(p), _) if p.yfov > 0.0 && p.yfov < std::f32::consts::PI => {
            (Projection::Perspective { fov_y: p.yfov }, p.znear)
        }
        ("orthographic", _, Some(o)) if o.ymag != 0.0 && o.ymag.is_finite() => {
            (Projection::Orthographic { half_height: o.ymag.abs() }, o.znear)
        }
        ("perspective", Some(p), _) => return Err(GltfError::invalid(place, format!("yfov is {}", p.yfov))),
        ("orthographic", _, Some(o)) => return Err(GltfError::invalid(place, format!("ymag is {}", o.ymag))),
        (kind, ..) => return Err(GltfError::invalid(place, format!("type {kind:?} without its lens"))),
    };
    if !(near >= 0.0 && near.is_finite()) {
        return Err(GltfError::invalid(place, format!("znear is {near}")));
    }
    Ok(Some(CameraProjection { projection, near }))
}
