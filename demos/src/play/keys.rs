//! What keys mean. A key has the name that winit gives it (`ArrowUp`, `Escape`), `Space`, or the character it types.

use serde_json::{Map, Value};
use winit::keyboard::{Key, NamedKey};

/// What a key can be set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Command {
    North,
    South,
    West,
    East,
    Strike,
    Undo,
    Restart,
    Hint,
    Pause,
    Panel,
    Photo,
    Screenshot,
    Layer,
    Fullscreen,
    Games,
}

impl Command {
    /// All commands with their names in the file, what they do, and their keys at first.
    pub const ALL: [(Self, &'static str, &'static str, &'static str); 15] = [
        (Self::North, "north", "tip away / harder", "ArrowUp"),
        (Self::South, "south", "tip towards you / softer", "ArrowDown"),
        (Self::West, "west", "tip left / turn left", "ArrowLeft"),
        (Self::East, "east", "tip right / turn right", "ArrowRight"),
        (Self::Strike, "strike", "putt / next level", "Space"),
        (Self::Undo, "undo", "undo", "u"),
        (Self::Restart, "restart", "restart", "r"),
        (Self::Hint, "hint", "hint", "h"),
        (Self::Pause, "pause", "pause and settings", "Escape"),
        (Self::Panel, "panel", "panel", "F1"),
        (Self::Photo, "photo", "photo mode", "F2"),
        (Self::Screenshot, "screenshot", "screenshot", "p"),
        (Self::Layer, "layer", "next layer", "l"),
        (Self::Fullscreen, "fullscreen", "full screen", "F11"),
        (Self::Games, "games", "all games", "g"),
    ];
}

/// A key for each command; no key has two.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyMap(Vec<(Command, String)>);

impl Default for KeyMap {
    fn default() -> Self {
        Self(Command::ALL.iter().map(|c| (c.0, c.3.to_string())).collect())
    }
}

impl KeyMap {
    /// The key of a command.
    pub fn key(&self, command: Command) -> &str {
        self.0.iter().find(|k| k.0 == command).map_or("", |k| k.1.as_str())
    }

    /// The command of a key.
    pub fn command(&self, key: &str) -> Option<Command> {
        self.0.iter().find(|k| k.1 == key).map(|k| k.0)
    }

    /// Gives a command another key. A command that had this key gets the other one's, so that none is left without.
    pub fn set(&mut self, command: Command, key: &str) {
        let old = self.key(command).to_string();
        for (c, k) in &mut self.0 {
            if *c == command {
                *k = key.to_string();
            } else if k == key {
                k.clone_from(&old);
            }
        }
    }

    /// Takes over the keys of a file; false where one of them makes no sense. Names of other versions are passed over.
    pub fn read(&mut self, keys: &Map<String, Value>) -> bool {
        let mut sound = true;
        for (name, value) in keys {
            let command = Command::ALL.iter().find(|c| c.1 == name);
            match (command, value.as_str().filter(|k| !k.is_empty() && k.len() < 32)) {
                (Some(c), Some(key)) => self.set(c.0, key),
                (Some(_), None) => sound = false,
                (None, _) => {}
            }
        }
        sound
    }

    /// As in a file.
    pub fn write(&self) -> Value {
        let name = |c: Command| Command::ALL.iter().find(|k| k.0 == c).map_or("", |k| k.1);
        Value::Object(self.0.iter().map(|(c, k)| (name(*c).to_string(), Value::from(k.as_str()))).collect())
    }
}

/// The name of a key; `None` for what has none.
pub fn name(key: &Key) -> Option<String> {
    match key {
        Key::Named(NamedKey::Space) => Some("Space".into()),
        Key::Named(named) => Some(format!("{named:?}")),
        Key::Character(text) if text.trim().is_empty() => Some("Space".into()),
        Key::Character(text) => Some(text.to_lowercase()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_unique_and_change_places() {
        let mut keys = KeyMap::default();
        for (command, _, _, key) in Command::ALL {
            assert_eq!((keys.key(command), keys.command(key)), (key, Some(command)));
        }
        keys.set(Command::Undo, "r");
        assert_eq!((keys.key(Command::Undo), keys.key(Command::Restart)), ("r", "u"));
        keys.set(Command::Undo, "ArrowUp");
        assert_eq!((keys.key(Command::North), keys.command("r")), ("r", Some(Command::North)));
        let mut again = KeyMap::default();
        assert!(again.read(keys.write().as_object().unwrap()));
        assert_eq!(again, keys);
    }
}
