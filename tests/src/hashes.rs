//! Exact hashes of linear pictures, one `NAME HASH` a line, sorted by name.

use std::{collections::BTreeMap, path::PathBuf, sync::Mutex};

/// Why a hash failed.
#[derive(Debug, PartialEq, Eq)]
pub enum HashError {
    /// The file has no such name. It is never made up: run with `CATOPTRA_UPDATE_GOLDENS=1`.
    Missing(String),
    /// The hash is another one.
    Differs {
        /// Name of the picture.
        name: String,
        /// Hash of the picture under test.
        actual: u64,
        /// Hash in the file.
        expected: u64,
    },
    /// The file cannot be read, written or understood.
    File(String),
}

impl std::fmt::Display for HashError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Missing(name) => write!(f, "there is no golden hash of {name}"),
            Self::Differs { name, actual, expected } => write!(f, "{name}: hash {actual:016x}, not {expected:016x}"),
            Self::File(why) => f.write_str(why),
        }
    }
}

impl std::error::Error for HashError {}

/// A file of hashes. Tests of one process may share it.
#[derive(Debug)]
pub struct HashLedger {
    path: PathBuf,
    update: bool,
}

/// Guards reading and rewriting within this process.
static FILE: Mutex<()> = Mutex::new(());

impl HashLedger {
    /// The ledger at `path`, which need not exist yet.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), update: crate::updating_goldens() }
    }
    /// Rewrites hashes or not, whatever the environment says.
    pub fn updating(mut self, update: bool) -> Self {
        self.update = update;
        self
    }

    /// The hash under `name` is `actual`.
    ///
    /// # Errors
    /// [`HashError`]; a name that is not there is an error too.
    pub fn check(&self, name: &str, actual: u64) -> Result<(), HashError> {
        let _guard = FILE.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut lines = self.read()?;
        if self.update {
            if lines.insert(name.to_string(), actual) != Some(actual) {
                let text: String = lines.iter().map(|(n, h)| format!("{n} {h:016x}\n")).collect();
                std::fs::write(&self.path, text)
                    .map_err(|e| HashError::File(format!("cannot write {}: {e}", self.path.display())))?;
            }
            return Ok(());
        }
        match lines.get(name) {
            None => Err(HashError::Missing(name.to_string())),
            Some(&expected) if expected != actual => {
                Err(HashError::Differs { name: name.to_string(), actual, expected })
            }
            Some(_) => Ok(()),
        }
    }

    /// All names in the file.
    ///
    /// # Errors
    /// [`HashError::File`].
    pub fn names(&self) -> Result<Vec<String>, HashError> {
        Ok(self.read()?.into_keys().collect())
    }

    fn read(&self) -> Result<BTreeMap<String, u64>, HashError> {
        let text = match std::fs::read_to_string(&self.path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(BTreeMap::new()),
            Err(e) => return Err(HashError::File(format!("cannot read {}: {e}", self.path.display()))),
        };
        text.lines()
            .map(|line| {
                let entry = line.split_once(' ').and_then(|(n, h)| Some((n, u64::from_str_radix(h, 16).ok()?)));
                let (name, hash) = entry
                    .ok_or_else(|| HashError::File(format!("{}: not \"NAME HASH\": {line}", self.path.display())))?;
                Ok((name.to_string(), hash))
            })
            .collect()
    }
}
