//! Many rays at once. Sixteen neighbours of one kind (signs and main axis of the direction) are a packet. Rays of a few kinds wait
//! for others of theirs from the same window of the slice. Those that have nothing in common go side by side, or one by one where the
//! trees are small.

use super::{Detected, Usable, any, any_packet, closest, closest_packet, closest_side_by_side, usable};
use crate::accel::world::World;
use crate::accel::{Hit, Ray};

/// Neighbours in the slice that are sorted together.
const WINDOW: usize = 512;
/// Signs and main axis.
const KINDS: usize = 24;
/// Sixteen neighbours of more kinds than this have nothing in common.
const LIKE: u32 = 5;
/// So many rays of a kind at the end of a window still make a packet.
const WORTH: usize = 6;

/// What is asked of each ray.
pub(super) trait Question {
    type Answer: Copy;
    const BLANK: Self::Answer;
    /// Answers eight or sixteen rays, or none of them.
    fn packet(level: Detected, world: &World, rays: &[Ray], answers: &mut [Self::Answer]) -> bool;
    /// Answers rays by their numbers.
    fn others(level: Detected, world: &World, rays: &[Ray], numbers: &[u32], answers: &mut [Self::Answer]);
    fn one(level: Detected, world: &World, ray: &Ray) -> Self::Answer;
}

pub(super) struct Closest;
impl Question for Closest {
    type Answer = Hit;
    const BLANK: Hit = Hit::MISS;
    #[inline(always)]
    fn packet(level: Detected, world: &World, rays: &[Ray], answers: &mut [Hit]) -> bool {
        closest_packet(level, world, rays, answers)
    }
    fn others(level: Detected, world: &World, rays: &[Ray], numbers: &[u32], answers: &mut [Hit]) {
        if world.bytes >= world.side_by_side_from {
            closest_side_by_side(level, world, rays, numbers, answers);
        } else {
            numbers.iter().for_each(|&n| answers[n as usize] = closest(level, world, &rays[n as usize]));
        }
    }
    fn one(level: Detected, world: &World, ray: &Ray) -> Hit {
        closest(level, world, ray)
    }
}

pub(super) struct Any;
impl Question for Any {
    type Answer = bool;
    const BLANK: bool = false;
    #[inline(always)]
    fn packet(level: Detected, world: &World, rays: &[Ray], answers: &mut [bool]) -> bool {
        any_packet(level, world, rays, answers)
    }
    fn others(level: Detected, world: &World, rays: &[Ray], numbers: &[u32], answers: &mut [bool]) {
        numbers.iter().for_each(|&n| answers[n as usize] = any(level, world, &rays[n as usize]));
    }
    fn one(level: Detected, world: &World, ray: &Ray) -> bool {
        any(level, world, ray)
    }
}

#[inline(always)]
fn kind(ray: &Ray) -> u8 {
    let d = ray.direction;
    let (x, y, z) = (d.x.abs(), d.y.abs(), d.z.abs());
    let main = match (y <= x && z <= x, z <= y) {
        (true, _) => 0,
        (false, true) => 8,
        (false, false) => 16,
    };
    main + (u8::from(d.x < 0.0) | u8::from(d.y < 0.0) << 1 | u8::from(d.z < 0.0) << 2)
}

/// Rays of a window that wait.
struct Waiting {
    /// By kind: numbers of rays, fewer than sixteen.
    bins: [[u16; 16]; KINDS],
    len: [u8; KINDS],
    /// Those that go side by side.
    others: [u32; WINDOW],
    count: usize,
}

/// Asks it of all rays.
pub(super) fn all<Q: Question>(level: Detected, world: &World, rays: &[Ray], answers: &mut [Q::Answer]) {
    for (rays, answers) in rays.chunks(WINDOW).zip(answers.chunks_mut(WINDOW)) {
        let mut waiting = None;
        let (packets, rest) = rays.as_chunks::<16>();
        for (i, packet) in packets.iter().enumerate() {
            // A look at two spares most of those that are no packet the attempt.
            let alike = kind(&packet[0]) == kind(&packet[15]);
            if !(alike && Q::packet(level, world, packet, &mut answers[16 * i..16 * i + 16])) {
                waiting.get_or_insert_with(Waiting::new).take::<Q>(level, world, rays, 16 * i..16 * i + 16, answers);
            }
        }
        if !rest.is_empty() {
            let from = rays.len() - rest.len();
            waiting.get_or_insert_with(Waiting::new).take::<Q>(level, world, rays, from..rays.len(), answers);
        }
        if let Some(waiting) = waiting {
            waiting.finish::<Q>(level, world, rays, answers);
        }
    }
    level.tally(world);
}

impl Waiting {
    #[inline(always)]
    fn new() -> Self {
        Self { bins: [[0; 16]; KINDS], len: [0; KINDS], others: [0; WINDOW], count: 0 }
    }

    /// Neighbours that are no packet.
    fn take<Q: Question>(
        &mut self,
        level: Detected,
        world: &World,
        rays: &[Ray],
        range: std::ops::Range<usize>,
        answers: &mut [Q::Answer],
    ) {
        let mut kinds = [0u8; 16];
        let mut seen = 0u32;
        for (k, ray) in kinds.iter_mut().zip(&rays[range.clone()]) {
            *k = kind(ray);
            seen |= 1 << *k;
        }
        for (number, k) in range.zip(kinds) {
            let ray = &rays[number];
            if !matches!(usable(ray), Usable::Yes) {
                answers[number] = Q::one(level, world, ray);
            } else if seen.count_ones() > LIKE {
                self.others[self.count] = number as u32;
                self.count += 1;
            } else {
                let k = usize::from(k);
                self.bins[k][usize::from(self.len[k])] = number as u16;
                self.len[k] += 1;
                if self.len[k] == 16 {
                    self.packet::<Q>(level, world, k, rays, answers);
                }
            }
        }
    }

    /// What a bin holds as a packet of sixteen or eight, the last ray again and again where they are fewer.
    fn packet<Q: Question>(
        &mut self,
        level: Detected,
        world: &World,
        k: usize,
        rays: &[Ray],
        answers: &mut [Q::Answer],
    ) {
        let (bin, len) = (&self.bins[k], usize::from(self.len[k]));
        self.len[k] = 0;
        let number = |i: usize| usize::from(bin[i.min(len - 1)]);
        let packet: [Ray; 16] = std::array::from_fn(|i| rays[number(i)]);
        let mut found = [Q::BLANK; 16];
        let size = if len <= 8 { 8 } else { 16 };
        if Q::packet(level, world, &packet[..size], &mut found[..size]) {
            (0..len).for_each(|i| answers[number(i)] = found[i]);
        } else {
            (0..len).for_each(|i| answers[number(i)] = Q::one(level, world, &packet[i]));
        }
    }

    /// The end of the window.
    fn finish<Q: Question>(mut self, level: Detected, world: &World, rays: &[Ray], answers: &mut [Q::Answer]) {
        for k in 0..KINDS {
            let len = usize::from(self.len[k]);
            if len >= WORTH {
                self.packet::<Q>(level, world, k, rays, answers);
            } else {
                for i in 0..len {
                    self.others[self.count] = u32::from(self.bins[k][i]);
                    self.count += 1;
                }
            }
        }
        if self.count != 0 {
            Q::others(level, world, rays, &self.others[..self.count], answers);
        }
    }
}
