//! The thread that steps the world and draws it.

use super::{
    pose::InBetween,
    shared::{Controls, Picture, Scale, Shared},
};
use crate::cli::{Failure, Target, World, millis};
use crate::scenes::SceneOptions;
use catoptra_render_hybrid::{Layer, MomentOptions, Renderer, image_io};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// Length of a step.
const STEP: f64 = 1.0 / 60.0;
/// Steps made at most for one picture: where drawing is slower, the world runs slower rather than in jumps.
const MAX_STEPS: u32 = 6;
/// Least share of the window's side that is drawn.
const MIN_SCALE: f32 = 0.125;

/// What the worker tells the window's thread.
#[derive(Debug)]
pub enum Report {
    /// A picture lies in the mailbox.
    Picture,
    /// The target cannot be played; the picker opens again.
    Unplayable(String),
    /// The renderer failed for good.
    Failed(Failure),
}

/// Works until the window closes. `report` returns false when nobody listens any more.
pub fn run(shared: &Arc<Shared>, mut renderer: Renderer, options: &SceneOptions, report: impl Fn(Report) -> bool) {
    let mut playing: Option<Playing> = None;
    let mut scale = ScaleController::default();
    let mut drawn_version = None;
    loop {
        let controls = shared.take_controls();
        if controls.quit {
            return;
        }
        let Some(target) = &controls.target else {
            playing = None;
            shared.wait_for_change(controls.version, Duration::from_secs(1));
            continue;
        };
        if playing.as_ref().is_none_or(|p| p.restarts != controls.restarts || p.target != *target) {
            match Playing::open(target, controls.restarts, options) {
                Ok(opened) => playing = Some(opened),
                Err(failure) => {
                    playing = None;
                    if !report(Report::Unplayable(failure.text())) {
                        return;
                    }
                    shared.wait_for_change(controls.version, Duration::from_secs(1));
                    continue;
                }
            }
            drawn_version = None;
        }
        let Some(playing) = &mut playing else { continue };
        let start = Instant::now();
        let moved = playing.pass_time(&controls);
        if !moved && drawn_version == Some(controls.version) {
            playing.last = Instant::now();
            shared.wait_for_change(controls.version, Duration::from_millis(250));
            continue;
        }
        drawn_version = Some(controls.version);
        let share = scale.share(controls.scale);
        match playing.draw(&mut renderer, &controls, share, start) {
            Ok(picture) => {
                scale.learn(controls.scale, picture.frame_ms);
                shared.put_picture(picture);
                if !report(Report::Picture) {
                    return;
                }
            }
            Err(failure) => {
                report(Report::Failed(failure));
                return;
            }
        }
    }
}

struct Playing {
    target: Target,
    restarts: u32,
    world: World,
    between: InBetween,
    /// When time was last looked at.
    last: Instant,
    /// Time that has passed and is not yet stepped, seconds.
    owed: f64,
    physics_ms: f64,
}

impl Playing {
    fn open(target: &Target, restarts: u32, options: &SceneOptions) -> Result<Self, Failure> {
        let world = World::open(target, options)?;
        world.scene().validate()?;
        let (between, last, owed) = (InBetween::default(), Instant::now(), 0.0);
        Ok(Self { target: target.clone(), restarts, world, between, last, owed, physics_ms: 0.0 })
    }

    /// Makes the steps that are due and shows the world in between. Returns whether anything may look different.
    fn pass_time(&mut self, controls: &Controls) -> bool {
        let start = Instant::now();
        let passed = (start - self.last).as_secs_f64();
        self.last = start;
        let (steps, alpha) = if controls.paused {
            self.owed = 0.0;
            (controls.steps, 1.0)
        } else {
            self.owed += passed;
            let due = (self.owed / STEP) as u32;
            let steps = due.min(MAX_STEPS);
            // What cannot be caught up with is forgotten.
            self.owed = if due > MAX_STEPS { 0.0 } else { self.owed - f64::from(steps) * STEP };
            (steps, (self.owed / STEP) as f32)
        };
        self.between.restore(self.world.app_mut());
        self.world.advance(u64::from(steps));
        let moving = !controls.paused || steps > 0;
        self.between.show(self.world.app_mut(), alpha);
        self.physics_ms = millis(start);
        moving
    }

