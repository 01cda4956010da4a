//! The device: choosing an adapter, catching its errors, counting what crosses the bus.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicU64, Ordering},
};

use crate::error::RenderError;

/// Backends that can render to 32-bit floating-point targets. OpenGL cannot, so it is not asked.
const BACKENDS: wgpu::Backends = wgpu::Backends::PRIMARY;

/// Storage buffers that one stage of the widest pass reads.
const STORAGE_BUFFERS: u32 = 8;
/// Storage textures that the G-buffer pass writes.
const STORAGE_TEXTURES: u32 = 4;

/// A GPU, or software that acts as one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AdapterSummary {
    /// Name by the driver.
    pub name: String,
    /// `Vulkan`, `Metal` or `Dx12`.
    pub backend: String,
    /// True where the CPU does the work (llvmpipe, WARP).
    pub software: bool,
    /// Driver and its version.
    pub driver: String,
}

impl AdapterSummary {
    fn new(info: &wgpu::AdapterInfo) -> Self {
        Self {
            name: info.name.clone(),
            backend: format!("{:?}", info.backend),
            software: info.device_type == wgpu::DeviceType::Cpu,
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_string(),
        }
    }
}

fn adapters() -> Vec<wgpu::Adapter> {
    let descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    let backends = descriptor.backends & BACKENDS;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor { backends, ..descriptor });
    pollster::block_on(instance.enumerate_adapters(backends))
}

/// All adapters that this machine has, in the order in which [`super::GpuRaster::new`] prefers them.
pub fn list_adapters() -> Vec<AdapterSummary> {
    let mut all: Vec<_> = adapters().iter().map(|a| a.get_info()).collect();
    all.sort_by_key(preference);
    all.iter().map(AdapterSummary::new).collect()
}

fn preference(info: &wgpu::AdapterInfo) -> u32 {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

/// What keeps an adapter from serving, in words.
fn missing(limits: &wgpu::Limits) -> Option<String> {
    if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
        return Some(format!(
            "{STORAGE_BUFFERS} storage buffers a stage (it has {})",
            limits.max_storage_buffers_per_shader_stage
        ));
    }
    if limits.max_storage_textures_per_shader_stage < STORAGE_TEXTURES {
        return Some(format!(
            "{STORAGE_TEXTURES} storage textures a stage (it has {})",
            limits.max_storage_textures_per_shader_stage
        ));
    }
    if limits.max_compute_invocations_per_workgroup < super::shader::COMPACT_BLOCK {
        return Some(format!("compute workgroups of {} invocations", super::shader::COMPACT_BLOCK));
    }
    if limits.max_uniform_buffer_binding_size < 64 << 10 {
        return Some("uniform buffers of 64 KiB".into());
    }
    None
}

/// Leave to use ray queries, which wgpu calls experimental.
#[allow(unsafe_code)]
fn ray_queries() -> wgpu::ExperimentalFeatures {
    // SAFETY: the one shader that uses them (shaders/tracer/hits_rayquery.wgsl) initialises each query before it proceeds,
    // reads candidates only after `rayQueryProceed` was true, and binds trees that were built in an earlier or the same
    // submission.
    unsafe { wgpu::ExperimentalFeatures::enabled() }
}

/// A device with what the lane needs, and what went wrong with it.
pub(crate) struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub summary: AdapterSummary,
    fault: Arc<Mutex<Option<String>>>,
    bytes_up: AtomicU64,
    bytes_down: AtomicU64,
    pipelines: AtomicU64,
}

