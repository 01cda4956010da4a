//! The five scenes of Catoptra, and the command `catoptra` that plays, renders, measures and compares them.

pub mod cli;
pub mod game;
pub mod play;
pub mod scenes;
