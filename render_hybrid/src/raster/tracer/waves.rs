//! The compute tracer wave by wave over queues, for measurements against the one kernel: `shaders/tracer/waves.wgsl`.
//!
//! A wave is every ray that is as many interfaces from the camera as the others. How many there are is known on the GPU alone, so
//! as many waves are recorded as the settings allow; an empty one is a dispatch of no workgroup.

use std::collections::HashMap;

use super::{
    GpuTracer, compute_pass, module,
    shaders::{HeapKind, Variant},
};
use crate::raster::{
    device::Gpu,
    pipeline::{Slot, compute_pipeline, group, group_layout, pipeline_layout, uniform},
    targets::{PictureTargets, RADIANCE_FORMAT, ShadowTargets},
    testing::Waves,
};

/// 16-byte words of a ray, of its hit; 4-byte words of a pixel's sum.
const RAY_BYTES: u64 = 5 * 16;
const HIT_BYTES: u64 = 2 * 16;
const SUM_BYTES: u64 = 6 * 4;

struct Pipelines {
    begin: wgpu::ComputePipeline,
    /// One kernel a wave, or finding and shading.
    wave: Vec<wgpu::ComputePipeline>,
    finish: Option<wgpu::ComputePipeline>,
    resolve: wgpu::ComputePipeline,
}

/// What [`GpuTracer`] keeps for it.
pub(crate) struct WaveTracer {
    pub how: Waves,
    layout: wgpu::BindGroupLayout,
    args_layout: wgpu::BindGroupLayout,
    next_wave: wgpu::ComputePipeline,
    pipelines: HashMap<(Variant, [bool; 2]), Pipelines>,
    uniform: wgpu::Buffer,
    state: wgpu::Buffer,
    dispatch: wgpu::Buffer,
    /// Rays that half of the queue holds, and the groups of a picture's size.
    bound: Option<(u32, [wgpu::BindGroup; 2])>,
}

impl WaveTracer {
    pub fn new(gpu: &Gpu, how: Waves) -> Self {
        let (read, write) = (Slot::Storage(true), Slot::Storage(false));
        let mut slots = vec![Slot::Uniform, Slot::TextureUint, Slot::TextureArray, Slot::TextureArray, Slot::Texture];
        slots.extend([read, write, Slot::Write(RADIANCE_FORMAT), Slot::Uniform, write, write, write, write]);
        let stage = wgpu::ShaderStages::COMPUTE;
        let layout = group_layout(gpu, "waves.group", stage, &slots);
        let args_layout = group_layout(gpu, "waves.args", stage, &[Slot::Uniform, write, write]);
        let args_pipeline_layout = pipeline_layout(gpu, "waves.args", None, Some(&args_layout));
        let args = module(gpu, "wave_args", &Variant::new(HeapKind::Storage));
        use wgpu::BufferUsages as U;
        Self {
            how,
            layout,
            args_layout,
            next_wave: compute_pipeline(gpu, &args, &args_pipeline_layout, "next_wave"),
            pipelines: HashMap::new(),
            uniform: uniform(gpu, "waves.uniform", 16),
            state: buffer(gpu, "waves.state", 16, U::STORAGE | U::COPY_DST),
            dispatch: buffer(gpu, "waves.dispatch", 16, U::STORAGE | U::INDIRECT),
            bound: None,
        }
    }

    pub fn unbind(&mut self) {
        self.bound = None;
    }

    pub fn compile(&mut self, gpu: &Gpu, scene: &wgpu::BindGroupLayout, variant: Variant) {
        let Waves { two_kernels, finish, .. } = self.how;
        self.pipelines.entry((variant, [two_kernels, finish])).or_insert_with(|| {
            let layout = pipeline_layout(gpu, "waves", Some(scene), Some(&self.layout));
            let module = module(gpu, "waves", &variant);
            let wave: &[&str] = if two_kernels { &["find", "shade_found"] } else { &["follow"] };
            Pipelines {
                begin: compute_pipeline(gpu, &module, &layout, "begin"),
                wave: wave.iter().map(|entry| compute_pipeline(gpu, &module, &layout, entry)).collect(),
                finish: finish.then(|| compute_pipeline(gpu, &module, &layout, "finish")),
                resolve: compute_pipeline(gpu, &module, &layout, "resolve"),
            }
        });
    }

