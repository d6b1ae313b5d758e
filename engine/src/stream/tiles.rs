//! A frame as tiles of the size that the model takes.
//!
//! A network takes frames of one size; a larger frame goes through it in rectangular parts, each as a frame of its own.
//! The network has no context beyond a frame's border, so results there fit the neighbouring tile badly. So on each
//! side with a neighbour a tile takes in [`HALO`] patches more than it keeps. Along an axis there are as few tiles as
//! possible, and the lengths that they keep differ by at most one patch. A network that takes no smaller grid than its
//! own ([`Tiling::partial`]) gets tiles of its own size, which overlap by at least twice the halo; of an overlap each
//! tile keeps its half.
//!
//! Gaussians of the tile with first pixel `(x₀, y₀)` and size `w × h` in a frame of `W × H` are mapped to the frame's
//! world by
//!
//! ```text
//! x' = x·(w/W) + ((2·x₀ + w)/W − 1)     z' = z·(h/H) + (1 − (2·y₀ + h)/H)     y' = y
//! s_x' = s_x·(w/W)     s_z' = s_z·(h/H)     v_x' = v_x·(w/W)     v_z' = v_z·(h/H)
//! ```
//!
//! with factors and offsets rounded from binary64, one fused multiply-add each. In the frame's arrays they are in row
//! order, as if there were no tiles.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use streamsplat_model::reuse::Saving;
use streamsplat_model::{StaticGaussian, StaticGaussians};

use super::reconstructor::{Motion, Reconstructor, Session, Tiling};
use crate::fit::cut;

/// Patches that a tile takes in beyond those that it keeps.
const HALO: usize = 1;

/// A part of the frame, and a session of the model for frames of its size.
pub(super) struct Tile {
    pub(super) session: Box<dyn Session>,
    /// First row and column of pixels.
    origin: [usize; 2],
    /// Rows and columns of pixels.
    size: [usize; 2],
    /// The Gaussians that it keeps: their indices in its own arrays and in the frame's. `None`: all of them, and the
    /// frame has no others.
    places: Option<Vec<[u32; 2]>>,
    /// Its grid of patches, where the model has one.
    grid: Option<Grid>,
}

/// The patches of a tile.
#[derive(Clone, Copy)]
struct Grid {
    /// Columns of patches.
    columns: usize,
    /// Cells along a patch's side.
    cells: usize,
    /// Patches.
    count: usize,
}

impl Grid {
    fn new(size: [usize; 2], Tiling { patch, cells, .. }: Tiling) -> Grid {
        let [rows, columns] = size.map(|side| side / patch);
        Grid { columns, cells, count: rows * columns }
    }

    /// The patch of a cell.
    fn patch(self, cell: usize) -> usize {
        let (y, x) = (cell / (self.columns * self.cells), cell % (self.columns * self.cells));
        y / self.cells * self.columns + x / self.cells
    }
}

/// What of a tile must be computed.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Part {
    Nothing,
    /// These patches, ascending.
    Patches(Vec<u32>),
    Everything,
}

impl Part {
    /// Returns true if this contains `other`.
    pub(super) fn contains(&self, other: &Part) -> bool {
        match (self, other) {
            (Part::Everything, _) | (_, Part::Nothing) => true,
            (Part::Patches(own), Part::Patches(others)) => others.iter().all(|patch| own.binary_search(patch).is_ok()),
            _ => false,
        }
    }
}

/// All tiles of a frame, row by row.
pub(super) struct Tiles {
    /// Rows and columns of pixels of a frame.
    pub(super) resolution: [usize; 2],
    pub(super) tiles: Vec<Tile>,
    pub(super) ignores_depth: bool,
}

/// One axis of a tile, in patches: the span that it takes in, and the part of it that it keeps.
#[derive(Clone, Debug, PartialEq)]
struct Span {
    seen: Range<usize>,
    kept: Range<usize>,
}

