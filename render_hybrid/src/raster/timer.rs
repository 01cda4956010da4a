//! Milliseconds per stage: by timestamps where the adapter has them inside command encoders, else by waiting.

use std::time::Instant;

use super::{device::Gpu, readback::Readback};
use crate::error::RenderError;

const MAX_STAGES: u32 = 32;

struct Timestamps {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
}

/// A stage being recorded.
pub(crate) struct Stage {
    pub encoder: wgpu::CommandEncoder,
    begun: Option<Instant>,
}

/// Times the stages of a frame, where asked to.
pub(crate) struct StageTimer {
    pub enabled: bool,
    timestamps: Option<Timestamps>,
    /// Stages since the last take, with their milliseconds where they were waited for.
    stages: Vec<(&'static str, f64)>,
}

impl StageTimer {
    pub fn new(gpu: &Gpu) -> Self {
        let wanted = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
        let timestamps = gpu.device.features().contains(wanted).then(|| Timestamps {
            set: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timer.queries"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_STAGES,
            }),
            resolved: gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timer.resolved"),
                size: u64::from(MAX_STAGES) * 16,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            }),
        });
        Self { enabled: false, timestamps, stages: Vec::new() }
    }

    fn slot(&self) -> Option<u32> {
        (self.enabled && (self.stages.len() as u32) < MAX_STAGES).then_some(self.stages.len() as u32)
    }

    /// Starts recording a stage.
    pub fn begin(&self, gpu: &Gpu, name: &'static str) -> Stage {
        let mut encoder = gpu.encoder(name);
        let mut begun = None;
        if let Some(slot) = self.slot() {
            match &self.timestamps {
                Some(t) => encoder.write_timestamp(&t.set, 2 * slot),
                None => begun = Some(Instant::now()),
            }
        }
        Stage { encoder, begun }
    }

    /// Submits the stage.
    pub fn end(&mut self, gpu: &Gpu, name: &'static str, mut stage: Stage) -> Result<(), RenderError> {
        let slot = self.slot();
        if let (Some(slot), Some(t)) = (slot, &self.timestamps) {
            stage.encoder.write_timestamp(&t.set, 2 * slot + 1);
        }
        gpu.queue.submit([stage.encoder.finish()]);
        let mut ms = 0.0;
        if let Some(begun) = stage.begun {
            gpu.wait()?;
            ms = begun.elapsed().as_secs_f64() * 1e3;
        }
        if slot.is_some() {
            self.stages.push((name, ms));
        }
        Ok(())
    }

    /// Milliseconds of the stages since the last call, in the order of submission; stages of one name are summed.
    pub fn take(&mut self, gpu: &Gpu, readback: &mut Readback) -> Result<Vec<(&'static str, f64)>, RenderError> {
        let mut stages = std::mem::take(&mut self.stages);
        if let (Some(t), false) = (&self.timestamps, stages.is_empty()) {
            let count = 2 * stages.len() as u32;
            let mut encoder = gpu.encoder("timer.resolve");
            encoder.resolve_query_set(&t.set, 0..count, &t.resolved, 0);
            gpu.queue.submit([encoder.finish()]);
            let ticks: Vec<u64> = readback.buffer(gpu, &t.resolved, 0, u64::from(count) * 8)?;
            let to_ms = f64::from(gpu.queue.get_timestamp_period()) * 1e-6;
            for (stage, pair) in stages.iter_mut().zip(ticks.chunks_exact(2)) {
                stage.1 = pair[1].saturating_sub(pair[0]) as f64 * to_ms;
            }
        }
        let mut out: Vec<(&'static str, f64)> = Vec::new();
        for (name, ms) in stages {
            match out.iter_mut().find(|(n, _)| *n == name) {
                Some(entry) => entry.1 += ms,
                None => out.push((name, ms)),
            }
        }
        Ok(out)
    }
}
