//! Drawing with a graphics card, through `wgpu` and Vulkan. Outside of the bit contract.
//!
//! The Gaussians are projected, binned and sorted on the CPU by the code of the contract
//! ([`streamsplat_kernels::raster::Rasteriser::lists`]). Footprints and lists are uploaded to the device, where a
//! compute shader (`blend.wgsl`) blends every pixel. The requested planes are read back.
//!
//! # Outside of the bit contract
//!
//! The shading language leaves rounding to devices: multiply-adds may be fused or not, and 2^x has its own error.
//! Images therefore differ between devices and from the CPU's, within 2/255 on all but one pixel in 2,000. They differ
//! more where a rounding decides whether an α reaches 1/255 or a pixel is finished.
//!
//! # Memory
//!
//! 64 bytes per visible Gaussian, 4 per tile that it touches, 4 per pixel of every plane. A request that does not fit
//! one buffer of the device is an error ([`WgpuError::TooLarge`]).

mod device;
mod error;

pub use error::WgpuError;

use std::sync::mpsc;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Gaussians, Image, Lists, Projection, Rasteriser, Request, TILE_PIXELS, Work};
use wgpu::{Buffer, BufferUsages};

use device::Gpu;

/// Pixels per side of a workgroup.
const SIDE: u32 = 16;
// The shader divides by these.
const _: () = assert!(TILE_PIXELS[0] == 64 && TILE_PIXELS[1] == 32);

/// A renderer that blends on a graphics card.
#[derive(Debug)]
pub struct WgpuRasteriser {
    gpu: Gpu,
    coarse: Rasteriser,
    lists: Lists,
    buffers: Buffers,
    image: Image,
    work: Work,
}

/// Memory of the device, kept between images.
#[derive(Debug, Default)]
struct Buffers {
    parameters: Option<Buffer>,
    footprints: Option<Buffer>,
    starts: Option<Buffer>,
    order: Option<Buffer>,
    image: Option<Buffer>,
    /// Staging buffer, from which the image is read.
    readable: Option<Buffer>,
}

/// The shader's parameters.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Parameters {
    size: [u32; 2],
    columns: u32,
    unused: u32,
    planes: [u32; 4],
    background: [f32; 4],
}

/// Returns the numbers of the requested planes, and their count with the three of colour.
fn planes(request: &Request) -> ([u32; 4], u32) {
    let mut next = 3;
    let wanted = [request.depth, request.alpha, request.statistics, request.statistics];
    let planes = wanted.map(|wanted| {
        let plane = if wanted { next } else { 0 };
        next += u32::from(wanted);
        plane
    });
    (planes, next)
}

impl WgpuRasteriser {
    /// Returns a renderer on the strongest adapter, which may be a software one. The part on the CPU runs on `level`.
    ///
    /// # Errors
    /// If there is no adapter or it has no device.
    pub fn new(level: Level) -> Result<Self, WgpuError> {
        Ok(Self {
            gpu: Gpu::new()?,
            coarse: Rasteriser::new(level),
            lists: Lists::default(),
            buffers: Buffers::default(),
            image: Image::default(),
            work: Work::default(),
        })
    }

    /// Returns the adapter's name, kind and driver.
    pub fn adapter(&self) -> &str {
        &self.gpu.name
    }

    /// Returns the counts of the last image's work; `blend` is the time from the upload to the last plane's arrival.
    pub fn work(&self) -> Work {
        self.work
    }

    /// Returns the last image.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Returns the last image and drops the renderer.
    pub fn into_image(self) -> Image {
        self.image
    }

    /// Draws `gaussians` on the current rayon pool and waits for the device.
    ///
    /// # Errors
    /// If the scene does not fit the device, or the device fails.
    ///
    /// # Panics
    /// As [`streamsplat_kernels::raster::render`].
    pub fn render(
        &mut self,
        gaussians: &Gaussians<'_>,
        projection: &Projection,
        request: &Request,
    ) -> Result<&Image, WgpuError> {
        self.coarse.lists(gaussians, projection, request, &mut self.lists);
        self.work = self.coarse.work();
        let start = Instant::now();
        self.image = Image {
            width: request.width,
            height: request.height,
            dropped: self.work.dropped,
            ..std::mem::take(&mut self.image)
        };
        let values = if request.width * request.height == 0 { Vec::new() } else { self.blend(request)? };
        self.take(values, request);
        self.work.blend = start.elapsed();
        self.work.tiles_drawn = self.work.tiles;
        Ok(&self.image)
    }