impl Tiles {
    /// The tiles of frames of `resolution`; `None` where the model takes no part of such a frame.
    pub(super) fn new(model: &Arc<dyn Reconstructor>, resolution: [usize; 2], saving: Option<Saving>) -> Option<Self> {
        if resolution == model.resolution() {
            let session = model.clone().session(saving);
            let grid = model.tiling().map(|tiling| Grid::new(resolution, tiling));
            let whole = Tile { session, origin: [0; 2], size: resolution, places: None, grid };
            return Some(Self { resolution, tiles: vec![whole], ignores_depth: model.ignores_depth() });
        }
        let tiling = model.tiling()?;
        let Tiling { patch, cells, partial } = tiling;
        if resolution.iter().any(|side| *side == 0 || side % patch != 0) {
            return None;
        }
        let [rows, columns] =
            [0, 1].map(|axis| spans(resolution[axis] / patch, model.resolution()[axis] / patch, partial));
        let (rows, columns) = (rows?, columns?);
        let mut models: BTreeMap<[usize; 2], Arc<dyn Reconstructor>> = BTreeMap::new();
        let mut tiles = Vec::with_capacity(rows.len() * columns.len());
        for row in &rows {
            for column in &columns {
                let size = [row.seen.len() * patch, column.seen.len() * patch];
                let sized = match models.get(&size) {
                    Some(sized) => sized.clone(),
                    None => {
                        let sized = if size == model.resolution() { model.clone() } else { model.at(size)? };
                        models.insert(size, sized.clone());
                        sized
                    }
                };
                let width = resolution[1] / patch * cells;
                let kept = |span: &Span| span.kept.start * cells..span.kept.end * cells;
                let places = kept(row).flat_map(|y| {
                    kept(column).map(move |x| {
                        let own =
                            (y - row.seen.start * cells) * column.seen.len() * cells + x - column.seen.start * cells;
                        [own as u32, (y * width + x) as u32]
                    })
                });
                tiles.push(Tile {
                    session: sized.session(saving),
                    origin: [row.seen.start * patch, column.seen.start * patch],
                    size,
                    places: Some(places.collect()),
                    grid: Some(Grid::new(size, tiling)),
                });
            }
        }
        Some(Self { resolution, tiles, ignores_depth: model.ignores_depth() })
    }

    /// Returns true if the model ignores depth.
    pub(super) fn ignores_depth(&self) -> bool {
        self.ignores_depth
    }

    /// Composes the frame's Gaussians from those of its tiles; cells of tiles without Gaussians have
    /// the defaults.
    pub(super) fn gaussians(&self, of_tiles: &[Option<Arc<StaticGaussians>>]) -> Arc<StaticGaussians> {
        if let [Some(only)] = of_tiles
            && self.tiles[0].places.is_none()
        {
            return only.clone();
        }
        let count = self.tiles.iter().map(|tile| tile.places.as_ref().map_or(0, Vec::len)).sum();
        let mut frame: StaticGaussians = std::iter::repeat_n(StaticGaussian::default(), count).collect();
        for (tile, own) in self.tiles.iter().zip(of_tiles) {
            let Some(own) = own else { continue };
            let ([fx, fz], [ox, oz]) = (self.factors(tile), self.offsets(tile));
            for &[from, to] in tile.places.iter().flatten() {
                let own = own.get(from as usize);
                let ([x, y, z], [sx, sz]) = (own.position, own.scale);
                let position = [x.mul_add(fx, ox), y, z.mul_add(fz, oz)];
                frame.set(to as usize, StaticGaussian { position, scale: [sx * fx, sz * fz], ..own });
            }
        }
        Arc::new(frame)
    }

