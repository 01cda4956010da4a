//! `compare`: how far two pictures lie apart.

use super::{
    args::CompareArgs,
    failure::{Failure, line},
};
use catoptra_render_hybrid::{image_io, metrics};

/// Runs `compare`: one line `flip_mean=F flip_p99=F relmse=E psnr=DB mean_ratio=R,G,B`; B is the reference.
pub fn run(args: &CompareArgs) -> Result<(), Failure> {
    let a = image_io::read_image(&args.a)?;
    let b = image_io::read_image(&args.b)?;
    let comparison = metrics::compare_loaded(&a, &b)?;
    let flip = &comparison.flip;
    if let Some(path) = &args.heat {
        image_io::write_png(path, flip.width, flip.height, &flip.heat_map())?;
    }
    line(format!(
        "flip_mean={:.6} flip_p99={:.6} relmse={:.6e} psnr={:.3} mean_ratio={:.4},{:.4},{:.4}",
        flip.mean(),
        flip.percentile(0.99),
        comparison.rel_mse,
        comparison.psnr_db,
        comparison.mean_ratio[0],
        comparison.mean_ratio[1],
        comparison.mean_ratio[2]
    ))
}