    /// Stores the requested planes of `values`.
    fn take(&mut self, mut values: Vec<f32>, request: &Request) {
        let pixels = request.width * request.height;
        let ([depth, alpha, final_t, blended], _) = planes(request);
        let plane = |number: u32| (number > 0).then(|| values[number as usize * pixels..][..pixels].to_vec());
        let image = &mut self.image;
        (image.depth, image.alpha, image.final_t) = (plane(depth), plane(alpha), plane(final_t));
        image.blended = plane(blended).map(|counts| counts.into_iter().map(|count| count as u32).collect());
        values.truncate(3 * pixels);
        image.rgb = values;
    }

    /// Uploads the lists, blends, and returns the planes one after another.
    fn blend(&mut self, request: &Request) -> Result<Vec<f32>, WgpuError> {
        let _span = tracing::debug_span!("blend", width = request.width, height = request.height).entered();
        let (gpu, lists) = (&self.gpu, &self.lists);
        let (planes, count) = planes(request);
        let bytes = 4 * u64::from(count) * (request.width * request.height) as u64;
        gpu.fits("the image", bytes)?;
        gpu.fits("the Gaussians in view", size_of_val(&lists.footprints[..]) as u64)?;
        gpu.fits("the Gaussians of all tiles", size_of_val(&lists.order[..]) as u64)?;
        let [red, green, blue] = request.background.map(|c| if c.is_finite() { c } else { 0.0 });
        let parameters = Parameters {
            size: [request.width as u32, request.height as u32],
            columns: lists.tiles[0] as u32,
            unused: 0,
            planes,
            background: [red, green, blue, 0.0],
        };
        let Buffers { image, readable, .. } = &mut self.buffers;
        gpu.guarded(|| {
            gpu.reserve(image, BufferUsages::STORAGE | BufferUsages::COPY_SRC, bytes);
            gpu.reserve(readable, BufferUsages::MAP_READ | BufferUsages::COPY_DST, bytes);
        })?;
        let buffers = &mut self.buffers;
        let uploads: [(&mut Option<Buffer>, BufferUsages, &[u8]); 4] = [
            (&mut buffers.parameters, BufferUsages::UNIFORM, bytemuck::bytes_of(&parameters)),
            (&mut buffers.footprints, BufferUsages::STORAGE, bytemuck::cast_slice(&lists.footprints)),
            (&mut buffers.starts, BufferUsages::STORAGE, bytemuck::cast_slice(&lists.starts)),
            (&mut buffers.order, BufferUsages::STORAGE, bytemuck::cast_slice(&lists.order)),
        ];
        gpu.guarded(|| {
            for (buffer, usage, bytes) in uploads {
                gpu.reserve(buffer, usage | BufferUsages::COPY_DST, bytes.len() as u64);
                if let Some(buffer) = buffer {
                    gpu.queue.write_buffer(buffer, 0, bytes);
                }
            }
        })?;
        self.dispatch(request, bytes)
    }

    /// Runs the shader over the image and reads the first `bytes` of the planes.
    fn dispatch(&self, request: &Request, bytes: u64) -> Result<Vec<f32>, WgpuError> {
        let (gpu, b) = (&self.gpu, &self.buffers);
        let all = [&b.parameters, &b.footprints, &b.starts, &b.order, &b.image];
        let [Some(parameters), Some(footprints), Some(starts), Some(order), Some(image)] = all.map(Option::as_ref)
        else {
            return Err(gpu.failed("no memory"));
        };
        let readable = b.readable.as_ref().ok_or_else(|| gpu.failed("no memory"))?;
        let (sender, receiver) = mpsc::channel();
        gpu.guarded(|| {
            let bound = [parameters, footprints, starts, order, image];
            let entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
                .zip(bound)
                .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
                .collect();
            let layout = gpu.pipeline.get_bind_group_layout(0);
            let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &layout, entries: &entries };
            let group = gpu.device.create_bind_group(&descriptor);
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&gpu.pipeline);
            pass.set_bind_group(0, &group, &[]);
            let groups = [request.width, request.height].map(|side| (side as u32).div_ceil(SIDE));
            pass.dispatch_workgroups(groups[0], groups[1], 1);
            drop(pass);
            encoder.copy_buffer_to_buffer(image, 0, readable, 0, bytes);
            gpu.queue.submit([encoder.finish()]);
            // The receiver lives as long as this call.
            readable.map_async(wgpu::MapMode::Read, ..bytes, move |result| drop(sender.send(result)));
        })?;
        gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| gpu.failed(e))?;
        receiver.recv().map_err(|e| gpu.failed(e))?.map_err(|e| gpu.failed(e))?;
        let values = {
            let view = readable.get_mapped_range(..bytes).map_err(|e| gpu.failed(e))?;
            bytemuck::pod_collect_to_vec(&view)
        };
        readable.unmap();
        Ok(values)
    }
}