    /// Composes the motion of the frame's Gaussians from that of its tiles.
    pub(super) fn motion(&self, of_tiles: &[Arc<Motion>]) -> Arc<Motion> {
        if let [only] = of_tiles
            && self.tiles[0].places.is_none()
        {
            return only.clone();
        }
        let count = self.tiles.iter().map(|tile| tile.places.as_ref().map_or(0, Vec::len)).sum();
        let (mut velocity, mut gamma) = (vec![[0.0; 3]; count], vec![[0.0; 2]; count]);
        for (tile, own) in self.tiles.iter().zip(of_tiles) {
            let [fx, fz] = self.factors(tile);
            for &[from, to] in tile.places.iter().flatten() {
                let [x, y, z] = own.0[from as usize];
                velocity[to as usize] = [x * fx, y, z * fz];
                gamma[to as usize] = own.1[from as usize];
            }
        }
        Arc::new((velocity, gamma))
    }

    /// w/W and h/H.
    fn factors(&self, tile: &Tile) -> [f32; 2] {
        [1, 0].map(|axis| (tile.size[axis] as f64 / self.resolution[axis] as f64) as f32)
    }

    /// The tile's middle in the frame's world.
    fn offsets(&self, tile: &Tile) -> [f32; 2] {
        let middle =
            |axis: usize| (2 * tile.origin[axis] + tile.size[axis]) as f64 / self.resolution[axis] as f64 - 1.0;
        [middle(1) as f32, -middle(0) as f32]
    }
}

impl Tile {
    /// The patches that contain Gaussians which it keeps and which are `wanted` (`None`: all), indexed by
    /// the frame's cells.
    pub(super) fn part(&self, wanted: Option<&[bool]>) -> Part {
        let wanted = |cell: usize| wanted.is_none_or(|wanted| wanted[cell]);
        let Some(grid) = self.grid else { return Part::Everything };
        let mut marks = vec![false; grid.count];
        match &self.places {
            None => (0..grid.count * grid.cells.pow(2))
                .filter(|cell| wanted(*cell))
                .for_each(|cell| marks[grid.patch(cell)] = true),
            Some(places) => places
                .iter()
                .filter(|[_, to]| wanted(*to as usize))
                .for_each(|[own, _]| marks[grid.patch(*own as usize)] = true),
        }
        let patches: Vec<u32> = (0..grid.count as u32).filter(|patch| marks[*patch as usize]).collect();
        match patches.len() {
            0 => Part::Nothing,
            count if count == grid.count => Part::Everything,
            _ => Part::Patches(patches),
        }
    }

    /// The numbers of patches that are computed and left out with `part`; zeros where the model has none.
    pub(super) fn computed(&self, part: &Part) -> [u64; 2] {
        let all = self.grid.map_or(0, |grid| grid.count as u64);
        let done = match part {
            Part::Nothing => 0,
            Part::Patches(patches) => patches.len() as u64,
            Part::Everything => all,
        };
        [done, all - done]
    }

    /// The tile's pixels in planes of a frame of `resolution`, `[C, H, W]` to `[C, h, w]`.
    pub(super) fn cut(&self, resolution: [usize; 2], planes: &[f32]) -> Vec<f32> {
        if self.places.is_none() {
            return planes.to_vec();
        }
        cut(planes, resolution, &[0, 1].map(|axis| self.origin[axis]..self.origin[axis] + self.size[axis]))
    }

    /// Returns true if the tile's pixels are the same in both frames, whose planes are `[C, H, W]`.
    pub(super) fn sees_the_same(&self, resolution: [usize; 2], a: &[f32], b: &[f32]) -> bool {
        let ([top, left], [rows, columns]) = (self.origin, self.size);
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        let [height, width] = resolution;
        a.len() == b.len()
            && a.chunks_exact(height * width).zip(b.chunks_exact(height * width)).all(|(a, b)| {
                let rows = (top..top + rows).map(|row| row * width + left..row * width + left + columns);
                rows.into_iter().all(|row| same(&a[row.clone()], &b[row]))
            })
    }
}