impl Gpu {
    /// The best adapter that can serve.
    pub fn open() -> Result<Self, RenderError> {
        let unavailable = |missing: String| RenderError::Unavailable { choice: "--raster gpu".into(), missing };
        let mut found = adapters();
        found.sort_by_key(|a| preference(&a.get_info()));
        let mut why = "no Vulkan, Metal or Direct3D 12 adapter on this machine".to_string();
        for adapter in found {
            let info = adapter.get_info();
            let limits = adapter.limits();
            if let Some(missing) = missing(&limits) {
                why = format!("{} lacks {missing}", info.name);
                continue;
            }
            let wanted = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
            let request = |features: wgpu::Features| {
                let experimental = features.contains(wgpu::Features::EXPERIMENTAL_RAY_QUERY);
                pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
                    label: Some("catoptra"),
                    required_features: adapter.features() & features,
                    required_limits: limits.clone(),
                    experimental_features: if experimental { ray_queries() } else { Default::default() },
                    ..Default::default()
                }))
            };
            // Ray queries where there are any; an adapter that says so and gives no device serves without.
            let queries = adapter.features() & wgpu::Features::EXPERIMENTAL_RAY_QUERY;
            match request(wanted | queries).or_else(|_| request(wanted)) {
                Ok((device, queue)) => {
                    let gpu = Self::with(device, queue, AdapterSummary::new(&info));
                    gpu.catch_faults();
                    return Ok(gpu);
                }
                Err(error) => why = format!("{} gives no device: {error}", info.name),
            }
        }
        Err(unavailable(why))
    }

    /// A device of the host's. Its error callbacks stay the host's own; this lane sees its errors by scopes.
    pub fn borrow(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self, RenderError> {
        if let Some(missing) = missing(&device.limits()) {
            return Err(RenderError::Unavailable { choice: "the given device".into(), missing });
        }
        Ok(Self::lend(device, queue))
    }

    /// [`Self::borrow`] for passes that need nothing special of the device.
    pub fn lend(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let summary = AdapterSummary::new(&device.adapter_info());
        Self::with(device, queue, summary)
    }

    /// Makes every further step fail with `message`, as a reported fault of the device does.
    pub fn report_fault(&self, message: &str) {
        let mut slot = self.fault.lock().unwrap_or_else(|e| e.into_inner());
        slot.get_or_insert_with(|| message.to_string());
    }

    fn with(device: wgpu::Device, queue: wgpu::Queue, summary: AdapterSummary) -> Self {
        Self {
            device,
            queue,
            summary,
            fault: Arc::default(),
            bytes_up: AtomicU64::new(0),
            bytes_down: AtomicU64::new(0),
            pipelines: AtomicU64::new(0),
        }
    }

    fn catch_faults(&self) {
        let keep = |fault: &Arc<Mutex<Option<String>>>, message: String| {
            let mut slot = fault.lock().unwrap_or_else(|e| e.into_inner());
            slot.get_or_insert(message);
        };
        let fault = self.fault.clone();
        self.device
            .on_uncaptured_error(Arc::new(move |error: wgpu::Error| keep(&fault, first_line(&error.to_string()))));
        let fault = self.fault.clone();
        self.device.set_device_lost_callback(move |reason, message| {
            keep(&fault, format!("device lost ({reason:?}): {message}"));
        });
    }

    /// What [`Scope::scoped`] needs, apart from the rest.
    pub fn handles(&self) -> Scope {
        Scope { device: self.device.clone(), fault: self.fault.clone() }
    }

    /// [`Scope::scoped`]
    pub fn scoped<T>(&self, work: impl FnOnce() -> Result<T, RenderError>) -> Result<T, RenderError> {
        self.handles().scoped(work)
    }

    /// Waits until all submitted work is done.
    pub fn wait(&self) -> Result<(), RenderError> {
        match self.device.poll(wgpu::PollType::wait_indefinitely()) {
            Ok(_) => Ok(()),
            Err(error) => Err(RenderError::Gpu(error.to_string())),
        }
    }

    /// Waits until a submission and all before it are done; what was submitted later goes on.
    pub fn wait_for(&self, submission: &wgpu::SubmissionIndex) -> Result<(), RenderError> {
        let wait = wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout: None };
        match self.device.poll(wait) {
            Ok(_) => Ok(()),
            Err(error) => Err(RenderError::Gpu(error.to_string())),
        }
    }

    /// Copies to a buffer and counts the bytes.
    pub fn upload(&self, buffer: &wgpu::Buffer, offset: u64, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.queue.write_buffer(buffer, offset, bytes);
            self.count_up(bytes.len() as u64);
        }
    }

    pub fn count_up(&self, bytes: u64) {
        self.bytes_up.fetch_add(bytes, Ordering::Relaxed);
    }

    pub fn count_down(&self, bytes: u64) {
        self.bytes_down.fetch_add(bytes, Ordering::Relaxed);
    }

    /// A pipeline was made.
    pub fn count_pipeline(&self) {
        self.pipelines.fetch_add(1, Ordering::Relaxed);
    }

    /// Pipelines made so far.
    pub fn pipelines(&self) -> u64 {
        self.pipelines.load(Ordering::Relaxed)
    }

    pub fn reset_counters(&self) {
        self.bytes_up.store(0, Ordering::Relaxed);
        self.bytes_down.store(0, Ordering::Relaxed);
    }

    /// (bytes sent, bytes read back).
    pub fn counters(&self) -> (u64, u64) {
        (self.bytes_up.load(Ordering::Relaxed), self.bytes_down.load(Ordering::Relaxed))
    }

    pub fn encoder(&self, label: &str) -> wgpu::CommandEncoder {
        self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) })
    }
}

