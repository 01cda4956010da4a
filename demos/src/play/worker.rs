//! The thread that steps the world and draws it.

use super::{
    overlay::Overlay,
    pose::InBetween,
    shared::{Answer, Controls, Hud, Picture, SaveAs, Scale, Shared, Thumbnail},
};
use crate::{
    cli::{Failure, Target, World, millis},
    game::{Action, Kind, Pointer, Recording, Run, replay},
    scenes::{SCENES, SceneOptions},
};
use catoptra_engine::{RenderScene, bevy_app::App};
use catoptra_render_hybrid::{
    Layer, MomentOptions, Preset, RenderSettings, Renderer, image_io, trace::explain::RayTree,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

/// Length of a step.
const STEP: f64 = 1.0 / 60.0;
/// Steps made at most for one picture: where drawing is slower, the world runs slower rather than in jumps.
const MAX_STEPS: u32 = 6;
/// Least share of the window's side that is drawn.
const MIN_SCALE: f32 = 0.25;

/// What the worker tells the window's thread.
#[derive(Debug)]
pub enum Report {
    /// A picture lies in the mailbox.
    Picture,
    /// An answer lies in the mailbox.
    Answer,
    /// The target cannot be played; the picker opens again.
    Unplayable(String),
    /// The renderer failed for good.
    Failed(Failure),
}

/// Works until the window closes. `report` returns false when nobody listens any more. `record`: file for the first game
/// that is played.
pub fn run(
    shared: &Arc<Shared>,
    mut renderer: Renderer,
    options: &SceneOptions,
    record: Option<PathBuf>,
    report: impl Fn(Report) -> bool,
) {
    let mut playing: Option<Playing> = None;
    let mut scale = ScaleController::default();
    let (mut drawn_version, mut refined_version) = (None, None);
    let mut thumbnails = 0;
    let mut record = record;
    loop {
        let mut controls = shared.take_controls();
        let stays = |p: &Playing| p.restarts == controls.restarts && Some(&p.target) == controls.target.as_ref();
        if let Some(over) = playing.take_if(|p| controls.quit || !stays(p))
            && let Some(told) = over.finish()
        {
            shared.put_answer(Answer::Told(told));
            report(Report::Answer);
        }
        if controls.quit {
            return;
        }
        let Some(target) = &controls.target else {
            // The picker is open: its pictures are made while it is looked at.
            if thumbnails < SCENES.len() {
                if let Some(thumbnail) = thumbnail(&mut renderer, thumbnails) {
                    shared.put_answer(Answer::Thumbnail(thumbnail));
                    report(Report::Answer);
                }
                thumbnails += 1;
            } else {
                shared.wait_for_change(controls.version, Duration::from_secs(1));
            }
            continue;
        };
        if playing.is_none() {
            match Playing::open(target, &controls, options, &mut record) {
                Ok(opened) => playing = Some(opened),
                Err(failure) => {
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
        let moved = playing.pass_time(&mut controls);
        for answer in playing.answer(&mut renderer, &controls) {
            shared.put_answer(answer);
            report(Report::Answer);
        }
        let again = !moved && drawn_version == Some(controls.version);
        if again && refined_version == Some(controls.version) {
            playing.last = Instant::now();
            shared.wait_for_change(controls.version, Duration::from_millis(250));
            continue;
        }
        drawn_version = Some(controls.version);
        // Where nothing moves any more there is time for the whole size; on the win screen for more than half of it.
        let share = scale.share(controls.scale);
        let calm = if again { 1.0 } else { 0.6 };
        let unhurried = again || playing.won();
        let share = if unhurried { share.max(calm) } else { share };
        if again {
            refined_version = drawn_version;
        }
        match playing.draw(&mut renderer, &controls, share, start) {
            Ok(picture) => {
                if !unhurried {
                    scale.learn(controls.scale, picture.frame_ms);
                }
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

/// A small picture of a game's first level.
fn thumbnail(renderer: &mut Renderer, scene: usize) -> Option<Thumbnail> {
    let size = (256, 144);
    let run = Run::new(Kind::of(SCENES[scene].name)?, 0)?;
    let settings = RenderSettings { width: size.0, height: size.1, ..RenderSettings::default() };
    let image = renderer.render(run.scene(), &settings).ok()?.image;
    Some(Thumbnail { scene, size, rgba8: opaque(&image_io::srgb8_from_layer(Layer::Final, &image, 0.0)) })
}

fn opaque(srgb8: &[u8]) -> Vec<u8> {
    srgb8.chunks_exact(3).flat_map(|c| [c[0], c[1], c[2], 255]).collect()
}

/// What runs: a world to look at, or a game.
enum Content {
    Watched(Box<World>),
    Game(Box<Run>, Option<(PathBuf, Recording)>),
}

impl Content {
    fn won(&self) -> bool {
        matches!(self, Self::Game(run, _) if run.at_rest() && run.session().won())
    }

    fn app_mut(&mut self) -> &mut App {
        match self {
            Self::Watched(world) => world.app_mut(),
            Self::Game(run, _) => run.app_mut(),
        }
    }

    fn scene(&self) -> &RenderScene {
        match self {
            Self::Watched(world) => world.scene(),
            Self::Game(run, _) => run.scene(),
        }
    }

    fn steps(&self) -> u64 {
        match self {
            Self::Watched(world) => world.frame(),
            Self::Game(run, _) => run.steps(),
        }
    }

    fn step(&mut self, actions: &[Action]) {
        match self {
            Self::Watched(world) => world.advance(1),
            Self::Game(run, recording) => {
                if let Some((_, recording)) = recording {
                    recording.push(actions);
                }
                run.step(actions);
            }
        }
    }
}

struct Playing {
    target: Target,
    restarts: u32,
    content: Content,
    between: InBetween,
    /// When time was last looked at.
    last: Instant,
    /// Time that has passed and is not yet stepped, seconds.
    owed: f64,
    physics_ms: f64,
    /// Actions for the next step.
    actions: Vec<Action>,
}

impl Playing {
    fn open(
        target: &Target,
        controls: &Controls,
        options: &SceneOptions,
        record: &mut Option<PathBuf>,
    ) -> Result<Self, Failure> {
        let game = match target {
            Target::Scene(name) if controls.game => Kind::of(name),
            _ => None,
        };
        let content = match game {
            Some(kind) => {
                let run = Run::new(kind, 0).ok_or_else(|| Failure::other("the game has no levels"))?;
                let recording = record.take().and_then(|path| Some((path, Recording::begin(kind, 0)?)));
                Content::Game(Box::new(run), recording)
            }
            None => Content::Watched(Box::new(World::open(target, options)?)),
        };
        content.scene().validate()?;
        Ok(Self {
            target: target.clone(),
            restarts: controls.restarts,
            content,
            between: InBetween::default(),
            last: Instant::now(),
            owed: 0.0,
            physics_ms: 0.0,
            actions: Vec::new(),
        })
    }

    /// Ends the game: writes its recording with the hashes that it leads to. Returns what the user should know.
    fn finish(mut self) -> Option<String> {
        self.between.restore(self.content.app_mut());
        let Content::Game(run, Some((path, mut recording))) = self.content else { return None };
        let write = |recording: &Recording| {
            let part = path.with_extension("part");
            std::fs::write(&part, recording.to_string()).and_then(|()| std::fs::rename(&part, &path)).map_err(|e| {
                let _ = std::fs::remove_file(&part);
                format!("cannot write {}: {e}", path.display())
            })
        };
        // First the actions alone: what follows takes a while.
        let told = write(&recording).and_then(|()| {
            let end = replay(&recording, 0).map_err(|e| e.to_string())?;
            (recording.state, recording.frame) = (Some(end.state), Some(end.frame));
            write(&recording)?;
            let s = run.session();
            if (end.moves, end.won, end.level) != (s.moves, s.won(), run.number()) {
                return Err("the recording does not come to the same end as the game".into());
            }
            Ok(format!("wrote {} ({} steps)", path.display(), recording.steps))
        });
        let told = told.unwrap_or_else(|why| why);
        crate::cli::note(&told);
        Some(told)
    }

    /// A game that is won and at rest.
    fn won(&self) -> bool {
        self.content.won()
    }

    /// Makes the steps that are due and shows the world in between. Returns whether anything may look different.
    fn pass_time(&mut self, controls: &mut Controls) -> bool {
        let start = Instant::now();
        let passed = (start - self.last).as_secs_f64();
        self.last = start;
        let (steps, alpha) = if controls.paused {
            self.owed = 0.0;
            (controls.once.steps, 1.0)
        } else {
            self.owed += passed;
            let due = (self.owed / STEP) as u32;
            let steps = due.min(MAX_STEPS);
            // What cannot be caught up with is forgotten.
            self.owed = if due > MAX_STEPS { 0.0 } else { self.owed - f64::from(steps) * STEP };
            (steps, (self.owed / STEP) as f32)
        };
        self.between.restore(self.content.app_mut());
        self.hear(controls);
        for _ in 0..steps {
            let actions = std::mem::take(&mut self.actions);
            self.content.step(&actions);
        }
        let moving = !controls.paused || steps > 0;
        self.between.show(self.content.app_mut(), alpha);
        self.physics_ms = millis(start);
        moving
    }

    /// Takes the player's actions and what he pointed at.
    fn hear(&mut self, controls: &mut Controls) {
        let Content::Game(run, _) = &self.content else { return };
        self.actions.append(&mut controls.once.actions);
        for [u, v] in controls.once.clicks.drain(..) {
            let (w, h) = controls.window;
            let (origin, direction) = run.scene().camera.ray(u * w as f32, v * h as f32, w, h);
            self.actions.extend(run.pointed(&Pointer { origin, direction }));
        }
    }

    /// What was asked for once beside steps and actions.
    fn answer(&mut self, renderer: &mut Renderer, controls: &Controls) -> Vec<Answer> {
        let mut answers = Vec::new();
        if let Some([u, v]) = controls.once.explain {
            let settings = self.settings(controls, 1.0);
            let scene = self.seen(controls);
            let pixel = |share: f32, side: u32| ((share * side as f32) as u32).min(side - 1);
            let (x, y) = (pixel(u, settings.width), pixel(v, settings.height));
            answers.push(match renderer.explain(&scene, &settings, x, y) {
                Ok(tree) => {
                    let names = names(&scene, &tree);
                    Answer::Tree(tree, names)
                }
                Err(e) => Answer::Told(e.to_string()),
            });
        }
        if let Some(format) = controls.once.save {
            let told = self.save(renderer, controls, format).unwrap_or_else(|e| e.text());
            crate::cli::note(&told);
            answers.push(Answer::Told(told));
        }
        answers
    }

    /// Writes the photo at the window's size, at the high preset where that is asked for.
    fn save(&self, renderer: &mut Renderer, controls: &Controls, format: SaveAs) -> Result<String, Failure> {
        let settings = RenderSettings { keep_layers: false, ..self.settings(controls, 1.0) };
        let image = renderer.render(&self.seen(controls), &settings)?.image;
        std::fs::create_dir_all("out")?;
        let stem = format!("out/{}-photo-{:04}", self.target.name(), self.content.steps());
        let ending = if format == SaveAs::Png { "png" } else { "exr" };
        // A second photo of the same moment does not overwrite the first.
        let free =
            (0..10_000).map(|n| if n == 0 { format!("{stem}.{ending}") } else { format!("{stem}-{n}.{ending}") });
        let path =
            free.map(PathBuf::from).find(|p| !p.exists()).ok_or_else(|| Failure::other("out is full of photos"))?;
        match format {
            SaveAs::Png => {
                let srgb8 = image_io::srgb8_from_layer(Layer::Final, &image, controls.exposure_ev);
                image_io::write_png(&path, image.width, image.height, &srgb8)?;
            }
            SaveAs::Exr => image_io::write_exr(Path::new(&path), &image)?,
        }
        Ok(format!("wrote {} ({}x{})", path.display(), image.width, image.height))
    }

    /// The scene as the controls look at it.
    fn seen(&self, controls: &Controls) -> std::borrow::Cow<'_, RenderScene> {
        let scene = self.content.scene();
        match &controls.photo {
            None => std::borrow::Cow::Borrowed(scene),
            Some(photo) => {
                let mut own = scene.clone();
                own.camera = photo.camera(scene.camera.near);
                std::borrow::Cow::Owned(own)
            }
        }
    }

    /// Settings of a picture whose side is a share of the window's.
    fn settings(&self, controls: &Controls, share: f32) -> RenderSettings {
        let mut settings = controls.settings;
        if controls.photo.is_some_and(|p| p.high) {
            settings = RenderSettings::preset(Preset::High);
        }
        settings.keep_layers = controls.layer != Layer::Final;
        let side = |pixels: u32| ((pixels as f32 * share) as u32).clamp(1, 16384);
        (settings.width, settings.height) = (side(controls.window.0), side(controls.window.1));
        settings
    }

    fn draw(
        &mut self,
        renderer: &mut Renderer,
        controls: &Controls,
        share: f32,
        start: Instant,
    ) -> Result<Picture, Failure> {
        let mut settings = self.settings(controls, share);
        if let Scale::Hold(_) = controls.scale {
            settings.moments = scaled(settings.moments, share);
        }
        let scene = self.seen(controls);
        let frame = renderer.render(&scene, &settings)?;
        let shown = frame.layer(controls.layer).unwrap_or(&frame.image);
        let rgba8 = opaque(&image_io::srgb8_from_layer(controls.layer, shown, controls.exposure_ev));
        let frame_ms = millis(start);
        let aspect = settings.width as f32 / settings.height as f32;
        let overlay = if controls.boxes.is_some() || controls.dots {
            Overlay::new(renderer, &scene, aspect, controls.boxes, controls.dots)
        } else {
            Overlay::default()
        };
        let hud = match &self.content {
            Content::Game(run, _) => Some(Hud::of(run.session(), run.kind(), run.number(), run.at_rest())),
            Content::Watched(_) => None,
        };
        Ok(Picture {
            width: shown.width,
            height: shown.height,
            rgba8,
            name: self.target.name(),
            frame: self.content.steps(),
            physics_ms: self.physics_ms,
            frame_ms,
            stats: frame.stats,
            camera: scene.camera,
            hud,
            overlay,
        })
    }
}

/// What the places of a ray tree are called: instance and material in words.
fn names(scene: &RenderScene, tree: &RayTree) -> Vec<String> {
    let name = |node: &catoptra_render_hybrid::trace::explain::RayNode| {
        let Some(m) = node.material.and_then(|m| scene.materials.get(m as usize)) else {
            return "nothing: background".into();
        };
        let kind = match m {
            m if m.unlit => "lamp".to_string(),
            m if m.mirror > 0.0 && m.mirror < 1.0 => format!("mirror {:.0}%, matte", m.mirror * 100.0),
            m if m.mirror > 0.0 => "mirror".into(),
            m if m.transmission > 0.0 => format!("glass of index {:.2}", m.ior),
            _ => "matte".into(),
        };
        format!("{kind} (instance {}, material {})", node.instance.unwrap_or(0), node.material.unwrap_or(0))
    };
    tree.nodes.iter().map(name).collect()
}

/// Shadow maps as fine as the picture: halved with every halving of its side, down to an eighth. On the CPU lane they cost
/// as much as a picture of their own size.
fn scaled(moments: MomentOptions, share: f32) -> MomentOptions {
    let divisor = match share {
        s if s > 0.71 => 1,
        s if s > 0.5 => 2,
        s if s > 0.36 => 4,
        _ => 8,
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
        Self { share: 0.3 }
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
