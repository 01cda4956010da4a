//! What the two threads of `play` tell each other.

use super::{PlayError, overlay::Overlay};
use crate::{
    cli::{PictureArgs, Size, Target},
    game::{Action, Kind, Session, State},
};
use catoptra_engine::{Camera, math};
use catoptra_render_hybrid::{
    FrameStats, Layer, RasterLane, RenderSettings, Renderer, RendererOptions, Tracer, trace::explain::RayTree,
};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Window that opens where no size was asked for.
const DEFAULT_SIZE: Size = Size(1280, 720);

/// How large the picture is drawn, as a share of the window's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// As large as holds so many frames a second.
    Hold(f32),
    /// So large, however long it takes.
    Fixed(f32),
}

/// What is asked for once: done by the worker once, whatever wishes follow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Requests {
    /// Single steps while time stands still.
    pub steps: u32,
    /// What the player does.
    pub actions: Vec<Action>,
    /// Places of the picture that the player pointed at, in [0, 1] from the top left corner.
    pub clicks: Vec<[f32; 2]>,
    /// A place of the picture to explain.
    pub explain: Option<[f32; 2]>,
    /// A still of the photo mode to write.
    pub save: Option<SaveAs>,
    /// Another lane or tracer, or the same set up anew.
    pub machine: Option<RendererOptions>,
}

impl Requests {
    fn add(&mut self, mut earlier: Self) {
        self.steps += earlier.steps;
        earlier.actions.append(&mut self.actions);
        self.actions = earlier.actions;
        earlier.clicks.append(&mut self.clicks);
        self.clicks = earlier.clicks;
        self.explain = self.explain.take().or(earlier.explain);
        self.save = self.save.take().or(earlier.save);
        self.machine = self.machine.take().or(earlier.machine);
    }
}

/// Format of a still.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum SaveAs {
    Png,
    Exr,
}

/// A free camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Photo {
    /// Where it stands, world metres.
    pub eye: glam::Vec3,
    /// Turn about +Y and then about its own X, radians.
    pub yaw: f32,
    /// See `yaw`.
    pub pitch: f32,
    /// Vertical field of view, degrees.
    pub fov: f32,
    /// The high preset, which takes its time.
    pub high: bool,
    /// Exposure in stops to go back to afterwards.
    pub before_ev: f32,
}

impl Photo {
    /// From a camera of the world, and the exposure that it is seen with.
    pub fn of(camera: &Camera, before_ev: f32) -> Self {
        let d = -camera.world_from_view.matrix3.z_axis;
        let fov = match camera.projection {
            catoptra_engine::Projection::Perspective { fov_y } => fov_y.to_degrees(),
            catoptra_engine::Projection::Orthographic { .. } => 50.0,
        };
        let flat = (d.x * d.x + d.z * d.z).sqrt();
        let (yaw, pitch) = (math::atan2(-d.x, -d.z), math::atan2(d.y, flat));
        Self { eye: camera.world_from_view.translation, yaw, pitch, fov, high: false, before_ev }
    }

    /// Unit directions ahead and to the right.
    pub fn axes(&self) -> (glam::Vec3, glam::Vec3) {
        let turn = glam::Quat::from_rotation_y(self.yaw) * glam::Quat::from_rotation_x(self.pitch);
        (turn * glam::Vec3::NEG_Z, turn * glam::Vec3::X)
    }

    /// As a camera.
    pub fn camera(&self, near: f32) -> Camera {
        let (ahead, _) = self.axes();
        Camera { near, ..Camera::looking_at(self.eye, self.eye + ahead, self.fov.to_radians()) }
    }
}

/// How a game stands, for the display.
#[derive(Clone, Debug, PartialEq)]
pub struct Hud {
    /// Which game.
    pub kind: Kind,
    /// Level, from 0, and how many there are.
    pub level: (usize, usize),
    /// Name of the level.
    pub name: String,
    /// Moves so far and par.
    pub moves: (u32, u32),
    /// There is a move to take back.
    pub can_undo: bool,
    /// What the last move led to, or a hint.
    pub message: String,
    /// The level is won and all has come to rest: so many stars.
    pub won: Option<u32>,
    /// Direction and strength of the putter, where there is one.
    pub putter: Option<(u8, u8)>,
}

