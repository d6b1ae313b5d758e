//! Spatial queries: which Gaussians a ray may touch, which are in a camera's frustum, whose footprint contains a point.
//!
//! A [`Tree`] holds axis-aligned boxes in a bounding volume hierarchy (`obvhs`). The hierarchy only proposes
//! candidates; each box is tested in binary64. So every result equals that of testing all boxes, in ascending order,
//! for any shape of the hierarchy.
//!
//! [`Picker`] uses it for the most visible Gaussian along rays. *Matching of frames* ([`crate::stream`]) does not,
//! because bins on the frame's lattice find the same pairs faster.
//!
//! # Images of a part of a scene
//!
//! A frustum does not bound the content of an image: the affine footprint of a Gaussian outside a pinhole's frustum can
//! reach into the image. `Window` therefore bounds the rasteriser's footprints, of one Gaussian or of a box of centres.
//! Gaussians outside the image are left out before they are projected, if they are at least half of the scene. The
//! image keeps its bits; [`Renderer::left_out`](crate::render::Renderer::left_out) counts them.
//!
//! This is used for still scenes ([`Drawable::grouped`](crate::still::Drawable::grouped)), because a camera path shows
//! many images of one scene: their Gaussians are tested in groups of 64 neighbours along a Z-order curve. It is not
//! used for intervals, of which each shows only a few images. Grouping an interval's Gaussians once for all of its
//! times takes longer than two images. Testing every Gaussian at the image's time takes as long as projecting it.
//!
//! `streamsplat bench raster --only part` measures images, groups, and a hierarchy over the Gaussians, which takes
//! about three times as long to build as the groups.

mod groups;
mod pick;
#[cfg(test)]
mod tests;
mod window;

pub(crate) use groups::{Groups, along_curve};
pub use pick::{Hit, Picker, Ray, most_visible};
pub(crate) use window::Window;

use std::time::Duration;

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;

use crate::stream::Snapshot;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least corner.
    pub least: [f32; 3],
    /// Greatest corner.
    pub greatest: [f32; 3],
}

/// The half space `normal · p + offset ≥ 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Normal of any length.
    pub normal: [f32; 3],
    /// Distance of the origin, in lengths of the normal.
    pub offset: f32,
}

impl Bounds {
    /// Returns the box in which an unrotated Gaussian's α can reach 1/255: `|p − mean| ≤ √(2·ln(255·opacity))·scale`
    /// along each axis. `None` if α never reaches it, or if a number is not finite.
    pub fn of_gaussian(mean: [f32; 3], scale: [f32; 3], opacity: f32) -> Option<Self> {
        let reach = reach(opacity)?;
        let half: [f64; 3] = std::array::from_fn(|i| reach * f64::from(scale[i]).abs());
        let bounds = Self {
            least: std::array::from_fn(|i| (f64::from(mean[i]) - half[i]) as f32),
            greatest: std::array::from_fn(|i| (f64::from(mean[i]) + half[i]) as f32),
        };
        bounds.is_sound().then_some(bounds)
    }

    /// Returns true if all corners are finite and in order.
    pub fn is_sound(&self) -> bool {
        (0..3).all(|i| self.least[i].is_finite() && self.greatest[i].is_finite() && self.least[i] <= self.greatest[i])
    }

