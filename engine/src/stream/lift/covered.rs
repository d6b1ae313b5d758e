//! Colours of surfaces that earlier frames saw and that are now covered.
//!
//! A moving object, or a moving camera, covers surfaces that were in sight at the key frame before. Each
//! [cell](super::beyond) in front of an edge looks up the surface behind it there: its place is moved along the flow
//! back, as the surface beyond the edge moves. There the picture shows that surface at its depth, or the surface was
//! covered already and is remembered from earlier, or it was never seen.
//!
//! Memory is bounded by the picture: a cell remembers one colour. Surfaces more than a [reach](super::beyond) from all
//! edges, and those that come into sight, are forgotten.

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::flow::{self, Step};

use super::DepthMap;
use super::beyond::{Beyond, CELL, grid, middle};
use super::edges::Surfaces;
use crate::world::scene_depth;

/// The colour of a surface where something is in front of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Covered {
    /// Cell of the picture, row by row.
    pub cell: u32,
    /// Its place in pixels, along each axis at most a cell's side from the middle of the cell.
    pub at: [f32; 2],
    /// Its colour.
    pub rgb: [f32; 3],
}

/// The key frame before, and the way back to it.
pub(in crate::stream) struct Past<'a> {
    pub(in crate::stream) level: Level,
    pub(in crate::stream) map: &'a DepthMap,
    /// `[3, H, W]`
    pub(in crate::stream) rgb: &'a [f32],
    pub(in crate::stream) covered: &'a [Covered],
    /// Flow from this key frame to that one.
    pub(in crate::stream) back: Vec<Step<'a>>,
}

/// A key frame's memory of the surfaces that it hides.
pub(in crate::stream) enum Memory<'a> {
    /// Nothing: there is no frame before.
    None,
    /// To be taken from the frame before.
    Past(Past<'a>),
    /// Known already.
    Known(&'a [Covered]),
}

/// Returns why these cannot be remembered at a frame of this size.
pub(in crate::stream) fn contradiction(covered: &[Covered], resolution: [usize; 2]) -> Option<String> {
    let cells = grid(resolution).iter().product::<usize>();
    let ascending = covered.windows(2).all(|pair| pair[0].cell < pair[1].cell);
    if !(ascending && covered.last().is_none_or(|last| (last.cell as usize) < cells)) {
        return Some(format!("expected covered places in ascending cells under {cells}"));
    }
    let sound = |c: &Covered| c.at.iter().chain(&c.rgb).all(|x| x.is_finite());
    covered.iter().find(|c| !sound(c)).map(|c| format!("expected covered places with finite numbers, found {c:?}"))
}

impl Memory<'_> {
    /// Covered places of the cells that have a surface `beyond` them, ascending in cells.
    pub(super) fn recall(&self, surfaces: &Surfaces<'_>, beyond: &[Option<Beyond>]) -> Vec<Covered> {
        match self {
            Memory::None => Vec::new(),
            Memory::Known(covered) => covered.to_vec(),
            Memory::Past(past) => past.recall(surfaces, beyond),
        }
    }
}

