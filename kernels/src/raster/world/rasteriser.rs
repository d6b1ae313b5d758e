//! One camera's view: projection, lists, images, and the adjoint.

#![expect(unsafe_code, reason = "tasks write sums of tiles into one array")]

use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use tracing::debug_span;

use super::super::bin::Grid;
use super::super::blend::{Shape, Transmittance, Walk};
use super::super::falloff::Cut;
use super::super::project::{Form, Splat};
use super::super::rasteriser::Rasteriser;
use super::super::{Gaussians, MAX_SIDE};
use super::adjoint::AdjointChunk;
use super::blend::{self, AdjointTile, Channels, DrawTile, MOMENTS, tiles_of};
use super::project::{self, Camera, ProjectChunk};
use super::{Drawing, FootprintGradient, Projected, TRANSMITTANCE_MIN, WorldGradients, WorldView};
use crate::level::Level;
use crate::parallel::{Disjoint, for_each_chunk};
use crate::simd::dispatch;
use crate::size::product;

/// Channels that are blended together.
const GROUP: usize = 4;
/// Gaussians of a task.
const CHUNK: usize = 2048;

/// One camera's view of Gaussians in world space: their lists, images in any colours, and the adjoint.
///
/// All methods run on the current rayon pool. Their results are the same for every level and number of threads.
#[derive(Debug)]
pub struct WorldRasteriser {
    level: Level,
    rasteriser: Rasteriser,
    camera: Camera,
    grid: Grid,
    projected: Projected,
    /// Tiles, longest lists first.
    order: Vec<u32>,
    /// Start of the sums of each Gaussian: one set for each tile of its box, row-major. One more than Gaussians.
    offsets: Vec<usize>,
    spare: Mutex<Vec<f32>>,
}

impl WorldRasteriser {
    /// A rasteriser that runs on `level`, without Gaussians and pixels.
    pub fn new(level: Level) -> Self {
        let nothing = WorldView::pinhole([[0.0; 4]; 3], [1.0; 2], [0.0; 2], [0; 2]);
        Self {
            level,
            rasteriser: Rasteriser::new(level),
            camera: Camera::new(&nothing),
            grid: Grid::new(0, 0),
            projected: Projected::default(),
            order: Vec::new(),
            offsets: vec![0],
            spare: Mutex::default(),
        }
    }

    /// Gaussians projected.
    pub fn gaussians(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Width and height of the image.
    pub fn size(&self) -> [usize; 2] {
        self.camera.size
    }

    /// The Gaussians as the camera sees them.
    pub fn projected(&self) -> &Projected {
        &self.projected
    }

    /// Bytes that are kept for the adjoint.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.rasteriser.splats[..]) + size_of_val(&self.rasteriser.entries[..]) + 44 * self.gaussians()
    }