/// Catches the errors of a device.
pub(crate) struct Scope {
    device: wgpu::Device,
    fault: Arc<Mutex<Option<String>>>,
}

impl Scope {
    /// Runs `work` and turns every error of the device into [`RenderError::Gpu`].
    pub fn scoped<T>(&self, work: impl FnOnce() -> Result<T, RenderError>) -> Result<T, RenderError> {
        self.run(RenderError::Gpu, work)
    }

    /// [`Self::scoped`] for work on a view of the host's: what is wrong with its use is [`RenderError::View`], and the device
    /// is not to blame.
    pub fn scoped_view<T>(&self, work: impl FnOnce() -> Result<T, RenderError>) -> Result<T, RenderError> {
        self.run(RenderError::View, work)
    }

    fn run<T>(
        &self,
        misuse: fn(String) -> RenderError,
        work: impl FnOnce() -> Result<T, RenderError>,
    ) -> Result<T, RenderError> {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let result = work();
        // A lost device raises no errors: its callback, which polling calls, is the only sign.
        let polled = self.device.poll(wgpu::PollType::Poll);
        let misused = pollster::block_on(validation.pop());
        let failed = [pollster::block_on(internal.pop()), pollster::block_on(memory.pop())];
        if let Some(error) = failed.into_iter().flatten().next_back() {
            return Err(RenderError::Gpu(first_line(&error.to_string())));
        }
        if let Some(message) = self.fault.lock().unwrap_or_else(|e| e.into_inner()).clone() {
            return Err(RenderError::Gpu(message));
        }
        if let Err(error) = polled {
            return Err(RenderError::Gpu(error.to_string()));
        }
        if let Some(error) = misused {
            return Err(misuse(first_line(&error.to_string())));
        }
        result
    }
}

fn first_line(message: &str) -> String {
    // wgpu's messages carry their cause on later lines; one line must say it.
    message.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join(" ")
}

/// A buffer that is replaced by a larger one when it is too small.
pub(crate) struct GrowBuffer {
    pub buffer: wgpu::Buffer,
    label: &'static str,
    usage: wgpu::BufferUsages,
}

impl GrowBuffer {
    pub fn new(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages, size: u64) -> Self {
        Self { buffer: Self::create(gpu, label, usage, size), label, usage }
    }

    fn create(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
        let size = size.max(256).next_multiple_of(256);
        gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
    }

    /// Makes room for `size` bytes; true where the buffer was replaced (its contents are gone).
    pub fn reserve(&mut self, gpu: &Gpu, size: u64) -> bool {
        if size <= self.buffer.size() {
            return false;
        }
        // Half as much again, so that a growing world does not replace it every frame - within what one buffer may hold.
        let roomy = (size + size / 2).min(gpu.device.limits().max_buffer_size & !255).max(size);
        self.buffer = Self::create(gpu, self.label, self.usage, roomy);
        true
    }
}