impl Hud {
    /// Of a session; `at_rest`: nothing moves any more.
    pub fn of(session: &Session, kind: Kind, level: usize, at_rest: bool) -> Self {
        Self {
            kind,
            level: (level, crate::game::level_count(kind)),
            name: session.level.name.clone(),
            moves: (session.moves, session.level.par),
            can_undo: session.can_undo(),
            message: session.message.clone(),
            won: (at_rest && session.won()).then(|| session.stars()),
            putter: matches!(session.state, State::Putt(_)).then_some((session.aim, session.power)),
        }
    }
}

/// What the user wants.
#[derive(Clone, Debug, PartialEq)]
pub struct Controls {
    /// What is played; `None` while the picker is open.
    pub target: Option<Target>,
    /// A scene is played as its game; else it is watched.
    pub game: bool,
    /// Counts up to start the target anew.
    pub restarts: u32,
    /// Settings of the picture; its size is `window`, times the scale.
    pub settings: RenderSettings,
    /// What the settings were at the start, for switching a stage back on.
    pub initial: RenderSettings,
    /// Which layer is shown.
    pub layer: Layer,
    /// Exposure in stops.
    pub exposure_ev: f32,
    /// Time stands still.
    pub paused: bool,
    /// What is asked for once.
    pub once: Requests,
    /// A free camera looks instead of the world's own.
    pub photo: Option<Photo>,
    /// Boxes of the two-level structure are drawn: levels of the meshes' own trees.
    pub boxes: Option<u32>,
    /// VPLs are drawn as dots.
    pub dots: bool,
    /// Size of the picture.
    pub scale: Scale,
    /// Size in pixels of the part of the window that shows the picture.
    pub window: (u32, u32),
    /// Lane and tracer as they were asked for.
    pub machine: RendererOptions,
    /// The window is closing.
    pub quit: bool,
    /// Counts changes, so that a picture of a world at rest is drawn once.
    pub version: u64,
}

impl Scale {
    /// What the setting stands for: pictures a second, or 0 for the whole window at any rate.
    pub fn of_rate(rate: f32) -> Self {
        if rate > 0.0 { Self::Hold(rate) } else { Self::Fixed(1.0) }
    }
}

impl Controls {
    /// As the command line says.
    pub fn new(target: Option<Target>, picture: &PictureArgs) -> Result<Self, PlayError> {
        let settings = picture.settings(DEFAULT_SIZE)?;
        Ok(Self {
            target,
            game: true,
            restarts: 0,
            settings,
            initial: settings,
            layer: Layer::Final,
            exposure_ev: picture.exposure,
            paused: false,
            once: Requests::default(),
            photo: None,
            boxes: None,
            dots: false,
            // An explicit size is the size of the picture, not a wish.
            scale: if picture.size.is_some() { Scale::Fixed(1.0) } else { Scale::Hold(20.0) },
            window: (settings.width, settings.height),
            machine: picture.renderer_options(),
            quit: false,
            version: 0,
        })
    }
}

/// What makes the pictures, and why it is that.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Machine {
    /// The lane that ran.
    pub lane: RasterLane,
    /// Adapter or SIMD level.
    pub device: String,
    /// The tracer that ran.
    pub tracer: Tracer,
    /// The tracer that was chosen, and why.
    pub chosen: (Tracer, String),
    /// Why another one than the chosen ran: what was too large for the adapter.
    pub fallback: Option<String>,
    /// Why the GPU lane was given up.
    pub fault: Option<String>,
}

impl Machine {
    /// Of the renderer and the figures of its last frame.
    pub fn of(renderer: &Renderer, stats: &FrameStats) -> Self {
        let choice = renderer.tracer();
        Self {
            lane: stats.raster,
            device: stats.device.clone(),
            tracer: stats.tracer,
            chosen: (choice.tracer, choice.why.clone()),
            fallback: stats.tracer_fallback.clone(),
            fault: renderer.fault().map(str::to_string),
        }
    }

    /// Lines for a user: lane, tracer, and each reason why it is that.
    pub fn lines(&self) -> Vec<String> {
        let lane = if self.lane == RasterLane::Gpu { "GPU" } else { "CPU" };
        let mut lines = vec![format!("lane: {lane}, {}", self.device)];
        let (chosen, why) = &self.chosen;
        match &self.fallback {
            Some(fallback) => {
                lines.push(format!("tracer: {} instead of {} ({why})", self.tracer.name(), chosen.name()));
                lines.push(format!("because {fallback}"));
            }
            None => lines.push(format!("tracer: {} ({why})", self.tracer.name())),
        }
        lines.extend(self.fault.as_ref().map(|fault| format!("the GPU failed, the CPU took over: {fault}")));
        lines
    }
}