    /// Returns true if the ray from `origin` along `direction` meets the box, whose surface belongs to it.
    pub fn meets_ray(&self, origin: [f32; 3], direction: [f32; 3]) -> bool {
        let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
        for i in 0..3 {
            let (o, d) = (f64::from(origin[i]), f64::from(direction[i]));
            let (from, to) = (f64::from(self.least[i]) - o, f64::from(self.greatest[i]) - o);
            if d == 0.0 {
                if from > 0.0 || to < 0.0 {
                    return false;
                }
                continue;
            }
            let (a, b) = (from / d, to / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        enter <= leave
    }

    /// Returns true if the boxes have a point in common.
    pub fn overlaps(&self, other: &Bounds) -> bool {
        (0..3).all(|i| self.least[i] <= other.greatest[i] && other.least[i] <= self.greatest[i])
    }

    /// Returns true if some corner is in the half space.
    pub fn reaches(&self, side: &HalfSpace) -> bool {
        let far = |i: usize| if side.normal[i] > 0.0 { self.greatest[i] } else { self.least[i] };
        let sum: f64 = (0..3).map(|i| f64::from(side.normal[i]) * f64::from(far(i))).sum();
        sum + f64::from(side.offset) >= 0.0
    }
}

/// Returns the number of standard deviations from the centre at which α falls to 1/255; `None` if α never reaches it.
fn reach(opacity: f32) -> Option<f64> {
    let ratio = 255.0 * f64::from(opacity);
    (ratio.is_finite() && ratio >= 1.0).then(|| (2.0 * streamsplat_kernels::math::f64::ln(ratio)).sqrt())
}

/// Boxes in a hierarchy for queries.
pub struct Tree {
    hierarchy: Bvh2,
    boxes: Vec<Bounds>,
    /// The caller's number of each box.
    numbers: Vec<u32>,
}

impl Tree {
    /// Builds a tree of numbered boxes. Boxes that are not sound are left out.
    pub fn new(boxes: impl IntoIterator<Item = (u32, Bounds)>) -> Self {
        let (numbers, boxes): (Vec<u32>, Vec<Bounds>) = boxes.into_iter().filter(|(_, b)| b.is_sound()).unzip();
        let corners: Vec<Aabb> = boxes.iter().map(corners).collect();
        let hierarchy = build_bvh2(&corners, BvhBuildParams::fast_build(), &mut Duration::default());
        Self { hierarchy, boxes, numbers }
    }

    /// Builds a tree of the footprints of a snapshot's Gaussians, numbered by their index in the snapshot.
    pub fn of(snapshot: &Snapshot) -> Self {
        Self::new((0..snapshot.mean.len()).filter_map(|i| {
            let bounds = Bounds::of_gaussian(snapshot.mean[i], snapshot.scale[i], snapshot.opacity[i])?;
            Some((i as u32, bounds))
        }))
    }

    /// Returns the number of boxes.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// Returns the boxes that the ray from `origin` along `direction` meets, ascending; none if a number is not finite
    /// or the direction is zero.
    pub fn along_ray(&self, origin: [f32; 3], direction: [f32; 3]) -> Vec<u32> {
        let finite = origin.iter().chain(&direction).all(|v| v.is_finite());
        if !finite || direction == [0.0; 3] {
            return Vec::new();
        }
        self.search(|bounds| bounds.meets_ray(origin, direction))
    }

    /// Returns the boxes that have a point in common with `bounds`, ascending.
    pub fn overlapping(&self, bounds: &Bounds) -> Vec<u32> {
        self.search(|other| other.overlaps(bounds))
    }

    /// Returns the boxes that reach into every half space, ascending. They include all boxes that meet the intersection
    /// of the half spaces, such as a camera's frustum.
    pub fn inside(&self, sides: &[HalfSpace]) -> Vec<u32> {
        self.search(|bounds| sides.iter().all(|side| bounds.reaches(side)))
    }

    /// Returns the Gaussian of `snapshot` (from which this tree was built) whose footprint contains `point` and whose
    /// centre is nearest, in standard deviations; the lowest index among equals.
    pub fn nearest_footprint(&self, snapshot: &Snapshot, point: [f32; 3]) -> Option<u32> {
        let mut best: Option<(f64, u32)> = None;
        for place in self.overlapping(&Bounds { least: point, greatest: point }) {
            let i = place as usize;
            let distance: f64 = (0..3)
                .map(|axis| {
                    let d = f64::from(point[axis]) - f64::from(snapshot.mean[i][axis]);
                    // A flat Gaussian has no extent: only its own plane is near.
                    if d == 0.0 { 0.0 } else { (d / f64::from(snapshot.scale[i][axis])).powi(2) }
                })
                .sum();
            let within = reach(snapshot.opacity[i]).is_some_and(|r| distance <= r * r);
            if within && best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, place));
            }
        }
        best.map(|(_, place)| place)
    }

    /// Returns the numbers of the boxes with `wanted` true, ascending. If `wanted` is true of a box, it must be true of
    /// every enclosing box.
    fn search(&self, wanted: impl Fn(&Bounds) -> bool) -> Vec<u32> {
        let mut found = Vec::new();
        let nodes = &self.hierarchy.nodes;
        let mut open: Vec<u32> = if nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(at) = open.pop() {
            let node = &nodes[at as usize];
            let aabb = node.aabb();
            if !wanted(&Bounds { least: aabb.min.to_array(), greatest: aabb.max.to_array() }) {
                continue;
            }
            if !node.is_leaf() {
                open.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            for slot in node.first_index..node.first_index + node.prim_count {
                let place = self.hierarchy.primitive_indices[slot as usize] as usize;
                if wanted(&self.boxes[place]) {
                    found.push(self.numbers[place]);
                }
            }
        }
        found.sort_unstable();
        found
    }
}

/// Converts a box to the hierarchy's type. Unions take corners unchanged, without rounding.
fn corners(bounds: &Bounds) -> Aabb {
    Aabb::new(Vec3A::from_array(bounds.least), Vec3A::from_array(bounds.greatest))
}
