//! Nested glass: which medium a ray is in, by a priority stack.
//!
//! Source: Schmidt & Budge, "Simple Nested Dielectrics in Ray Traced Images", JGT 2002.

use catoptra_engine::RenderScene;
use glam::Vec3;

use crate::twin::shading::ln_color;

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
            // Equal stacks are equal whatever they held before.
            self.instances[len - 1] = 0;
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

/// What is behind a glass surface, by numbers of a [`Media`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossed {
    /// The stack behind it.
    pub behind: u32,
    /// n_from / n_to.
    pub eta: f32,
    /// Nothing changes there: a surface inside a volume of higher priority.
    pub hidden: bool,
}

/// Crossings that are remembered: a power of two.
const REMEMBERED: usize = 64;

/// The stacks that rays of a frame are in, by number, and what crossings make of them. Most rays share a few.
#[derive(Clone, Debug, Default)]
pub(crate) struct Media {
    /// The frame that they belong to.
    serial: u64,
    stacks: Vec<MediumStack>,
    /// Per stack: logarithm of what is left of light after a metre, at most 0.
    absorption: Vec<Vec3>,
    /// By stack, instance and side.
    remembered: Vec<(u32, u32, bool, Crossed)>,
}

impl Media {
    /// Number of the empty stack: air.
    pub const AIR: u32 = 0;

    /// Forgets what belongs to another frame.
    pub fn begin(&mut self, scene: &RenderScene, serial: u64) {
        if self.serial == serial && !self.stacks.is_empty() {
            return;
        }
        self.serial = serial;
        self.stacks.clear();
        self.absorption.clear();
        self.number(scene, MediumStack::default());
        self.remembered.clear();
        let none = Crossed { behind: Self::AIR, eta: 1.0, hidden: false };
        self.remembered.resize(REMEMBERED, (u32::MAX, u32::MAX, false, none));
    }

    /// Logarithm of what is left of light after a metre in a stack's medium, per channel, at most 0.
    #[inline]
    pub fn absorption(&self, stack: u32) -> Vec3 {
        self.absorption[stack as usize]
    }

    /// As [`crossing`].
    #[inline]
    pub fn cross(&mut self, scene: &RenderScene, stack: u32, instance_id: u32, front: bool) -> Crossed {
        let key = stack.wrapping_mul(5) ^ instance_id.wrapping_mul(2) ^ u32::from(front);
        let place = key as usize % REMEMBERED;
        let (s, i, f, crossed) = self.remembered[place];
        if (s, i, f) == (stack, instance_id, front) {
            return crossed;
        }
        let c = crossing(scene, self.stacks[stack as usize], instance_id, front);
        let crossed = Crossed {
            behind: self.number(scene, c.behind),
            eta: ior_of(scene, c.from) / ior_of(scene, c.to),
            hidden: c.from == c.to,
        };
        self.remembered[place] = (stack, instance_id, front, crossed);
        crossed
    }

    fn number(&mut self, scene: &RenderScene, stack: MediumStack) -> u32 {
        if let Some(i) = self.stacks.iter().position(|s| *s == stack) {
            return i as u32;
        }
        let absorption = stack.current(scene).map_or(Vec3::ZERO, |instance| {
            let m = &scene.materials[scene.instances[instance as usize].material as usize];
            ln_color(m.attenuation_color) / m.attenuation_distance
        });
        self.stacks.push(stack);
        self.absorption.push(absorption);
        self.stacks.len() as u32 - 1
    }
}
