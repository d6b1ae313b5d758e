//! An adapter, its device, and memory on it.

use wgpu::{
    Adapter, Buffer, BufferUsages, ComputePipeline, Device, DeviceDescriptor, ErrorFilter, Instance,
    InstanceDescriptor, Limits, PowerPreference, Queue, RequestAdapterOptions,
};

use super::WgpuError;

/// A device that blends.
#[derive(Debug)]
pub(super) struct Gpu {
    pub device: Device,
    pub queue: Queue,
    pub pipeline: ComputePipeline,
    /// The adapter's name, its driver and its kind.
    pub name: String,
    /// Maximum bytes of a buffer.
    most: u64,
}

/// Finds the strongest adapter; a software one if there is no other.
fn adapter() -> Result<Adapter, WgpuError> {
    if Instance::enabled_backend_features().is_empty() {
        return Err(WgpuError::NoAdapter { reason: "this system has no Vulkan".into() });
    }
    let instance = Instance::new(InstanceDescriptor {
        backends: wgpu::Backends::VULKAN,
        ..InstanceDescriptor::new_without_display_handle()
    });
    let options = RequestAdapterOptions {
        power_preference: PowerPreference::HighPerformance,
        ..RequestAdapterOptions::default()
    };
    pollster::block_on(instance.request_adapter(&options)).map_err(|e| WgpuError::NoAdapter { reason: e.to_string() })
}

impl Gpu {
    /// Finds an adapter and prepares the shader.
    pub fn new() -> Result<Self, WgpuError> {
        let adapter = adapter()?;
        let info = adapter.get_info();
        let name = format!("{} ({:?}, {})", info.name, info.device_type, info.driver);
        let found = adapter.limits();
        let limits = Limits {
            max_buffer_size: found.max_buffer_size,
            max_storage_buffer_binding_size: found.max_storage_buffer_binding_size,
            ..Limits::downlevel_defaults()
        };
        let descriptor = DeviceDescriptor { required_limits: limits, ..DeviceDescriptor::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| WgpuError::NoDevice { adapter: name.clone(), reason: e.to_string() })?;
        let most = found.max_buffer_size.min(found.max_storage_buffer_binding_size);
        let pipeline = guarded(&device, &name, || {
            let module = device.create_shader_module(wgpu::include_wgsl!("blend.wgsl"));
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("blend"),
                layout: None,
                module: &module,
                entry_point: Some("blend"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        })?;
        Ok(Self { device, queue, pipeline, name, most })
    }

    /// Runs `work`; fails with the first error that the device reported.
    pub fn guarded<R>(&self, work: impl FnOnce() -> R) -> Result<R, WgpuError> {
        guarded(&self.device, &self.name, work)
    }

    /// Returns the error of a failed device.
    pub fn failed(&self, reason: impl std::fmt::Display) -> WgpuError {
        WgpuError::Failed { adapter: self.name.clone(), reason: reason.to_string() }
    }

    /// Returns an error if the bytes do not fit one buffer.
    pub fn fits(&self, what: &'static str, bytes: u64) -> Result<(), WgpuError> {
        if bytes > self.most {
            return Err(WgpuError::TooLarge { adapter: self.name.clone(), what, most: self.most, found: bytes });
        }
        Ok(())
    }

    /// Makes `buffer` hold at least `bytes`. Its content is lost when it grows.
    pub fn reserve(&self, buffer: &mut Option<Buffer>, usage: BufferUsages, bytes: u64) {
        // Bindings must not be empty.
        let size = bytes.max(64);
        if buffer.as_ref().is_none_or(|buffer| buffer.size() < size) {
            let descriptor = wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
            *buffer = Some(self.device.create_buffer(&descriptor));
        }
    }
}

/// Runs `work`; fails with the first error that the device reported.
fn guarded<R>(device: &Device, name: &str, work: impl FnOnce() -> R) -> Result<R, WgpuError> {
    let scopes = [ErrorFilter::OutOfMemory, ErrorFilter::Validation, ErrorFilter::Internal]
        .map(|filter| device.push_error_scope(filter));
    let result = work();
    let mut first = None;
    for scope in scopes.into_iter().rev() {
        first = pollster::block_on(scope.pop()).or(first);
    }
    match first {
        Some(error) => Err(WgpuError::Failed { adapter: name.to_owned(), reason: error.to_string() }),
        None => Ok(result),
    }
}
