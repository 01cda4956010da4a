//! `--trace FILE`: the renderer's spans as a chrome trace, for chrome://tracing, Perfetto or speedscope.
//!
//! One line of time a thread; a span begins ("B") and ends ("E") in microseconds since the recording began. The stages of
//! the GPU lane have two lines more, one a side.

use super::failure::Failure;
use catoptra_render_hybrid::{StageInterval, image_io};
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
    start: Instant,
    events: Arc<Mutex<Events>>,
}

#[derive(Default)]
struct Events {
    list: Vec<Entry>,
    /// Names of spans by number − 1.
    names: Vec<(usize, &'static str)>,
    threads: Vec<std::thread::ThreadId>,
    stages: Vec<StageInterval>,
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
    let start = Instant::now();
    let recorder = Recorder { start, events: events.clone() };
    tracing::subscriber::set_global_default(recorder)
        .map_err(|_| Failure::other("something records this process's spans already; --trace cannot"))?;
    Ok(Some(Recording { file: file.to_path_buf(), start, events }))
}

/// Adds the stages of a frame.
pub fn add(recording: Option<&Recording>, stages: &[StageInterval]) {
    if let Some(recording) = recording {
        recording.events.lock().unwrap_or_else(PoisonError::into_inner).stages.extend_from_slice(stages);
    }
}

/// A stage that began and ended ("X"), on the line of its side.
fn stage(start: Instant, stage: &StageInterval) -> Value {
    let since = |at: Instant| at.saturating_duration_since(start).as_secs_f64() * 1e6;
    json!({
        "name": stage.name,
        "ph": "X",
        "ts": since(stage.begin),
        "dur": since(stage.end) - since(stage.begin),
        "pid": 2,
        "tid": u32::from(stage.on_gpu),
    })
}

/// Names of the lines of both sides.
fn side_names() -> [Value; 3] {
    let name = |what: &str, tid: u32, name: &str| json!({ "name": what, "ph": "M", "pid": 2, "tid": tid, "args": { "name": name } });
    [name("process_name", 0, "GPU lane"), name("thread_name", 0, "CPU"), name("thread_name", 1, "GPU")]
}

/// Writes the file of a recording.
///
/// # Errors
/// The file system's reason.
pub fn finish(recording: Option<Recording>) -> Result<(), Failure> {
    let Some(Recording { file, start, events }) = recording else { return Ok(()) };
    let events = events.lock().unwrap_or_else(PoisonError::into_inner);
    let mut list: Vec<Value> = events
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
    if !events.stages.is_empty() {
        list.extend(side_names());
        list.extend(events.stages.iter().map(|s| stage(start, s)));
    }
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
