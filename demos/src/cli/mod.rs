//! The command line: the contract that scripts rely on.
//!
//! Results go to stdout, everything else to stderr. Exit status: 0 done, 2 wrong use, 1 anything else, the latter two with
//! one line that says what to do. An explicit choice that this machine or version cannot serve never falls back.

mod args;
mod bench;
mod compare;
mod default;
mod export;
mod failure;
mod file;
mod info;
mod judge;
mod options;
mod progress;
mod reference;
mod render;
mod replay;
mod stats;
mod target;
mod trace_file;
mod world;

pub use args::{Cli, Command, PlayArgs};
pub use failure::{Failure, note};
pub use options::{PictureArgs, Size};
pub use render::millis;
pub use target::Target;
pub use world::World;

use clap::{CommandFactory, Parser, error::ErrorKind};
use std::process::ExitCode;

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            let _ = e.print();
            return ExitCode::SUCCESS;
        }
        Err(e) => return Failure::from_clap(&e).report(),
    };
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        None => default::run(),
        Some(Command::List(args)) => info::list(&args),
        Some(Command::Info) => info::info(),
        Some(Command::Play(args)) => crate::play::run(&args),
        Some(Command::Render(args)) => render::run(&args),
        Some(Command::Bench(args)) => bench::run(&args),
        Some(Command::Reference(args)) => reference::run(&args),
        Some(Command::Judge(args)) => judge::run(&args),
        Some(Command::Compare(args)) => compare::run(&args),
        Some(Command::Export(args)) => export::run(&args),
        Some(Command::Replay(args)) => replay::run(&args),
    }
}

/// The whole command, for completions and manuals.
pub fn command() -> clap::Command {
    Cli::command()
}
