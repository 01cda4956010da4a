//! What is remembered between runs: keys, window, results. A text file (JSON) in the user's configuration folder.
//!
//! **Contract:** whatever lies there, `play` starts, says in one notice what was wrong, and loses nothing of the user's: a file
//! that cannot be understood is put aside under another name, entries that this version does not know are kept as they are,
//! and a file that cannot be written leaves the settings of this run in memory.

use super::keys::{Command, KeyMap};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// The version that is written.
const VERSION: u64 = 2;

/// Best result of a level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Best {
    /// Fewest moves.
    pub moves: u32,
    /// Most stars.
    pub stars: u32,
}

/// The settings of a user.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Which key does what.
    pub keys: KeyMap,
    /// The window fills the screen.
    pub fullscreen: bool,
    /// Pictures wait for the screen.
    pub vsync: bool,
    /// The panel is open.
    pub panel: bool,
    /// Pictures a second that the size of the picture follows; 0: always the whole window.
    pub rate: f32,
    /// Best results, by `SCENE/LEVEL`.
    pub best: Map<String, Value>,
    /// Entries of other versions, kept.
    other: Map<String, Value>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            keys: KeyMap::default(),
            fullscreen: false,
            vsync: true,
            panel: false,
            rate: 20.0,
            best: Map::new(),
            other: Map::new(),
        }
    }
}

impl Settings {
    /// Reads the file. Returns what could be used and, where something was odd, one line for the user.
    pub fn load(path: &Path) -> (Self, Option<String>) {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                return (Self::default(), Some(format!("settings will be kept in {}", path.display())));
            }
            Err(e) if e.kind() == std::io::ErrorKind::InvalidData => return Self::put_aside(path, "it is not text"),
            Err(e) => {
                return (Self::default(), Some(format!("{} cannot be read ({e}): standard settings", path.display())));
            }
        };
        let Ok(Value::Object(map)) = serde_json::from_str::<Value>(&text) else {
            return Self::put_aside(path, "it cannot be understood");
        };
        Self::from_map(map)
    }

    /// Moves a file that cannot be used out of the way, under a name that is free.
    fn put_aside(path: &Path, why: &str) -> (Self, Option<String>) {
        let free = (1..1000).map(|n| path.with_extension(format!("garbled-{n}.json"))).find(|p| !p.exists());
        let told = match free.map(|aside| (std::fs::rename(path, &aside), aside)) {
            Some((Ok(()), aside)) => format!("the settings were put aside as {}: {why}", aside.display()),
            _ => format!("{}: {why}, and it cannot be moved: standard settings", path.display()),
        };
        (Self::default(), Some(told))
    }

    fn from_map(mut map: Map<String, Value>) -> (Self, Option<String>) {
        let mut s = Self::default();
        let version = map.remove("version").and_then(|v| v.as_u64()).unwrap_or(1);
        let mut odd = Vec::new();
        let mut take = |key: &str, into: &mut dyn FnMut(&Value) -> bool| match map.remove(key) {
            Some(value) if !into(&value) => odd.push(key.to_string()),
            _ => {}
        };
        let flag = |to: &mut bool, v: &Value| v.as_bool().map(|b| *to = b).is_some();
        take("fullscreen", &mut |v| flag(&mut s.fullscreen, v));
        take("vsync", &mut |v| flag(&mut s.vsync, v));
        take("panel", &mut |v| flag(&mut s.panel, v));
        take("rate", &mut |v| {
            let rate = v.as_f64().map(|r| r as f32).filter(|r| (0.0..=240.0).contains(r));
            rate.map(|r| s.rate = r).is_some()
        });
        take("best", &mut |v| v.as_object().map(|b| s.best = b.clone()).is_some());
        take("keys", &mut |v| v.as_object().is_some_and(|keys| s.keys.read(keys)));
        s.other = map;
        let notice = match (version, odd.is_empty()) {
            (v, _) if v < VERSION => Some(format!("settings of version {v} were taken over")),
            (v, _) if v > VERSION => Some(format!("settings of the later version {v}: what is not known here is kept")),
            (_, false) => Some(format!("settings that make no sense were left out: {}", odd.join(", "))),
            _ => None,
        };
        (s, notice)
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// In one line.
    pub fn save(&self, path: &Path) -> Result<(), String> {
        let mut map = self.other.clone();
        map.insert("version".into(), json!(VERSION));
        map.insert("fullscreen".into(), json!(self.fullscreen));
        map.insert("vsync".into(), json!(self.vsync));
        map.insert("panel".into(), json!(self.panel));
        map.insert("rate".into(), json!(self.rate));
        map.insert("best".into(), Value::Object(self.best.clone()));
        map.insert("keys".into(), self.keys.write());
        let text = serde_json::to_string_pretty(&Value::Object(map)).map_err(|e| e.to_string())?;
        let failed = |e: std::io::Error| format!("settings are not kept: {} cannot be written ({e})", path.display());
        // A renamed file would replace one that the user has protected.
        if std::fs::metadata(path).is_ok_and(|m| m.permissions().readonly()) {
            return Err(failed(std::io::ErrorKind::PermissionDenied.into()));
        }
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        let part = path.with_extension(format!("part-{}", std::process::id()));
        std::fs::write(&part, text + "\n").and_then(|()| std::fs::rename(&part, path)).map_err(|e| {
            let _ = std::fs::remove_file(&part);
            failed(e)
        })
    }

    /// Best result of a level, from 0.
    pub fn best(&self, scene: &str, level: usize) -> Option<Best> {
        let entry = self.best.get(&format!("{scene}/{}", level + 1))?;
        let number = |key: &str| entry.get(key)?.as_u64().map(|n| n as u32);
        Some(Best { moves: number("moves")?, stars: number("stars")?.min(3) })
    }

    /// Remembers a result; returns whether anything got better.
    pub fn learn(&mut self, scene: &str, level: usize, moves: u32, stars: u32) -> bool {
        let old = self.best(scene, level);
        let moves = old.map_or(moves, |b| b.moves.min(moves));
        let stars = old.map_or(stars, |b| b.stars.max(stars));
        let better = old != Some(Best { moves, stars });
        if better {
            self.best.insert(format!("{scene}/{}", level + 1), json!({"moves": moves, "stars": stars}));
        }
        better
    }

    /// The key of a command, for people.
    pub fn key(&self, command: Command) -> &str {
        self.keys.key(command)
    }
}

