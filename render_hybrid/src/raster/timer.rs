//! When each stage ran on the GPU: by timestamps where the adapter has them inside command encoders, else by waiting.

use std::time::{Duration, Instant};

use super::{device::Gpu, readback::Mailbox};
use crate::{error::RenderError, output::StageInterval};

const MAX_STAGES: u32 = 32;
const TICK_BYTES: u64 = 8;

struct Timestamps {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    mailbox: Mailbox,
}

/// A stage of a frame; with its interval where it was waited for.
#[derive(Clone, Copy)]
struct Timed {
    name: &'static str,
    interval: Option<(Instant, Instant)>,
}

/// Times the stages of a frame, where asked to. Of two frames on their way each has its own slot.
pub(crate) struct StageTimer {
    pub enabled: bool,
    timestamps: Option<[Timestamps; 2]>,
    /// A moment by both clocks.
    clock: Option<(Instant, u64)>,
    current: usize,
    stages: [Vec<Timed>; 2],
}

impl StageTimer {
    pub fn new(gpu: &Gpu) -> Self {
        let wanted = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
        let slot = |_| Timestamps {
            set: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timer.queries"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_STAGES,
            }),
            resolved: gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timer.resolved"),
                size: u64::from(2 * MAX_STAGES) * TICK_BYTES,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            }),
            mailbox: Mailbox::new(gpu, "timer.staging"),
        };
        let timestamps = gpu.device.features().contains(wanted).then(|| [0, 1].map(slot));
        Self { enabled: false, timestamps, clock: None, current: 0, stages: Default::default() }
    }

    /// A frame begins.
    /// * `beside`: while the one before is still on its way
    pub fn begin_frame(&mut self, gpu: &Gpu, beside: bool) -> Result<(), RenderError> {
        if self.enabled && self.clock.is_none() {
            self.set_clock(gpu)?;
        }
        if beside {
            self.current ^= 1;
        }
        self.stages[self.current].clear();
        Ok(())
    }

    /// The slot of the frame that was begun last.
    pub fn slot(&self) -> usize {
        self.current
    }

    /// Reads both clocks at once, as nearly as some tries can: half the time that the best one took is the error.
    fn set_clock(&mut self, gpu: &Gpu) -> Result<(), RenderError> {
        let Some([t, _]) = &mut self.timestamps else { return Ok(()) };
        let mut best: Option<(Duration, Instant, u64)> = None;
        for _ in 0..8 {
            let mut encoder = gpu.encoder("timer.clock");
            encoder.write_timestamp(&t.set, 0);
            encoder.resolve_query_set(&t.set, 0..1, &t.resolved, 0);
            t.mailbox.open(gpu, TICK_BYTES);
            t.mailbox.buffer(&mut encoder, &t.resolved, 0, TICK_BYTES);
            let commands = encoder.finish();
            let before = Instant::now();
            t.mailbox.sent(&gpu.queue.submit([commands]));
            gpu.wait()?;
            let took = before.elapsed();
            let ticks: Vec<u64> = t.mailbox.read(gpu, bytemuck::pod_collect_to_vec)?;
            if best.is_none_or(|(least, ..)| took < least) {
                best = Some((took, before + took / 2, ticks[0]));
            }
        }
        self.clock = best.map(|(_, at, ticks)| (at, ticks));
        Ok(())
    }

    /// Records a stage.
    pub fn stage<T>(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        name: &'static str,
        record: impl FnOnce(&mut wgpu::CommandEncoder) -> T,
    ) -> Result<T, RenderError> {
        let stages = &mut self.stages[self.current];
        let first = 2 * stages.len() as u32;
        if !self.enabled || first >= 2 * MAX_STAGES {
            return Ok(record(encoder));
        }
        if let Some(slots) = &self.timestamps {
            let set = &slots[self.current].set;
            encoder.write_timestamp(set, first);
            let out = record(encoder);
            encoder.write_timestamp(set, first + 1);
            stages.push(Timed { name, interval: None });
            return Ok(out);
        }
        let done = |encoder: &mut wgpu::CommandEncoder| {
            let full = std::mem::replace(encoder, gpu.encoder("frame"));
            gpu.queue.submit([full.finish()]);
            gpu.wait()
        };
        done(encoder)?;
        let begin = Instant::now();
        let out = record(encoder);
        done(encoder)?;
        stages.push(Timed { name, interval: Some((begin, Instant::now())) });
        Ok(out)
    }

    /// Records that the times of a slot's stages come back with this encoder's submission, [`Self::sent`] then.
    pub fn resolve(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, slot: usize) {
        let count = 2 * self.stages[slot].len() as u32;
        if let (Some(slots), true) = (&mut self.timestamps, count > 0) {
            let Timestamps { set, resolved, mailbox } = &mut slots[slot];
            let bytes = u64::from(count) * TICK_BYTES;
            encoder.resolve_query_set(set, 0..count, resolved, 0);
            mailbox.open(gpu, bytes);
            mailbox.buffer(encoder, resolved, 0, bytes);
        }
    }

    pub fn sent(&mut self, slot: usize, submission: &wgpu::SubmissionIndex) {
        if let (Some(slots), false) = (&mut self.timestamps, self.stages[slot].is_empty()) {
            slots[slot].mailbox.sent(submission);
        }
    }

    /// Intervals of a slot's stages in the order of their recording, after [`Self::resolve`]. Waits for that submission.
    pub fn take(&mut self, gpu: &Gpu, slot: usize, out: &mut Vec<StageInterval>) -> Result<(), RenderError> {
        let stages = std::mem::take(&mut self.stages[slot]);
        let mut ticks = Vec::new();
        if let (Some(slots), false) = (&mut self.timestamps, stages.is_empty()) {
            ticks = slots[slot].mailbox.read(gpu, bytemuck::pod_collect_to_vec::<u8, u64>)?;
        }
        let period = f64::from(gpu.queue.get_timestamp_period()) * 1e-9;
        // Without a common clock lengths are still right.
        let (at, base) = self.clock.unwrap_or((Instant::now(), ticks.first().copied().unwrap_or(0)));
        let instant = |tick: u64| {
            let off = Duration::from_secs_f64(tick.abs_diff(base) as f64 * period);
            if tick >= base { at + off } else { at.checked_sub(off).unwrap_or(at) }
        };
        for (i, stage) in stages.iter().enumerate() {
            let (begin, end) = match (stage.interval, ticks.get(2 * i..2 * i + 2)) {
                (Some(waited), _) => waited,
                (None, Some(pair)) => (instant(pair[0]), instant(pair[1].max(pair[0]))),
                (None, None) => continue,
            };
            out.push(StageInterval { on_gpu: true, name: stage.name, begin, end });
        }
        Ok(())
    }
}