/// Tiles along an axis of `total` patches for a model of `most`; `partial`: true if they may be shorter.
fn spans(total: usize, most: usize, partial: bool) -> Option<Vec<Span>> {
    if most == 0 || total == 0 || (!partial && total < most) {
        return None;
    }
    // No halos where a tile would keep nothing within them.
    let halo = if most > 2 * HALO { HALO } else { 0 };
    if partial {
        let spans = |count: usize| -> Vec<Span> {
            let edge = |i: usize| i * total / count;
            let span = |i: usize| {
                let kept = edge(i)..edge(i + 1);
                Span { seen: kept.start.saturating_sub(halo)..(kept.end + halo).min(total), kept }
            };
            (0..count).map(span).collect()
        };
        let fits = |spans: &Vec<Span>| spans.iter().all(|span| span.seen.len() <= most);
        return (total.div_ceil(most)..=total).map(spans).find(fits);
    }
    let count = if total == most { 1 } else { (total - 2 * halo).div_ceil(most - 2 * halo) };
    let start = |i: usize| if count == 1 { 0 } else { i * (total - most) / (count - 1) };
    let edge = |i: usize| match i {
        0 => 0,
        i if i == count => total,
        i => (start(i) + start(i - 1) + most) / 2,
    };
    Some((0..count).map(|i| Span { seen: start(i)..start(i) + most, kept: edge(i)..edge(i + 1) }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wanted_patch_is_computed_in_one_tile() {
        let model = crate::stream::ModelSource::Embedded.load(&Default::default()).unwrap();
        let tiles = Tiles::new(&model, [288, 512], None).unwrap();
        let (rows, columns) = (144, 256);
        let of = |part: &Part| match part {
            Part::Nothing => 0,
            Part::Patches(patches) => patches.len(),
            Part::Everything => panic!("every tile has a neighbour"),
        };
        let count = |wanted: Option<&[bool]>| (0..9).map(|at| of(&tiles.tiles[at].part(wanted))).collect::<Vec<_>>();
        assert_eq!(count(None).iter().sum::<usize>(), 36 * 64);
        let mut wanted = vec![false; rows * columns];
        assert_eq!(count(Some(&wanted)), [0; 9]);
        // Two cells of the last patch; and one of the patch to the right of the frame's first.
        (wanted[rows * columns - 1], wanted[(rows - 4) * columns + columns - 4], wanted[3 * columns + 4]) =
            (true, true, true);
        assert_eq!(count(Some(&wanted)), [1, 0, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(tiles.tiles[0].part(Some(&wanted)), Part::Patches(vec![1]));
        let Part::Patches(last) = tiles.tiles[8].part(Some(&wanted)) else { panic!() };
        assert_eq!(last[0] as usize, tiles.tiles[8].grid.unwrap().count - 1);
        assert!(Part::Patches(vec![1, 5]).contains(&Part::Patches(vec![5])));
        assert!(!Part::Patches(vec![1, 5]).contains(&Part::Patches(vec![5, 6])));
        assert!(!Part::Patches(vec![1]).contains(&Part::Everything) && Part::Everything.contains(&Part::Nothing));
    }

    #[test]
    fn tiles_keep_every_patch_once_and_see_what_they_keep() {
        for (most, partial) in [(18, true), (32, true), (18, false), (1, true), (5, false)] {
            for total in 1..200 {
                let Some(spans) = spans(total, most, partial) else {
                    assert!(!partial && total < most);
                    continue;
                };
                let mut at = 0;
                for Span { seen, kept } in &spans {
                    assert_eq!(kept.start, at);
                    assert!(seen.start <= kept.start && kept.end <= seen.end && seen.end <= total, "{total} {spans:?}");
                    assert!(seen.len() <= most && (partial || seen.len() == most));
                    let halo = |far: bool, length: usize| !far || length >= HALO || most <= 2 * HALO;
                    assert!(halo(kept.start > 0, kept.start - seen.start), "{total} {spans:?}");
                    assert!(halo(kept.end < total, seen.end - kept.end), "{total} {spans:?}");
                    at = kept.end;
                }
                assert_eq!(at, total);
                let lengths = spans.iter().map(|span| if partial { span.kept.len() } else { span.seen.len() });
                assert!(lengths.clone().max() <= lengths.min().map(|least| least + 1));
            }
        }
    }
}
