//! What did not change since the frame before is not made again. Everything that a stage reads is compared, so that a kept
//! result is the one that would be made.

use catoptra_engine::{Aabb, Camera, Light, LightKind, Material, Mesh, RenderScene, Texture};
use glam::{Affine3, Vec3};
use std::{
    mem::{Discriminant, discriminant},
    sync::Arc,
};

use crate::{
    accel::Accel,
    settings::{GlassShadows, MomentOptions, RenderSettings, VplOptions},
    twin::shadow::ShadowView,
};

/// What VPLs and their maps were made of.
#[derive(Debug, Default)]
pub(crate) struct LitBy {
    known: bool,
    options: Option<(VplOptions, GlassShadows, u32)>,
    /// Camera and size of the picture where VPLs were chosen by what it shows.
    view: Option<(Camera, [u32; 2])>,
    lights: Vec<Light>,
    /// Transform, mesh and material by instance.
    instances: Vec<(Affine3, u32, u32)>,
    assets: SameAssets,
}

impl LitBy {
    /// True where nothing has changed; remembers the scene.
    /// * `on_surfels`: the VPLs lie on surfels, whatever the camera sees
    pub fn update(&mut self, scene: &RenderScene, settings: &RenderSettings, on_surfels: bool) -> bool {
        let options = settings.vpl.map(|v| (v, settings.glass_shadows, settings.seed));
        let chosen = settings.vpl.is_some_and(|v| v.candidates > 1);
        let view = chosen.then_some((scene.camera, [settings.width, settings.height]));
        let instances = || scene.instances.iter().map(|i| (i.world_from_object, i.mesh, i.material));
        let same = self.known
            && self.options == options
            && (self.view == view || on_surfels)
            && self.lights == scene.lights
            && self.instances.iter().copied().eq(instances())
            && self.assets.are_those_of(scene);
        if !same {
            self.known = true;
            self.options = options;
            self.view = view;
            self.lights.clone_from(&scene.lights);
            self.instances.clear();
            self.instances.extend(instances());
            self.assets.remember(scene);
        }
        same
    }

    /// The VPLs are gone.
    pub fn forget(&mut self) {
        self.known = false;
    }
}

/// Materials, meshes and textures of a scene.
#[derive(Clone, Debug, Default)]
pub(crate) struct SameAssets {
    materials: Vec<Material>,
    /// Held, so that their addresses stay their own.
    meshes: Vec<Arc<Mesh>>,
    textures: Vec<Arc<Texture>>,
}

impl SameAssets {
    pub fn are_those_of(&self, scene: &RenderScene) -> bool {
        self.materials == scene.materials
            && same_arcs(&self.meshes, &scene.meshes)
            && same_arcs(&self.textures, &scene.textures)
    }

    pub fn remember(&mut self, scene: &RenderScene) {
        self.materials.clone_from(&scene.materials);
        keep_arcs(&mut self.meshes, &scene.meshes);
        keep_arcs(&mut self.textures, &scene.textures);
    }
}

/// What light paths that are kept were begun in: what may change without being moved.
#[derive(Clone, Debug, Default)]
pub(crate) struct KeptBy {
    known: bool,
    /// Numbers of VPLs, candidates and bounces, and the seed.
    options: [u32; 4],
    lights: Vec<(u64, Discriminant<LightKind>)>,
    /// Stable id, mesh and material by instance.
    instances: Vec<(u64, u32, u32)>,
    assets: SameAssets,
}

impl KeptBy {
    /// True where nothing has changed but poses, cameras, intensities and cones; remembers the scene.
    pub fn update(&mut self, scene: &RenderScene, vpl: &VplOptions, seed: u32) -> bool {
        let options = [vpl.count, vpl.candidates, vpl.bounces, seed];
        let lights = || scene.lights.iter().map(|l| (l.stable_id, discriminant(&l.kind)));
        let instances = || scene.instances.iter().map(|i| (i.stable_id, i.mesh, i.material));
        let same = self.known
            && self.options == options
            && self.lights.iter().copied().eq(lights())
            && self.instances.iter().copied().eq(instances())
            && self.assets.are_those_of(scene);
        if !same {
            self.known = true;
            self.options = options;
            self.lights.clear();
            self.lights.extend(lights());
            self.instances.clear();
            self.instances.extend(instances());
            self.assets.remember(scene);
        }
        same
    }

    /// The paths are gone.
    pub fn forget(&mut self) {
        self.known = false;
    }
}

