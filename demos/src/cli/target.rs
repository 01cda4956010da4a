//! What a command works on: a scene, all of them, or a file.

use super::failure::Failure;
use crate::scenes::SCENES;
use std::path::{Path, PathBuf};

/// One thing to draw.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// One of the five scenes, by name.
    Scene(&'static str),
    /// A glTF or GLB file.
    File(PathBuf),
}

impl Target {
    /// Reads `SCENE|all|FILE.glb`.
    ///
    /// # Errors
    /// An unknown scene (wrong use), with the nearest name.
    pub fn parse(text: &str) -> Result<Vec<Self>, Failure> {
        if text == "all" {
            return Ok(SCENES.iter().map(|s| Self::Scene(s.name)).collect());
        }
        if let Some(info) = SCENES.iter().find(|s| s.name == text) {
            return Ok(vec![Self::Scene(info.name)]);
        }
        let path = Path::new(text);
        let ends = path.extension().map(|e| e.to_ascii_lowercase());
        let looks_like_file = ends.is_some_and(|e| e == "glb" || e == "gltf") || path.components().count() > 1;
        if looks_like_file || path.is_file() {
            return Ok(vec![Self::File(path.into())]);
        }
        Err(Failure::usage(unknown_scene(text)))
    }

    /// As [`Target::parse`], but exactly one.
    ///
    /// # Errors
    /// Also for `all`.
    pub fn parse_one(text: &str) -> Result<Self, Failure> {
        let mut targets = Self::parse(text)?;
        match targets.pop() {
            Some(target) if targets.is_empty() => Ok(target),
            _ => Err(Failure::usage("this works on one scene at a time; name it instead of `all`")),
        }
    }

    /// Name in output and file names: the scene's, or the file's stem.
    pub fn name(&self) -> String {
        match self {
            Self::Scene(name) => (*name).to_string(),
            Self::File(path) => path.file_stem().map_or_else(|| "file".into(), |s| s.to_string_lossy().into_owned()),
        }
    }
}

/// The line for a name that is no scene's.
pub fn unknown_scene(text: &str) -> String {
    let names = SCENES.map(|s| s.name);
    let nearest = names.iter().chain(&["all"]).map(|n| (edit_distance(text, n), *n)).min();
    match nearest {
        Some((distance, name)) if distance <= 2 + name.len() / 3 => {
            format!("there is no scene {text:?}; did you mean `{name}`? (`catoptra list` shows all)")
        }
        _ => format!("there is no scene {text:?}; there are {}, and `all`", names.join(", ")),
    }
}

/// Least number of inserted, removed and changed characters that make `b` of `a` (Levenshtein).
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let change = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances() {
        for (a, b, d) in [("", "", 0), ("", "abc", 3), ("kitten", "sitting", 3), ("abc", "abc", 0), ("ab", "ba", 2)] {
            assert_eq!((edit_distance(a, b), edit_distance(b, a)), (d, d), "{a} {b}");
        }
    }

    #[test]
    fn targets() {
        assert_eq!(Target::parse("all").unwrap().len(), 5);
        assert_eq!(Target::parse("two-spheres").unwrap(), [Target::Scene("two-spheres")]);
        let file = Target::parse_one("some/where/thing.one.GLB").unwrap();
        assert_eq!(file.name(), "thing.one");
        assert!(matches!(Target::parse_one("all"), Err(Failure::Usage(_))));
        let Err(Failure::Usage(text)) = Target::parse("rolling-bx") else { panic!() };
        assert!(text.contains("`rolling-box`"), "{text}");
        let Err(Failure::Usage(text)) = Target::parse("cornell") else { panic!() };
        assert!(text.contains("two-spheres"), "{text}");
    }
}
