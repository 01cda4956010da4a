//! A crowd of things that come, move and go in a world, the same on every run.

use bevy_ecs::prelude::*;
use bevy_transform::components::Transform;
use catoptra_engine::{MeshInstance, StableId};
use glam::Vec3;

/// Between 40 and 200 small things, and the numbers that decide what happens to them.
pub struct Crowd {
    look: MeshInstance,
    alive: Vec<Entity>,
    state: u32,
}

impl Crowd {
    /// Nobody yet; all will look like `look`.
    pub fn new(look: MeshInstance) -> Self {
        Self { look, alive: Vec::new(), state: 1 }
    }

    fn random(&mut self) -> u32 {
        self.state = self.state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.state >> 8
    }

    /// One spawn, move or despawn.
    /// * `frame`: part of the new thing's id
    ///
    /// # Panics
    /// Where someone else has despawned one of the crowd.
    pub fn edit(&mut self, world: &mut World, frame: u32) {
        let place = Vec3::from_array(std::array::from_fn(|_| (self.random() % 500) as f32 / 100.0 - 2.5));
        let pick = self.random() as usize;
        if self.alive.len() < 40 || (self.alive.len() < 200 && pick.is_multiple_of(3)) {
            let id = StableId(100 + u64::from(self.random()) * 65_536 + u64::from(frame));
            let pose = Transform::from_translation(place).with_scale(Vec3::splat(0.15));
            self.alive.push(world.spawn((id, self.look, pose)).id());
            return;
        }
        let at = pick / 3 % self.alive.len();
        if pick % 3 == 1 {
            world.despawn(self.alive.swap_remove(at));
        } else if let Some(mut pose) = world.get_mut::<Transform>(self.alive[at]) {
            pose.translation = place;
        } else {
            panic!("one of the crowd is gone");
        }
    }
}