/// A finished picture.
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// sRGB bytes and full opacity, `[height][width][4]`.
    pub rgba8: Vec<u8>,
    /// Name of what is shown.
    pub name: String,
    /// Steps made so far.
    pub frame: u64,
    /// What made it.
    pub machine: Machine,
    /// The renderer's figures.
    pub stats: FrameStats,
    /// Steps and extraction, milliseconds.
    pub physics_ms: f64,
    /// From steps to bytes, milliseconds.
    pub frame_ms: f64,
    /// The camera that looked.
    pub camera: Camera,
    /// The game, where one is played.
    pub hud: Option<Hud>,
    /// Lines and dots over the picture.
    pub overlay: Overlay,
}

/// A small picture of a scene for the picker.
pub struct Thumbnail {
    /// The scene's place in the list.
    pub scene: usize,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// sRGB bytes and full opacity, `[height][width][4]`.
    pub rgba8: Vec<u8>,
}

/// Answers to [`Requests`].
pub enum Answer {
    /// Rays behind a pixel, and what their instances and materials are called.
    Tree(RayTree, Vec<String>),
    /// Something for the user to read.
    Told(String),
    /// For the picker.
    Thumbnail(Thumbnail),
    /// Lane and tracer that are in use from now on, whether they were asked for or not.
    Machine(RendererOptions),
}

/// The two mailboxes.
pub struct Shared {
    controls: Mutex<Controls>,
    changed: Condvar,
    picture: Mutex<Option<Picture>>,
    answers: Mutex<Vec<Answer>>,
}

impl Shared {
    /// Empty, with the first wishes.
    pub fn new(controls: Controls) -> Self {
        Self {
            controls: Mutex::new(controls),
            changed: Condvar::new(),
            picture: Mutex::new(None),
            answers: Mutex::default(),
        }
    }

    /// A copy of the wishes; what is asked for once is taken out.
    pub fn take_controls(&self) -> Controls {
        let mut controls = lock(&self.controls);
        let copy = controls.clone();
        controls.once = Requests::default();
        copy
    }

    /// Replaces the wishes and wakes the worker.
    pub fn set_controls(&self, mut wanted: Controls) {
        let mut controls = lock(&self.controls);
        wanted.version = controls.version + 1;
        // What is not yet taken out is still to be done.
        wanted.once.add(std::mem::take(&mut controls.once));
        *controls = wanted;
        self.changed.notify_all();
    }

    /// Waits for other wishes than those of `version`, at most for `timeout`.
    pub fn wait_for_change(&self, version: u64, timeout: std::time::Duration) {
        let controls = lock(&self.controls);
        let _ = self.changed.wait_timeout_while(controls, timeout, |c| c.version == version && !c.quit);
    }

    /// Leaves a picture; one that nobody looked at is dropped.
    pub fn put_picture(&self, picture: Picture) {
        *lock(&self.picture) = Some(picture);
    }

    /// Leaves an answer.
    pub fn put_answer(&self, answer: Answer) {
        lock(&self.answers).push(answer);
    }

    /// Takes all answers.
    pub fn take_answers(&self) -> Vec<Answer> {
        std::mem::take(&mut lock(&self.answers))
    }

    /// Takes the newest picture.
    pub fn take_picture(&self) -> Option<Picture> {
        lock(&self.picture).take()
    }
}

/// A thread that died while it held the lock left whole values behind: they are only ever replaced.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_done_once_in_order_and_never_lost() {
        let shared = Shared::new(Controls::new(None, &PictureArgs::default()).unwrap_or_else(|_| panic!()));
        let mut wanted = shared.take_controls();
        wanted.once = Requests { steps: 1, actions: vec![Action::Undo], ..Default::default() };
        shared.set_controls(wanted.clone());
        wanted.once.actions = vec![Action::Hint];
        shared.set_controls(wanted);
        let taken = shared.take_controls().once;
        assert_eq!((taken.steps, taken.actions), (2, vec![Action::Undo, Action::Hint]));
        assert_eq!(shared.take_controls().once, Requests::default());
    }

    #[test]
    fn the_free_camera_begins_where_the_world_s_own_stands() {
        let eye = glam::Vec3::new(1.0, 2.0, 3.0);
        let own = Camera::looking_at(eye, glam::Vec3::new(-0.5, 0.5, -1.0), 0.8);
        let free = Photo::of(&own, 0.0).camera(own.near);
        let (a, b) = (own.world_from_view, free.world_from_view);
        assert!((a.translation - b.translation).length() < 1e-5);
        assert!((a.matrix3.z_axis - b.matrix3.z_axis).length() < 1e-5);
    }
}
