//! The thread that steps the world and draws it.

mod drawing;
mod playing;
mod scale;
#[cfg(test)]
mod tests;

use super::shared::{Answer, Shared, Thumbnail};
use crate::{
    cli::Failure,
    game::{Kind, Run},
    scenes::{SCENES, SceneOptions},
};
use catoptra_render_hybrid::{Layer, RenderError, RenderSettings, Renderer, RendererOptions, image_io};
use playing::Playing;
use scale::ScaleController;
use std::{
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

/// A renderer that fails again so soon after it was made anew is given up.
const SOON: Duration = Duration::from_secs(3);

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

/// The renderer in use, and how to make another.
pub struct Machine<F> {
    /// Makes pictures.
    pub renderer: Renderer,
    /// What it was made with.
    pub options: RendererOptions,
    /// Makes one with other options, or the same one anew.
    pub make: F,
}

impl<F: FnMut(RendererOptions) -> Result<Renderer, Failure>> Machine<F> {
    /// Goes over to other options; the old renderer stays where they cannot be served.
    fn change(&mut self, options: RendererOptions) -> Result<(), Failure> {
        self.renderer = (self.make)(options)?;
        self.options = options;
        Ok(())
    }
}

/// Works until the window closes. `report` returns false when nobody listens any more. `record`: file for the first game
/// that is played.
///
/// A GPU that fails although it was asked for by name is set up anew; one that `Auto` chose gives way to the CPU by itself.
pub fn run<F: FnMut(RendererOptions) -> Result<Renderer, Failure>>(
    shared: &Arc<Shared>,
    mut machine: Machine<F>,
    options: &SceneOptions,
    mut record: Option<PathBuf>,
    report: impl Fn(Report) -> bool,
) {
    let mut playing: Option<Playing> = None;
    let mut scale = ScaleController::default();
    let (mut drawn_version, mut refined_version) = (None, None);
    let mut thumbnails = 0;
    let mut renewed: Option<Instant> = None;
    let tell = |answer: Answer| {
        shared.put_answer(answer);
        report(Report::Answer)
    };
    loop {
        let mut controls = shared.take_controls();
        let stays = |p: &Playing| p.restarts == controls.restarts && Some(&p.target) == controls.target.as_ref();
        if let Some(over) = playing.take_if(|p| controls.quit || !stays(p))
            && let Some(told) = over.finish()
        {
            tell(Answer::Told(told));
        }
        if controls.quit {
            return;
        }
        if let Some(wanted) = controls.once.machine {
            let told = match machine.change(wanted) {
                Ok(()) => format!("the renderer is set up anew: {}", machine.renderer.device()),
                Err(failure) => failure.text(),
            };
            drawn_version = None;
            tell(Answer::Machine(machine.options));
            tell(Answer::Told(told));
        }
        let Some(target) = &controls.target else {
            // The picker is open: its pictures are made while it is looked at.
            if thumbnails < SCENES.len() {
                if let Some(thumbnail) = thumbnail(&mut machine.renderer, thumbnails) {
                    tell(Answer::Thumbnail(thumbnail));
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
        for answer in playing.answer(&mut machine.renderer, &controls) {
            tell(answer);
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
        match playing.draw(&mut machine.renderer, &controls, share, start) {
            Ok(picture) => {
                if !unhurried {
                    scale.learn(controls.scale, picture.frame_ms);
                }
                shared.put_picture(picture);
                if !report(Report::Picture) {
                    return;
                }
            }
            Err(RenderError::Gpu(why)) if renewed.is_none_or(|at| at.elapsed() > SOON) => {
                renewed = Some(Instant::now());
                if let Err(failure) = machine.change(machine.options) {
                    report(Report::Failed(failure));
                    return;
                }
                let told = format!("the GPU failed ({why}): it is set up anew");
                crate::cli::note(&told);
                tell(Answer::Told(told));
                drawn_version = None;
            }
            Err(error) => {
                report(Report::Failed(error.into()));
                return;
            }
        }
    }
}

/// A small picture of a game's first level.
fn thumbnail(renderer: &mut Renderer, scene: usize) -> Option<Thumbnail> {
    let size = (320, 180);
    let run = Run::new(Kind::of(SCENES[scene].name)?, 0)?;
    let settings = RenderSettings { width: size.0, height: size.1, ..RenderSettings::default() };
    let image = renderer.render(run.scene(), &settings).ok()?.image;
    Some(Thumbnail { scene, size, rgba8: opaque(&image_io::srgb8_from_layer(Layer::Final, &image, 0.0)) })
}

fn opaque(srgb8: &[u8]) -> Vec<u8> {
    srgb8.chunks_exact(3).flat_map(|c| [c[0], c[1], c[2], 255]).collect()
}