    fn draw(
        &mut self,
        renderer: &mut Renderer,
        controls: &Controls,
        share: f32,
        start: Instant,
    ) -> Result<Picture, Failure> {
        let mut settings = controls.settings;
        settings.keep_layers = controls.layer != Layer::Final;
        let side = |pixels: u32| ((pixels as f32 * share) as u32).clamp(1, 16384);
        (settings.width, settings.height) = (side(controls.window.0), side(controls.window.1));
        if let Scale::Hold(_) = controls.scale {
            settings.moments = scaled(settings.moments, share);
        }
        let frame = renderer.render(self.world.scene(), &settings)?;
        let shown = frame.layer(controls.layer).unwrap_or(&frame.image);
        let srgb8 = image_io::srgb8_from_layer(controls.layer, shown, controls.exposure_ev);
        let mut rgba8 = vec![255; srgb8.len() / 3 * 4];
        for (to, from) in rgba8.chunks_exact_mut(4).zip(srgb8.chunks_exact(3)) {
            to[..3].copy_from_slice(from);
        }
        Ok(Picture {
            width: shown.width,
            height: shown.height,
            rgba8,
            name: self.world.name.clone(),
            frame: self.world.frame(),
            physics_ms: self.physics_ms,
            frame_ms: millis(start),
            stats: frame.stats,
        })
    }
}

/// Shadow maps as fine as the picture: halved with every halving of its side, down to a quarter. On the CPU lane they cost
/// as much as a picture of their own size.
fn scaled(moments: MomentOptions, share: f32) -> MomentOptions {
    let divisor = match share {
        s if s > 0.71 => 1,
        s if s > 0.36 => 2,
        _ => 4,
    };
    let part = |size: u32| (size / divisor).max(size.min(128));
    MomentOptions { size: part(moments.size), face_size: part(moments.face_size), ..moments }
}

/// Chooses the share of the window's side that is drawn, so that the frame rate holds.
struct ScaleController {
    share: f32,
}

impl Default for ScaleController {
    fn default() -> Self {
        // The first picture comes soon, then it grows.
        Self { share: 0.25 }
    }
}

impl ScaleController {
    fn share(&self, scale: Scale) -> f32 {
        match scale {
            Scale::Hold(_) => self.share,
            Scale::Fixed(share) => share,
        }
    }

    /// Cost is about linear in pixels. Within 20% of the goal nothing changes: every change of size costs memory traffic
    /// and shows.
    fn learn(&mut self, scale: Scale, frame_ms: f64) {
        let Scale::Hold(rate) = scale else { return };
        let ratio = (1e3 / f64::from(rate) / frame_ms.max(0.01)) as f32;
        if (0.8..1.25).contains(&ratio) {
            return;
        }
        let wanted = self.share * ratio.sqrt();
        // A slow picture is answered at once, a fast one step by step.
        let next = wanted.min(self.share * 1.2);
        let steps = 32.0;
        self.share = ((next * steps).round() / steps).clamp(MIN_SCALE, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Milliseconds of a picture of the whole window, and where the controller settles.
    fn settle(full_ms: f64) -> f32 {
        let mut controller = ScaleController::default();
        for _ in 0..100 {
            let share = controller.share(Scale::Hold(30.0));
            controller.learn(Scale::Hold(30.0), full_ms * f64::from(share * share));
        }
        controller.share
    }

    #[test]
    fn size_follows_cost() {
        assert_eq!(settle(10.0), 1.0);
        assert_eq!(settle(1e6), MIN_SCALE);
        let share = settle(133.0);
        let ms = 133.0 * f64::from(share * share);
        assert!((20.0..45.0).contains(&ms), "{share} gives {ms} ms");
        let fixed = ScaleController::default();
        assert_eq!(fixed.share(Scale::Fixed(0.7)), 0.7);
    }
}