    /// Projects, bins and sorts `gaussians`, whose means and rotations are in world space and whose colours are ignored
    /// (they may be empty).
    ///
    /// # Panics
    /// When the slices of `gaussians` differ in length, when there are 2³² Gaussians or more, or when a side of the
    /// image is longer than [`MAX_SIDE`](crate::raster::MAX_SIDE). When `view.near` is not at least 0, or
    /// `view.largest_alpha` is not above 0 and below 1.
    pub fn project(&mut self, gaussians: &Gaussians<'_>, view: &WorldView) {
        let n = gaussians.len();
        let _span = debug_span!("world_project", gaussians = n, width = view.width, height = view.height).entered();
        let gaussians = Gaussians { rgb: gaussians.mean, ..*gaussians };
        gaussians.assert_equal_lengths();
        assert!(u32::try_from(n).is_ok(), "{n} Gaussians, at most 2³² − 1");
        let [width, height] = [view.width, view.height];
        assert!(width <= MAX_SIDE && height <= MAX_SIDE, "an image of {width}×{height}, at most {MAX_SIDE} a side");
        let most = view.largest_alpha;
        assert!(most > 0.0 && most < 1.0, "a largest alpha of {most}, expected one above 0 and below 1");
        assert!(view.near >= 0.0, "a near plane at {}, expected 0 or more", view.near);
        (self.camera, self.grid) = (Camera::new(view), Grid::new(width, height));
        let Self { rasteriser, projected, camera, grid, level, .. } = self;
        rasteriser.forget();
        rasteriser.splats.resize(n, Splat::HIDDEN);
        rasteriser.dirty.resize_with(grid.len(), AtomicBool::default);
        let (chunk, tiles) = (rasteriser.chunk(), grid.len().max(1));
        rasteriser.counts.clear();
        rasteriser.counts.resize(product([n.div_ceil(chunk), grid.len()]), 0);
        projected.centre.resize(n, [0.0; 2]);
        projected.depth.resize(n, 0.0);
        projected.conic.resize(n, [0.0; 3]);
        projected.opacity.resize(n, 0.0);
        projected.radius.resize(n, [0; 2]);
        let places = projected.centre.par_chunks_mut(chunk).zip(projected.depth.par_chunks_mut(chunk));
        let shapes = projected.conic.par_chunks_mut(chunk).zip(projected.opacity.par_chunks_mut(chunk));
        let out = places.zip(shapes).zip(projected.radius.par_chunks_mut(chunk));
        let records = rasteriser.splats.par_chunks_mut(chunk);
        let (camera, grid, level) = (&*camera, *grid, *level);
        if grid.len() > 0 {
            let counts = rasteriser.counts.par_chunks_mut(tiles);
            records.zip(counts).zip(out).enumerate().for_each(|(index, ((splats, counts), out))| {
                let (((centre, depth), (conic, opacity)), radius) = out;
                let first = index * chunk;
                let gaussians = &gaussians;
                let to = project::Out { splats, counts, centre, depth, conic, opacity, radius };
                dispatch(level, ProjectChunk { gaussians, camera, grid, first, to });
            });
        }
        rasteriser.bin(grid, false);
        rasteriser.sort_all(grid);
        self.order.clear();
        self.order.extend(0..grid.len() as u32);
        let starts = &rasteriser.starts;
        let length = |tile: u32| starts[tile as usize + 1] - starts[tile as usize];
        self.order.sort_unstable_by_key(|&tile| (std::cmp::Reverse(length(tile)), tile));
        self.offsets.clear();
        self.offsets.push(0);
        let mut total = 0;
        self.offsets.extend(rasteriser.splats.iter().map(|splat| {
            if !splat.is_hidden() {
                let [columns, rows] = tiles_of(splat);
                total += (columns[1] - columns[0] + 1) * (rows[1] - rows[0] + 1);
            }
            total
        }));
    }

