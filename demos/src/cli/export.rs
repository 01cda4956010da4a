//! `export`: a posed frame as GLB.

use super::{args::ExportArgs, failure::Failure, target::Target, world::World};
use catoptra_engine::gltf;

/// Runs `export`.
pub fn run(args: &ExportArgs) -> Result<(), Failure> {
    if args.file.extension().is_none_or(|e| !e.eq_ignore_ascii_case("glb")) {
        return Err(Failure::usage(format!("{}: export writes a file that ends in .glb", args.file.display())));
    }
    let target = Target::parse_one(&args.target)?;
    let mut world = World::open(&target, &args.scene.options_for(std::slice::from_ref(&target))?)?;
    world.advance_to(args.frame);
    world.scene().validate()?;
    gltf::export_glb(world.scene(), &args.file)?;
    Ok(())
}
