//! `judge`: the hybrid picture against the path-traced truth, as a table.

use super::{
    args::JudgeArgs,
    failure::{Failure, line, note},
    options::Size,
    reference::{self, Until},
    target::Target,
    world::World,
};
use catoptra_render_hybrid::{metrics, trace::reference::ReferenceAccumulator};

/// Side of the pictures where no size is given: a reference is dear.
const DEFAULT_SIZE: Size = Size(256, 256);
/// Halves of a reference that differ by more are too noisy to judge by (FLIP mean; usual values 0.005 to 0.05).
const GOOD_HALVES: f64 = 0.02;

/// Runs `judge`.
pub fn run(args: &JudgeArgs) -> Result<(), Failure> {
    let settings = args.picture.settings(DEFAULT_SIZE)?;
    let targets = Target::parse(&args.target)?;
    let scene_options = args.picture.scene.options_for(&targets)?;
    let mut renderer = args.picture.renderer()?;
    line(format!(
        "{:<20} {:>9} {:>6} {:>6} {:>12} {:>10} {:>9} {:>11} {:>7} {:>20}",
        "scene", "size", "frame", "spp", "halves_flip", "flip_mean", "flip_p99", "relmse", "psnr", "mean_ratio"
    ))?;
    let mut noisy = Vec::new();
    for target in &targets {
        let mut world = World::open(target, &scene_options)?;
        world.advance_to(args.frame);
        let hybrid = renderer.render(world.scene(), &settings)?.image;
        let options = reference::matching(&args.picture, &settings);
        let mut truth = ReferenceAccumulator::new(settings.width, settings.height);
        let until = Until::Spp(args.spp);
        reference::integrate(&mut renderer, world.scene(), &options, &mut truth, until, |_| true)?;
        let comparison = metrics::compare(&hybrid, &truth.image())?;
        let halves = reference::halves_flip(&truth).unwrap_or(1.0);
        if halves > GOOD_HALVES {
            noisy.push(world.name.clone());
        }
        line(format!(
            "{:<20} {:>9} {:>6} {:>6} {:>12.4} {:>10.4} {:>9.4} {:>11.4e} {:>7.2} {:>20}",
            world.name,
            Size(settings.width, settings.height).to_string(),
            args.frame,
            truth.spp(),
            halves,
            comparison.flip.mean(),
            comparison.flip.percentile(0.99),
            comparison.rel_mse,
            comparison.psnr_db,
            comparison.mean_ratio.map(|r| format!("{r:.3}")).join(",")
        ))?;
    }
    if !noisy.is_empty() {
        note(format!("the reference is too noisy to judge by for {}; raise --spp", noisy.join(", ")));
    }
    Ok(())
}
