//! Passes before the blend, for a blend that runs elsewhere: footprints, and each tile's list in drawing order.

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use tracing::debug_span;

use super::bin::{Grid, TILE};
use super::project::{BLOCK, Splat, split};
use super::rasteriser::Rasteriser;
use super::sort::by_depth;
use super::{Gaussians, Projection, Request};

/// Side of a block of a tile, in pixels.
pub const BLOCK_PIXELS: usize = BLOCK;
/// Sides of a tile in pixels: across, down.
pub const TILE_PIXELS: [usize; 2] = [TILE[0] * BLOCK, TILE[1] * BLOCK];

/// A projected Gaussian that can change a pixel, in binary32 alone.
///
/// ```text
/// α(x, y) = min(0.99, opacity · 2^−(s² + t²))     s = q·(y − v)     t = p·(x − m − k·(y − anchor))
/// ```
///
/// The centre's row v and the footprint's middle m on the row `anchor` each have two parts that add up: a whole number
/// (where it is below 2²⁴ in size) and the rest. The anchor is the row of the image next to the centre: relative to it
/// binary32 has enough digits for the footprint, however far away its centre is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Footprint {
    /// m, the whole number and the rest.
    pub middle: [f32; 2],
    /// v, the whole number and the rest.
    pub row: [f32; 2],
    /// A row of the image.
    pub anchor: f32,
    /// k: columns per row.
    pub slope: f32,
    /// p: the inverse of the width on one row.
    pub across: f32,
    /// q: the inverse of the height.
    pub down: f32,
    /// Colour.
    pub rgb: [f32; 3],
    /// Opacity at the centre.
    pub opacity: f32,
    /// Depth of the centre.
    pub depth: f32,
    /// At least the exponent `s² + t²` at which α falls to 1/255.
    pub reach: f32,
    /// First and last column of 4×4 blocks that it can touch.
    pub columns: [u16; 2],
    /// First and last row of them.
    pub rows: [u16; 2],
}

const _: () = assert!(size_of::<Footprint>() == 64);

impl Footprint {
    fn new(splat: &Splat, height: usize) -> Self {
        let (u, v) = (f64::from(splat.x[0]) + f64::from(splat.x[1]), f64::from(splat.y[0]) + f64::from(splat.y[1]));
        let anchor = v.round_ties_even().clamp(0.0, height as f64 - 1.0);
        let (whole, rest) = split(u + splat.k * (anchor - v));
        Self {
            middle: [whole, rest],
            row: splat.y,
            anchor: anchor as f32,
            slope: splat.k as f32,
            across: splat.p,
            down: splat.q,
            rgb: splat.rgb,
            opacity: splat.opacity,
            depth: splat.depth,
            reach: splat.reach,
            columns: splat.columns,
            rows: splat.rows,
        }
    }
}

/// Footprints and the lists of the image's tiles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lists {
    /// Tiles across and down, of [`TILE_PIXELS`] each.
    pub tiles: [usize; 2],
    /// Footprints that can be seen, in the order of the Gaussians.
    pub footprints: Vec<Footprint>,
    /// Start of each tile's list in `order`, row-major; one more than tiles.
    pub starts: Vec<u32>,
    /// Places in `footprints`, each tile's front to back (ties: lower index first).
    pub order: Vec<u32>,
}

impl Rasteriser {
    /// Projects, bins and sorts `gaussians` as [`Rasteriser::render`] does and leaves the blend to the caller; `to` is
    /// overwritten. The next image is drawn as a whole. [`Rasteriser::work`] returns the cost; nothing counts as drawn.
    ///
    /// The lists are the same for every level and number of threads.
    ///
    /// # Panics
    /// As [`super::render`], and for equirectangular images. [`Request::falloff`] and [`Request::defocus`] shape the
    /// lists. The falloff of α in a footprint and the least α that is drawn are up to the blend.
    pub fn lists(&mut self, gaussians: &Gaussians<'_>, projection: &Projection, request: &Request, to: &mut Lists) {
        assert!(
            *projection != Projection::Equirectangular,
            "lists of footprints in a plane, found an equirectangular image"
        );
        self.forget();
        let (now, grid) = self.begin(gaussians, projection, request);
        self.coarse(gaussians, &now.view, grid, false);
        let start = Instant::now();
        self.sort_all(grid);
        let height = request.height;
        let visible = self.splats.iter().filter(|splat| !splat.is_hidden());
        to.footprints.clear();
        to.footprints.extend(visible.map(|splat| Footprint::new(splat, height)));
        // Place of each Gaussian's footprint.
        let mut next = 0;
        self.places.clear();
        self.places.extend(self.splats.iter().map(|splat| {
            let place = next;
            next += u32::from(!splat.is_hidden());
            place
        }));
        let entries = &self.entries[..self.work.entries as usize];
        entries.par_iter().map(|entry| self.places[entry.index as usize]).collect_into_vec(&mut to.order);
        to.tiles = [grid.columns, grid.rows];
        to.starts.clone_from(&self.starts);
        self.work.sort = start.elapsed();
    }

    /// Sorts every tile's list.
    pub(super) fn sort_all(&mut self, grid: Grid) {
        let _span = debug_span!("sort", tiles = grid.len()).entered();
        let mut rest = self.entries.as_mut_slice();
        let lists: Vec<_> = self
            .starts
            .windows(2)
            .map(|ends| rest.split_off_mut(..(ends[1] - ends[0]) as usize).expect("as many entries as were counted"))
            .collect();
        lists.into_par_iter().for_each_init(Vec::new, |spare, list| by_depth(list, spare));
    }
}