/// What a shadow map was made of.
#[derive(Debug, Default)]
pub(crate) struct CastBy {
    view: Option<(ShadowView, MomentOptions, bool)>,
    /// Transform and mesh of the instances in the map's list.
    casters: Vec<(Affine3, Arc<Mesh>)>,
}

impl CastBy {
    /// True where the same instances throw the same shadows; remembers them. Surfaces with holes always count as changed.
    /// * `casters`: the instances that may be seen on the map, ascending
    pub fn update(
        &mut self,
        view: (ShadowView, MomentOptions, bool),
        scene: &RenderScene,
        accel: &Accel,
        casters: impl Iterator<Item = u32> + Clone,
    ) -> bool {
        let of = |id: u32| {
            let i = &scene.instances[id as usize];
            (i.world_from_object, &scene.meshes[i.mesh as usize])
        };
        let equal = |a: &(Affine3, Arc<Mesh>), id: u32| {
            let (transform, mesh) = of(id);
            a.0 == transform && Arc::ptr_eq(&a.1, mesh)
        };
        let mut old = self.casters.iter();
        let same = !accel.any_holes()
            && self.view == Some(view)
            && casters.clone().all(|id| old.next().is_some_and(|a| equal(a, id)))
            && old.next().is_none();
        if !same {
            self.view = Some(view);
            self.casters.clear();
            self.casters.extend(casters.map(|id| (of(id).0, of(id).1.clone())));
        }
        same
    }
}

/// What the shadow maps of VPLs were made of.
#[derive(Debug, Default)]
pub(crate) struct MapsBy {
    options: Option<(u32, GlassShadows)>,
    instances: Vec<(Affine3, u32, u32)>,
    materials: Vec<Material>,
    meshes: Vec<Arc<Mesh>>,
    /// World boxes, a little wide, of what has changed: as it was and as it is.
    pub changed: Vec<Aabb>,
}

impl MapsBy {
    /// False where any texel may have changed; else only those whose rays meet [`Self::changed`]. Remembers the scene.
    /// * `size`: texels a side of a map
    pub fn update(&mut self, scene: &RenderScene, accel: &Accel, size: u32, glass_shadows: GlassShadows) -> bool {
        let options = Some((size, glass_shadows));
        let comparable = !accel.any_holes()
            && self.options == options
            && self.instances.len() == scene.instances.len()
            && self.materials == scene.materials
            && same_arcs(&self.meshes, &scene.meshes);
        self.changed.clear();
        if comparable {
            let wider = Vec3::splat(1e-4 * scene.bounds_world().radius());
            for (old, i) in self.instances.iter().zip(&scene.instances) {
                if *old != (i.world_from_object, i.mesh, i.material) {
                    for (transform, mesh) in [(old.0, old.1), (i.world_from_object, i.mesh)] {
                        let b = scene.meshes[mesh as usize].bounds_object().transformed(&transform);
                        self.changed.push(Aabb { min: b.min - wider, max: b.max + wider });
                    }
                }
            }
        } else {
            self.options = options;
            self.materials.clone_from(&scene.materials);
            keep_arcs(&mut self.meshes, &scene.meshes);
        }
        self.instances.clear();
        self.instances.extend(scene.instances.iter().map(|i| (i.world_from_object, i.mesh, i.material)));
        comparable
    }

    /// The maps are gone.
    pub fn forget(&mut self) {
        self.options = None;
    }
}

/// Whether a ray from `origin` may meet the box. What it grazes counts.
pub(crate) fn meets(b: &Aabb, origin: Vec3, direction: Vec3) -> bool {
    let (mut from, mut to) = (0.0f32, f32::INFINITY);
    for axis in 0..3 {
        let (o, d) = (origin[axis], direction[axis]);
        if d == 0.0 {
            if o < b.min[axis] || o > b.max[axis] {
                return false;
            }
            continue;
        }
        let (a, z) = ((b.min[axis] - o) / d, (b.max[axis] - o) / d);
        from = from.max(a.min(z));
        to = to.min(a.max(z));
    }
    // Rounding of the quotients.
    from <= to * (1.0 + 1e-5) + 1e-6
}

fn same_arcs<T>(a: &[Arc<T>], b: &[Arc<T>]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| Arc::ptr_eq(a, b))
}

fn keep_arcs<T>(to: &mut Vec<Arc<T>>, from: &[Arc<T>]) {
    to.clear();
    to.extend(from.iter().cloned());
}