/// Where the settings lie: `CATOPTRA_CONFIG`, or the system's folder for a user's configuration; `None` where there is none.
pub fn path() -> Option<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    if let Some(file) = folder("CATOPTRA_CONFIG") {
        return Some(file);
    }
    let base = if cfg!(windows) {
        folder("APPDATA")
    } else if cfg!(target_os = "macos") {
        folder("HOME").map(|h| h.join("Library/Application Support"))
    } else {
        folder("XDG_CONFIG_HOME").filter(|p| p.is_absolute()).or_else(|| folder("HOME").map(|h| h.join(".config")))
    };
    base.map(|b| b.join("catoptra").join("settings.json"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("catoptra-settings-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&dir);
        std::fs::create_dir_all(&dir).unwrap();
        dir
    }

    #[test]
    fn missing_files_are_made_and_come_back() {
        let path = folder("missing").join("deep/settings.json");
        let (mut s, notice) = Settings::load(&path);
        assert!(s == Settings::default() && notice.unwrap().contains("will be kept"));
        s.fullscreen = true;
        assert!(s.learn("rolling-box", 0, 12, 1) && s.learn("rolling-box", 0, 14, 2));
        assert!(!s.learn("rolling-box", 0, 13, 1));
        s.keys.set(Command::Undo, "F7");
        s.save(&path).unwrap();
        let (again, notice) = Settings::load(&path);
        assert_eq!((again.clone(), notice), (s, None));
        assert_eq!(again.best("rolling-box", 0), Some(Best { moves: 12, stars: 2 }));
        assert_eq!(again.keys.command("F7"), Some(Command::Undo));
    }

    #[test]
    fn garbled_files_are_put_aside_whole() {
        let dir = folder("garbled");
        let path = dir.join("settings.json");
        for (n, bytes) in [b"{\"keys\": ".as_slice(), b"[1]", b"\xff\xfe\0", b""].into_iter().enumerate() {
            std::fs::write(&path, bytes).unwrap();
            let (s, notice) = Settings::load(&path);
            assert!(s == Settings::default() && notice.unwrap().contains("put aside"));
            let aside = dir.join(format!("settings.garbled-{}.json", n + 1));
            assert_eq!(std::fs::read(aside).unwrap(), bytes);
            s.save(&path).unwrap();
        }
    }

    #[test]
    fn older_and_later_files_are_taken_over_and_nothing_is_lost() {
        let path = folder("older").join("settings.json");
        std::fs::write(&path, r#"{"fullscreen": true, "colour": "teal"}"#).unwrap();
        let (s, notice) = Settings::load(&path);
        assert!(s.fullscreen && notice.unwrap().contains("version 1"));
        s.save(&path).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().contains("teal"));
        std::fs::write(&path, r#"{"version": 9, "vsync": false, "hdr": {"nits": 400}}"#).unwrap();
        let (s, notice) = Settings::load(&path);
        assert!(!s.vsync && notice.unwrap().contains("version 9"));
        s.save(&path).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().contains("400"));
        // Entries of the wrong kind are named, the others hold.
        std::fs::write(&path, r#"{"version": 2, "vsync": 3, "rate": -1, "panel": true}"#).unwrap();
        let (s, notice) = Settings::load(&path);
        assert!(s.vsync && s.panel && notice.unwrap().ends_with("vsync, rate"));
    }

    #[test]
    fn read_only_files_stay_as_they_are() {
        let path = folder("read-only").join("settings.json");
        let text = r#"{"version": 2, "panel": true}"#;
        std::fs::write(&path, text).unwrap();
        let mut rights = std::fs::metadata(&path).unwrap().permissions();
        rights.set_readonly(true);
        std::fs::set_permissions(&path, rights).unwrap();
        let (s, _) = Settings::load(&path);
        assert!(s.panel && s.save(&path).unwrap_err().contains("cannot be written"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        // Nor can a folder be written where a file is.
        assert!(s.save(&path.join("settings.json")).is_err());
    }
}
