//! `--trace FILE`: the renderer's spans as a chrome trace, for chrome://tracing, Perfetto or speedscope.
//!
//! One line of time a thread; a span begins ("B") and ends ("E") in microseconds since the recording began.

use super::failure::Failure;
use catoptra_render_hybrid::image_io;
use serde_json::{Value, json};
use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::Instant,
};
use tracing::{Event, Metadata, Subscriber, span};

/// A recording that goes on until it is written.
pub struct Recording {
    file: PathBuf,
    events: Arc<Mutex<Events>>,
}

#[derive(Default)]
struct Events {
    list: Vec<Entry>,
    /// Names of spans by number − 1.
    names: Vec<(usize, &'static str)>,
    threads: Vec<std::thread::ThreadId>,
}

struct Entry {
    span: u64,
    thread: usize,
    begins: bool,
    microseconds: f64,
}

struct Recorder {
    start: Instant,
    events: Arc<Mutex<Events>>,
}

/// Starts to record, where a file is asked for.
///
/// # Errors
/// Where something else listens to the process's spans already.
pub fn start(file: Option<&Path>) -> Result<Option<Recording>, Failure> {
    let Some(file) = file else { return Ok(None) };
    let events = Arc::new(Mutex::new(Events::default()));
    let recorder = Recorder { start: Instant::now(), events: events.clone() };
    tracing::subscriber::set_global_default(recorder)
        .map_err(|_| Failure::other("something records this process's spans already; --trace cannot"))?;
    Ok(Some(Recording { file: file.to_path_buf(), events }))
}

/// Writes the file of a recording.
///
/// # Errors
/// The file system's reason.
pub fn finish(recording: Option<Recording>) -> Result<(), Failure> {
    let Some(Recording { file, events }) = recording else { return Ok(()) };
    let events = events.lock().unwrap_or_else(PoisonError::into_inner);
    let list: Vec<Value> = events
        .list
        .iter()
        .map(|e| {
            json!({
                "name": events.names[e.span as usize - 1].1,
                "ph": if e.begins { "B" } else { "E" },
                "ts": e.microseconds,
                "pid": 1,
                "tid": e.thread,
            })
        })
        .collect();
    let text = format!("{}\n", json!({ "traceEvents": list, "displayTimeUnit": "ms" }));
    Ok(image_io::write_atomically(&file, text.as_bytes())?)
}

impl Recorder {
    fn put(&self, id: &span::Id, begins: bool) {
        let microseconds = self.start.elapsed().as_secs_f64() * 1e6;
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let own = std::thread::current().id();
        let thread = events.threads.iter().position(|t| *t == own).unwrap_or_else(|| {
            events.threads.push(own);
            events.threads.len() - 1
        });
        events.list.push(Entry { span: id.into_u64(), thread, begins, microseconds });
    }
}

impl Subscriber for Recorder {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.is_span() && metadata.target().starts_with("catoptra")
    }
    /// Spans of one place in the code share a number: only their name is told.
    fn new_span(&self, attributes: &span::Attributes<'_>) -> span::Id {
        let place = std::ptr::from_ref(attributes.metadata()) as usize;
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let number = events.names.iter().position(|n| n.0 == place).unwrap_or_else(|| {
            events.names.push((place, attributes.metadata().name()));
            events.names.len() - 1
        });
        span::Id::from_u64(number as u64 + 1)
    }
    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}
    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}
    fn event(&self, _: &Event<'_>) {}
    fn enter(&self, id: &span::Id) {
        self.put(id, true);
    }
    fn exit(&self, id: &span::Id) {
        self.put(id, false);
    }
}
