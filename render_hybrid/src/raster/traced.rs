//! The lane's tracer: mirrors and glass of a frame without a read-back.

use super::{
    GpuRaster, RasterInputs, TraceInputs,
    tracer::{GpuTracer, TracedCounts},
};
use crate::{error::RenderError, settings::Tracer};

impl GpuRaster {
    /// Makes the tracer, or drops it (`Cpu`): its kernels are compiled here, not in a frame.
    /// * `kd`: meshes will have kd-trees
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] with what the adapter lacks; [`RenderError::Gpu`].
    pub fn set_tracer(&mut self, kind: Tracer, kd: bool) -> Result<(), RenderError> {
        self.tracer = None;
        if !matches!(kind, Tracer::Cpu | Tracer::Auto) {
            let gpu = &self.gpu;
            self.tracer = Some(gpu.scoped(|| GpuTracer::new(gpu, kind, kd))?);
        }
        Ok(())
    }

    /// The tracer that runs here; [`Tracer::Cpu`]: none.
    pub fn tracer(&self) -> Tracer {
        self.tracer.as_ref().map_or(Tracer::Cpu, |t| t.kind)
    }

    /// True where the tracer makes VPLs, too.
    pub(crate) fn has_photons(&self) -> bool {
        self.tracer.as_ref().is_some_and(GpuTracer::has_photons)
    }

    /// The VPLs of the frame are those that the GPU had made before.
    pub(crate) fn kept_photons(&self) -> bool {
        self.tracer.as_ref().is_some_and(GpuTracer::kept_photons)
    }

    /// What keeps this device from running a tracer, in words; `None`: nothing.
    pub fn tracer_missing(&self, kind: Tracer) -> Option<String> {
        super::tracer::missing(kind, &self.gpu.device)
    }

    /// Sends what the tracer needs of the frame that was begun.
    ///
    /// # Errors
    /// [`RenderError::Unavailable`] where the scene is beyond what the adapter binds, with figures; [`RenderError::Gpu`].
    pub(crate) fn prepare_trace(&mut self, inputs: &RasterInputs) -> Result<(), RenderError> {
        let moments = self.begun()?.moments;
        self.step(|s| {
            let Some(tracer) = &mut s.tracer else { return Err(RenderError::Gpu("no tracer was made".into())) };
            let RasterInputs { scene, accel, settings, vpls, geometry_term_max, photons } = *inputs;
            // A set of VPLs of its own has no maps.
            let few = settings.vpl.is_some_and(|v| v.mirrored > 0);
            let map_size = if few { 0 } else { s.indirect.maps().1 };
            let plan = &s.plan;
            let chunk_stride = s.indirect.chunks().1;
            let inputs = TraceInputs {
                scene,
                accel,
                settings,
                plan,
                moments,
                vpls,
                geometry_term_max,
                map_size,
                photons,
                chunk_stride,
            };
            tracer.prepare(&s.gpu, &inputs, s.scene.uniforms())
        })
    }

    /// Records the traced layer; after [`Self::prepare_trace`].
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub(crate) fn trace(&mut self) -> Result<(), RenderError> {
        self.begun()?;
        self.step(|s| {
            let Self { tracer: Some(tracer), gpu, open, timer, picture, shadows, indirect, .. } = s else {
                return Err(RenderError::Gpu("no tracer was made".into()));
            };
            let encoder = open.get_or_insert_with(|| gpu.encoder("frame"));
            timer.stage(gpu, encoder, "traced", |encoder| {
                tracer.record(gpu, encoder, picture, shadows, indirect.maps().0);
            })
        })
    }

    /// Records final = direct + indirect + traced with the layer of [`Self::trace`].
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub(crate) fn compose_traced(&mut self) -> Result<(), RenderError> {
        self.begun()?;
        self.step(|s| {
            let Self { gpu, open, compose, bindings, picture, timer, .. } = s;
            let Some(bindings) = bindings else { unreachable!("a frame was begun") };
            let encoder = open.get_or_insert_with(|| gpu.encoder("frame"));
            timer.stage(gpu, encoder, "compose", |encoder| compose.record_sum(encoder, &bindings.compose, picture))
        })
    }

    /// Number of masked pixels and the tracer's counters, which came with the picture of [`Self::finish`].
    ///
    /// # Errors
    /// [`RenderError::Gpu`]
    pub(crate) fn read_trace_counts(&mut self) -> Result<TracedCounts, RenderError> {
        self.step(|s| {
            let words: Vec<u32> = s.mail.counts.read(&s.gpu, bytemuck::pod_collect_to_vec)?;
            Ok(TracedCounts::of(&words))
        })
    }
}
