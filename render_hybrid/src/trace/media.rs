//! Nested glass: which medium a ray is in, by a priority stack.
//!
//! Source: Schmidt & Budge, "Simple Nested Dielectrics in Ray Traced Images", JGT 2002.

use catoptra_engine::RenderScene;

/// Volumes that a ray is inside of, in the order of entry. Holds up to [`MediumStack::CAPACITY`]; deeper ones are ignored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MediumStack {
    instances: [u32; Self::CAPACITY],
    len: u8,
}

impl MediumStack {
    /// Most volumes that overlap in one place.
    pub const CAPACITY: usize = 6;

    /// The volume that fills the place: the highest priority, among equals the one entered last. `None`: air.
    pub fn current(&self, scene: &RenderScene) -> Option<u32> {
        let inside = &self.instances[..self.len as usize];
        // `max_by_key` keeps the last of equals.
        inside.iter().copied().max_by_key(|&i| scene.materials[scene.instances[i as usize].material as usize].priority)
    }

    /// The stack after crossing into `instance_id`.
    pub fn entered(mut self, instance_id: u32) -> Self {
        if (self.len as usize) < Self::CAPACITY {
            self.instances[self.len as usize] = instance_id;
            self.len += 1;
        }
        self
    }

    /// The stack after leaving `instance_id` (its last entry), unchanged where it was not inside.
    pub fn left(mut self, instance_id: u32) -> Self {
        let len = self.len as usize;
        if let Some(at) = self.instances[..len].iter().rposition(|&i| i == instance_id) {
            self.instances.copy_within(at + 1..len, at);
            self.len -= 1;
        }
        self
    }

    /// True where the ray is inside `instance_id`.
    pub fn contains(&self, instance_id: u32) -> bool {
        self.instances[..self.len as usize].contains(&instance_id)
    }
}

/// What a ray crosses at a closed glass surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Instance whose medium the ray is in; `None`: air.
    pub from: Option<u32>,
    /// Instance whose medium lies behind the surface.
    pub to: Option<u32>,
    /// The stack behind the surface.
    pub behind: MediumStack,
}

/// The media on both sides of a surface of `instance_id` that a ray with stack `inside` meets.
/// * `front`: the ray comes from outside of the mesh
pub fn crossing(scene: &RenderScene, inside: MediumStack, instance_id: u32, front: bool) -> Crossing {
    if front {
        let behind = inside.entered(instance_id);
        Crossing { from: inside.current(scene), to: behind.current(scene), behind }
    } else {
        // A ray that meets a back without having met the front started inside.
        let before = if inside.contains(instance_id) { inside } else { inside.entered(instance_id) };
        let behind = before.left(instance_id);
        Crossing { from: before.current(scene), to: behind.current(scene), behind }
    }
}

/// Index of refraction of a medium; 1 in air.
pub fn ior_of(scene: &RenderScene, medium: Option<u32>) -> f32 {
    medium.map_or(1.0, |i| scene.materials[scene.instances[i as usize].material as usize].ior)
}
