//! How the command ends badly, and the one way to stdout.

use catoptra_render_hybrid::RenderError;
use std::{fmt, io::Write, process::ExitCode};

/// Why a command did not do its work.
#[derive(Debug)]
pub enum Failure {
    /// Wrong use: exit status 2.
    Usage(String),
    /// Anything else: exit status 1.
    Other(anyhow::Error),
    /// The reader of stdout went away (`catoptra list | head -1`): nothing is wrong and nobody listens.
    ReaderGone,
}

impl Failure {
    /// Wrong use.
    pub fn usage(message: impl fmt::Display) -> Self {
        Self::Usage(message.to_string())
    }

    /// Anything else.
    pub fn other(message: impl fmt::Display) -> Self {
        Self::Other(anyhow::anyhow!("{message}"))
    }

    /// An explicit choice that cannot be served.
    pub fn missing(choice: &str, what: &str) -> Self {
        Self::Other(anyhow::anyhow!("{choice}: {what}"))
    }

    /// clap's report of several paragraphs as one line: its first paragraph and its tips, without the usage.
    pub fn from_clap(error: &clap::Error) -> Self {
        let text = error.to_string();
        let told = text.split("\n\nUsage:").next().unwrap_or(&text);
        let told = told.split("\n\nFor more information").next().unwrap_or(told);
        let told = told.strip_prefix("error: ").unwrap_or(told).replace("\n\n  tip:", "; tip:");
        if error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
            return Self::usage("a subcommand or an argument is missing; see `catoptra --help`");
        }
        Self::usage(format!("{}; see `catoptra --help`", one_line(&told)))
    }

    /// The one line.
    pub fn text(&self) -> String {
        match self {
            Self::Usage(message) => one_line(message),
            // Our errors carry their cause in their own text.
            Self::Other(error) => one_line(&error.to_string()),
            Self::ReaderGone => "nobody reads the output".into(),
        }
    }

    /// Prints the one line and gives the exit status.
    pub fn report(&self) -> ExitCode {
        let status = match self {
            Self::Usage(_) => 2,
            Self::Other(error) => match error.downcast_ref::<RenderError>() {
                Some(RenderError::Settings(_)) => 2,
                _ => 1,
            },
            Self::ReaderGone => return ExitCode::SUCCESS,
        };
        // A closed stderr leaves the status alone to tell.
        let _ = writeln!(std::io::stderr(), "catoptra: {}", self.text());
        ExitCode::from(status)
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Other(error.into())
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Writes one line to stdout, at once.
///
/// # Errors
/// [`Failure::ReaderGone`] where the reader closed the pipe; the system's reason otherwise.
pub fn line(text: impl fmt::Display) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Err(Failure::ReaderGone),
        Err(e) => Err(Failure::other(format!("cannot write to stdout: {e}"))),
    }
}

/// Tells something on stderr that is no failure.
pub fn note(text: impl fmt::Display) {
    let _ = writeln!(std::io::stderr(), "catoptra: {text}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn claps_paragraphs_become_one_line() {
        for bad in [&["catoptra", "rendr"][..], &["catoptra", "render"], &["catoptra", "render", "x", "--size", "0x0"]]
        {
            let error = super::super::Cli::try_parse_from(bad).unwrap_err();
            let Failure::Usage(text) = Failure::from_clap(&error) else { panic!("{error}") };
            assert!(!text.contains('\n') && !text.contains("Usage") && text.len() > 20, "{text}");
        }
    }
}