    /// * `capacity`: rays that half of the queue holds
    fn bind(
        &self,
        gpu: &Gpu,
        (uniform, counters): (&wgpu::Buffer, &wgpu::Buffer),
        (t, shadows): (&PictureTargets, &ShadowTargets),
        vpl_maps: &wgpu::TextureView,
        capacity: u32,
    ) -> [wgpu::BindGroup; 2] {
        let pixels = u64::from(t.width) * u64::from(t.height);
        gpu.upload(&self.uniform, 0, bytemuck::cast_slice(&[0, capacity, 0, 0]));
        let storage = |label, bytes: u64| buffer(gpu, label, bytes.max(16), wgpu::BufferUsages::STORAGE);
        let queue = storage("waves.queue", 2 * u64::from(capacity) * RAY_BYTES);
        let met = storage("waves.met", u64::from(capacity) * HIT_BYTES);
        let sums = storage("waves.sums", pixels * SUM_BYTES);
        let view = |v| wgpu::BindingResource::TextureView(v);
        let resources = [
            uniform.as_entire_binding(),
            view(&t.visibility.view),
            view(&shadows.maps.moments.view),
            view(&shadows.faces.moments.view),
            view(vpl_maps),
            t.pixels.as_entire_binding(),
            counters.as_entire_binding(),
            view(&t.traced.view),
            self.uniform.as_entire_binding(),
            self.state.as_entire_binding(),
            queue.as_entire_binding(),
            met.as_entire_binding(),
            sums.as_entire_binding(),
        ];
        let args =
            [self.uniform.as_entire_binding(), self.state.as_entire_binding(), self.dispatch.as_entire_binding()];
        [group(gpu, "waves.group", &self.layout, &resources), group(gpu, "waves.args", &self.args_layout, &args)]
    }
}

fn buffer(gpu: &Gpu, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
}

impl GpuTracer {
    /// For measurements: from the next frame on the layer is traced by waves, or by the one kernel (`None`).
    pub fn trace_by_waves(&mut self, gpu: &Gpu, how: Option<Waves>) {
        let applies = self.variant.heaps == HeapKind::Storage;
        self.waves = how.filter(|_| applies).map(|how| match self.waves.take() {
            Some(waves) => WaveTracer { how, ..waves },
            None => WaveTracer::new(gpu, how),
        });
    }

    /// The layer by waves; the dispatch of the one kernel was prepared.
    pub(super) fn record_waves(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (targets, shadows): (&PictureTargets, &ShadowTargets),
        vpl_maps: &wgpu::TextureView,
    ) {
        let (Some(waves), Some(scene)) = (&mut self.waves, &self.scene.group) else { return };
        let bytes = gpu.device.limits().max_storage_buffer_binding_size;
        let most = 2 * u64::from(targets.width) * u64::from(targets.height);
        let capacity = most.min(bytes / (2 * RAY_BYTES)) as u32;
        if waves.bound.as_ref().is_none_or(|b| b.0 != capacity) {
            let own = (&self.uniform, &self.counters);
            let groups = waves.bind(gpu, own, (targets, shadows), vpl_maps, capacity);
            waves.bound = Some((capacity, groups));
        }
        let Some((_, [own, args])) = &waves.bound else { unreachable!("it was bound") };
        let pipelines = &waves.pipelines[&(self.variant, [waves.how.two_kernels, waves.how.finish])];
        encoder.copy_buffer_to_buffer(&self.args, 12, &waves.uniform, 0, 4);
        encoder.clear_buffer(&waves.state, 0, None);
        let mut pass = compute_pass(encoder, "tracer.waves");
        pass.set_bind_group(0, scene, &[]);
        pass.set_bind_group(1, own, &[]);
        pass.set_pipeline(&pipelines.begin);
        pass.dispatch_workgroups_indirect(&self.args, 0);
        let mut wave = |kernels: &[wgpu::ComputePipeline]| {
            pass.set_pipeline(&waves.next_wave);
            pass.set_bind_group(0, None, &[]);
            pass.set_bind_group(1, args, &[]);
            pass.dispatch_workgroups(1, 1, 1);
            pass.set_bind_group(0, scene, &[]);
            pass.set_bind_group(1, own, &[]);
            for kernel in kernels {
                pass.set_pipeline(kernel);
                pass.dispatch_workgroups_indirect(&waves.dispatch, 0);
            }
        };
        for _ in 0..waves.how.most {
            wave(&pipelines.wave);
        }
        if let Some(finish) = &pipelines.finish {
            wave(std::slice::from_ref(finish));
        }
        pass.set_pipeline(&pipelines.resolve);
        pass.dispatch_workgroups_indirect(&self.args, 0);
    }
}