impl Past<'_> {
    fn recall(&self, surfaces: &Surfaces<'_>, beyond: &[Option<Beyond>]) -> Vec<Covered> {
        let resolution @ [height, width] = surfaces.resolution();
        if self.map.resolution != resolution {
            return Vec::new();
        }
        let [rows, columns] = grid(resolution);
        // One more than its index in the list.
        let mut before = vec![0u32; rows * columns];
        for (place, covered) in (1..).zip(self.covered) {
            before[covered.cell as usize] = place;
        }
        let asked: Vec<(usize, &Beyond)> =
            beyond.iter().enumerate().filter_map(|(cell, beyond)| Some((cell, beyond.as_ref()?))).collect();
        let start = |away: usize| [(away % width) as f32, (away / width) as f32];
        let starts: Vec<[f32; 2]> = asked.iter().map(|(_, beyond)| start(beyond.away)).collect();
        let mut ends = vec![[f32::NAN; 2]; starts.len()];
        flow::trace(self.level, &starts, &self.back, &mut ends);
        let inside = |[x, y]: [f32; 2]| {
            let inside = (-0.5..width as f32 - 0.5).contains(&x) && (-0.5..height as f32 - 0.5).contains(&y);
            inside.then_some([(x + 0.5).floor() as usize, (y + 0.5).floor() as usize])
        };
        let recalled = |((&(cell, beyond), start), end): ((&(usize, &Beyond), &[f32; 2]), &[f32; 2])| {
            let moved = [end[0] - start[0], end[1] - start[1]];
            let at = middle(beyond.own);
            let then = [at[0] + moved[0], at[1] + moved[1]];
            let [x, y] = inside(then)?;
            let cell = cell as u32;
            if let Some(rgb) = self.seen([x, y], then, beyond.farther, surfaces.tear()) {
                return Some(Covered { cell, at, rgb });
            }
            let place = before[y / CELL * columns + x / CELL].checked_sub(1)?;
            let Covered { at, rgb, .. } = self.covered[place as usize];
            let at = [at[0] - moved[0], at[1] - moved[1]];
            let near = |axis: usize| (at[axis] - middle(beyond.own)[axis]).abs() <= CELL as f32;
            (near(0) && near(1)).then_some(Covered { cell, at, rgb })
        };
        asked.par_iter().with_min_len(256).zip(&starts).zip(&ends).filter_map(recalled).collect()
    }

    /// The colour at a place of the frame before, in this pixel, where all pixels around it have depth z.
    fn seen(&self, [column, row]: [usize; 2], [x, y]: [f32; 2], z: f32, tear: f32) -> Option<[f32; 3]> {
        let [height, width] = self.map.resolution;
        let around = |at: usize, side: usize| at.saturating_sub(1)..(at + 2).min(side);
        for y in around(row, height) {
            for x in around(column, width) {
                if (scene_depth(self.map.inverse[y * width + x]) - z).abs() > tear {
                    return None;
                }
            }
        }
        let plane = |channel: usize| &self.rgb[channel * height * width..][..height * width];
        Some(std::array::from_fn(|channel| flow::sample_one(plane(channel), [height, width], x, y)))
    }
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::flow::Field;

    use super::*;

    const SIZE: [usize; 2] = [8, 64];

    /// A thing from column `near` on, 24 wide, in front of a ground whose red encodes the place, moved by `ground`
    /// pixels.
    fn picture(near: usize, ground: f32) -> (DepthMap, Vec<f32>) {
        let plane = |of: &dyn Fn(usize) -> f32| -> Vec<f32> { (0..8 * 64).map(|at| of(at % 64)).collect() };
        let thing = |x: usize| (near..near + 24).contains(&x);
        let inverse = plane(&|x| f32::from(u8::from(thing(x))));
        let red = plane(&|x| if thing(x) { 0.0 } else { (x as f32 - ground) / 128.0 });
        (
            DepthMap { inverse: inverse.clone(), confidence: None, resolution: SIZE },
            [red, inverse.clone(), inverse].concat(),
        )
    }

    /// Flow that moves everything alike.
    fn flow(u: f32) -> Field {
        Field { u: vec![u; 8 * 64], ..Field::zero(SIZE) }
    }

    fn recall(before: (&DepthMap, &[f32], &[Covered]), now: (&DepthMap, &[f32]), ground: f32) -> Vec<Covered> {
        let (back, forth) = (flow(-ground), flow(ground));
        let back = vec![Step { there: &back, back: &forth, distance: 1.0 }];
        let (map, rgb, covered) = before;
        let past = Past { level: Level::scalar(), map, rgb, covered, back };
        let surfaces = Surfaces::new(Level::scalar(), now.0, now.1);
        Memory::Past(past).recall(&surfaces, &surfaces.beyond())
    }

    #[test]
    fn what_a_thing_covers_keeps_its_colour_while_it_is_covered() {
        // The thing goes to the left by four pixels a key frame, the ground to the right by a half.
        let all: Vec<_> = (0..4).map(|k| picture(28 - 4 * k, 0.5 * k as f32)).collect();
        let mut covered = Vec::new();
        for key in 1..4 {
            let ((map, rgb), (now, seen)) = (&all[key - 1], &all[key]);
            covered = recall((map, rgb, &covered), (now, seen), 0.5);
            let mut columns = Vec::new();
            for Covered { cell, at, rgb } in covered.iter().filter(|covered| covered.cell < 32) {
                let x = at[0];
                columns.push(*cell as usize * 2);
                assert!((x - (2 * cell) as f32).abs() <= CELL as f32, "{x} in cell {cell}");
                let truth = (x - 0.5 * key as f32) / 128.0;
                assert!((rgb[0] - truth).abs() < 1e-4 && rgb[1] == 0.0, "{x}: {rgb:?}, not {truth}");
            }
            // From its left edge to the farthest column it has covered; the pixels next to its first edge have mixed
            // colours.
            let first = 28 - 4 * key;
            assert!(columns.first().is_some_and(|x| x.abs_diff(first) <= 1), "{key}: {columns:?}");
            assert!(columns.last().is_some_and(|x| (20..28).contains(x)), "{key}: {columns:?}");
            assert!(columns.windows(2).all(|pair| pair[1] == pair[0] + 2), "without gaps: {columns:?}");
        }
        assert!(contradiction(&covered, SIZE).is_none());
    }

    #[test]
    fn nothing_is_remembered_of_what_was_never_seen_or_lies_at_another_depth() {
        let (map, rgb) = picture(20, 0.0);
        assert!(recall((&map, &rgb, &[]), (&map, &rgb), 0.0).is_empty(), "covered from the start");
        let wall = DepthMap { inverse: vec![0.5; 8 * 64], ..map.clone() };
        assert!(recall((&wall, &rgb, &[]), (&map, &rgb), 0.0).is_empty(), "something else was there");
        let other = DepthMap { inverse: vec![0.0; 4], confidence: None, resolution: [2, 2] };
        assert!(recall((&other, &rgb, &[]), (&map, &rgb), 0.0).is_empty(), "of another size");
    }

    #[test]
    fn what_cannot_be_remembered_is_named() {
        let some = |cell: u32| Covered { cell, at: [0.0; 2], rgb: [0.0; 3] };
        let broken = Covered { rgb: [0.0, f32::NAN, 0.0], ..some(5) };
        for (wrong, named) in
            [(vec![some(4), some(4)], "ascending"), (vec![some(4 * 32)], "under 128"), (vec![broken], "finite")]
        {
            assert!(contradiction(&wrong, SIZE).is_some_and(|reason| reason.contains(named)), "{named}");
        }
    }
}
