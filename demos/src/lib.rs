//! The five scenes of Catoptra and what the `catoptra` command is made of.

pub mod scenes;