    /// The list of a tile, its position, and the form of α.
    fn walk(&self, tile: usize) -> Walk<'_> {
        let Rasteriser { splats, entries, starts, .. } = &self.rasteriser;
        Walk {
            splats,
            list: &entries[starts[tile] as usize..starts[tile + 1] as usize],
            shape: Shape {
                form: Form::General,
                cut: Cut::GAUSSIAN.with_bounds(self.camera.largest_alpha, TRANSMITTANCE_MIN.next_up()),
            },
            tile: [tile % self.grid.columns, tile / self.grid.columns],
            size: self.camera.size,
        }
    }

    fn assert_drawing(&self, drawing: &Drawing<'_>, image: usize, alpha: usize) {
        let ([width, height], n, channels) = (self.camera.size, self.gaussians(), drawing.channels);
        let Drawing { colours, background, .. } = drawing;
        assert_eq!(colours.len(), product([n, channels]), "{n} Gaussians of {channels} channels");
        assert!(
            background.is_empty() || background.len() == channels,
            "a background of {} for {channels} channels",
            background.len()
        );
        assert_eq!(image, product([width, height, channels]), "{width}×{height} pixels of {channels} channels");
        assert_eq!(alpha, product([width, height]), "{width}×{height} pixels of alpha");
    }

    /// The image `[H, W, D]` of the Gaussians in these colours, and its `alpha [H, W]`.
    ///
    /// # Panics
    /// When a slice has another length.
    pub fn draw(&self, drawing: &Drawing<'_>, image: &mut [f32], alpha: &mut [f32]) {
        let _span = debug_span!("world_draw", gaussians = self.gaussians(), channels = drawing.channels).entered();
        self.assert_drawing(drawing, image.len(), alpha.len());
        let (image, alpha) = (Disjoint::new(image), Disjoint::new(alpha));
        let mut first = 0;
        // Runs once without channels, for alpha.
        while first == 0 || first < drawing.channels {
            let channels = Channels { drawing: *drawing, first };
            let alpha = (first == 0).then_some(&alpha);
            match drawing.channels - first {
                0 => self.draw_group::<0>(channels, &image, alpha),
                1 => self.draw_group::<1>(channels, &image, alpha),
                2 => self.draw_group::<2>(channels, &image, alpha),
                3 => self.draw_group::<3>(channels, &image, alpha),
                _ => self.draw_group::<GROUP>(channels, &image, alpha),
            }
            first += GROUP;
        }
    }

    fn draw_group<const C: usize>(
        &self,
        channels: Channels<'_>,
        image: &Disjoint<'_, f32>,
        alpha: Option<&Disjoint<'_, f32>>,
    ) {
        self.order.par_iter().with_max_len(1).for_each_init(
            || (Transmittance::default(), Vec::new()),
            |(light, pixels), &tile| {
                let walk = self.walk(tile as usize);
                dispatch(self.level, DrawTile::<C> { walk, channels, image, alpha, light, pixels });
            },
        );
    }

    /// Gradients of a loss from those by image and alpha. Reads `of_image [H, W, D]` and `of_alpha [H, W]`; overwrites
    /// `footprints [N]`, `of_colours [N, D]` and `of_background [D]` (or nothing). `image` and `alpha` are the results
    /// of [`WorldRasteriser::draw`].
    ///
    /// # Panics
    /// When a slice has another length.
    pub fn draw_adjoint(
        &self,
        drawing: &Drawing<'_>,
        [image, alpha]: [&[f32]; 2],
        [of_image, of_alpha]: [&[f32]; 2],
        footprints: &mut [FootprintGradient],
        of_colours: &mut [f32],
        of_background: &mut [f64],
    ) {
        let _span = debug_span!("world_adjoint", gaussians = self.gaussians(), channels = drawing.channels).entered();
        self.assert_drawing(drawing, image.len(), alpha.len());
        self.assert_drawing(drawing, of_image.len(), of_alpha.len());
        let n = self.gaussians();
        assert_eq!(footprints.len(), n, "one footprint per Gaussian");
        assert_eq!(of_colours.len(), drawing.colours.len(), "gradients of as many colours");
        assert_eq!(of_background.len(), drawing.background.len(), "a gradient per channel of the background");
        footprints.fill(FootprintGradient::default());
        // Taken, as tasks of another call may run on this thread meanwhile.
        let lock = || self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let mut spare = std::mem::take(&mut *lock());
        let pixels = blend::Pixels { image, alpha, of_image, of_alpha };
        let mut first = 0;
        while first == 0 || first < drawing.channels {
            let channels = Channels { drawing: *drawing, first };
            let to = (&mut *footprints, &mut *of_colours, &mut *of_background);
            match drawing.channels - first {
                0 => self.adjoint_group::<0>(channels, pixels, &mut spare, to),
                1 => self.adjoint_group::<1>(channels, pixels, &mut spare, to),
                2 => self.adjoint_group::<2>(channels, pixels, &mut spare, to),
                3 => self.adjoint_group::<3>(channels, pixels, &mut spare, to),
                _ => self.adjoint_group::<GROUP>(channels, pixels, &mut spare, to),
            }
            first += GROUP;
        }
        *lock() = spare;
    }

    fn adjoint_group<const C: usize>(
        &self,
        channels: Channels<'_>,
        pixels: blend::Pixels<'_>,
        spare: &mut Vec<f32>,
        (footprints, of_colours, of_background): (&mut [FootprintGradient], &mut [f32], &mut [f64]),
    ) {
        let width = MOMENTS + C;
        let len = product([self.offsets[self.gaussians()], width]);
        if spare.len() < len {
            *spare = vec![0.0; len];
        } else {
            for_each_chunk(&mut spare[..len], 1 << 16, |_, part| part.fill(0.0));
        }
        let mut of_tiles = vec![[0.0_f64; C]; self.grid.len()];
        let (sums, tiles) = (Disjoint::new(&mut spare[..len]), Disjoint::new(&mut of_tiles));
        self.order.par_iter().with_max_len(1).for_each_init(blend::Buffers::default, |buffers, &tile| {
            let (walk, offsets) = (self.walk(tile as usize), &self.offsets[..]);
            let of = dispatch(self.level, AdjointTile::<C> { walk, channels, pixels, offsets, sums: &sums, buffers });
            // SAFETY: a tile is taken once.
            unsafe { tiles.part(tile as usize..tile as usize + 1)[0] = of };
        });
        for (c, to) in of_background.iter_mut().skip(channels.first).take(C).enumerate() {
            *to = of_tiles.iter().fold(0.0, |total, of| total + of[c]);
        }
        let sums = &spare[..len];
        let stride = channels.drawing.channels;
        let splats = &self.rasteriser.splats;
        let merge = |at: usize, footprint: &mut FootprintGradient, colour: &mut [f32]| {
            let mut total = [[0.0_f32; MOMENTS], [0.0; MOMENTS]];
            const { assert!(GROUP <= MOMENTS) };
            for part in sums[self.offsets[at] * width..self.offsets[at + 1] * width].chunks_exact(width) {
                for (total, part) in total[0].iter_mut().zip(part) {
                    *total += part;
                }
                for (total, part) in total[1].iter_mut().zip(&part[MOMENTS..]) {
                    *total += part;
                }
            }
            if let Some(colour) = colour.get_mut(channels.first..channels.first + C) {
                colour.copy_from_slice(&total[1][..C]);
            }
            if !splats[at].is_hidden() {
                blend::add_moments(footprint, &splats[at], total[0]);
            }
        };
        let chunks = footprints.par_chunks_mut(CHUNK).enumerate();
        if stride == 0 {
            chunks.for_each(|(index, footprints)| {
                footprints.iter_mut().enumerate().for_each(|(i, to)| merge(index * CHUNK + i, to, &mut []));
            });
        } else {
            chunks.zip(of_colours.par_chunks_mut(CHUNK * stride)).for_each(|((index, footprints), colours)| {
                for (i, (to, colour)) in footprints.iter_mut().zip(colours.chunks_exact_mut(stride)).enumerate() {
                    merge(index * CHUNK + i, to, colour);
                }
            });
        }
    }

    /// Adds to `to` the gradients with respect to Gaussians from those by their footprints and, where there are any,
    /// `of_depth [N]` by their depths z. Returns the gradient by [V | t]. `gaussians` are those that were projected.
    ///
    /// # Panics
    /// When a slice has another length.
    pub fn project_adjoint(
        &self,
        gaussians: &Gaussians<'_>,
        footprints: &[FootprintGradient],
        of_depth: Option<&[f32]>,
        to: WorldGradients<'_>,
    ) -> [[f64; 4]; 3] {
        let n = self.gaussians();
        let _span = debug_span!("world_project_adjoint", gaussians = n).entered();
        let gaussians = Gaussians { rgb: gaussians.mean, ..*gaussians };
        gaussians.assert_equal_lengths();
        let WorldGradients { mean, rotation, scale, opacity } = to;
        assert!(
            [gaussians.len(), footprints.len(), mean.len(), rotation.len(), scale.len(), opacity.len()] == [n; 6]
                && of_depth.is_none_or(|of| of.len() == n),
            "gradients of {n} Gaussians"
        );
        let (camera, level, splats) = (&self.camera, self.level, &self.rasteriser.splats[..]);
        let places = mean.par_chunks_mut(CHUNK).zip(rotation.par_chunks_mut(CHUNK));
        let rest = scale.par_chunks_mut(CHUNK).zip(opacity.par_chunks_mut(CHUNK));
        let views: Vec<[[f64; 4]; 3]> = places
            .zip(rest)
            .enumerate()
            .map(|(index, ((mean, rotation), (scale, opacity)))| {
                let to = WorldGradients { mean, rotation, scale, opacity };
                let (gaussians, first) = (&gaussians, index * CHUNK);
                dispatch(level, AdjointChunk { gaussians, camera, splats, footprints, of_depth, first, to })
            })
            .collect();
        let mut view = [[0.0; 4]; 3];
        for part in views {
            for (view, part) in view.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
                *view += part;
            }
        }
        view
    }
}
