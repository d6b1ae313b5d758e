//! Centres in fixed point: the choice of the number of fractional bits.
//!
//! A centre has 24 bits. More fractional bits make it finer, but reduce the range. For each number of bits, the cost of
//! a Gaussian is 1 if it is clamped to the range. Otherwise it is `min(1, (ε/σ)²)`, where ε is half a step and σ the
//! largest standard deviation: a Gaussian that moves by its own width counts as lost. The number of least total cost is
//! chosen; of equal ones, the one that clamps fewest. So a few stray Gaussians do not reduce the precision of the
//! others, and a wide scene is not clamped. More than 12 bits are used only where these move small Gaussians by a tenth
//! of their width or more, and where nothing is clamped by them.

use crate::formats::notes::Notes;
use crate::still::{Still, middle};

/// Usual number of fractional bits, and the most that readers accept.
const MOST_BITS: u32 = 12;
const FINEST: u32 = 23;
/// Cost per Gaussian above which more than the usual bits are used, where the range allows them.
const COARSE: f64 = 0.01;
/// One above the largest fixed-point number.
const END: f64 = 8_388_608.0;
/// Cost per Gaussian above which an offset is subtracted from the coordinates.
const FAR: f64 = 0.01;

/// A fixed-point format, and the offset subtracted before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fixed {
    pub(super) bits: u32,
    /// Integers subtracted from the centres.
    off: [f64; 3],
}

impl Fixed {
    /// Returns the best format for the Gaussians at `places`.
    pub(super) fn of(still: &Still, places: &[usize]) -> Fixed {
        let (plain, cost) = Fixed::best(still, places, [0.0; 3]);
        if cost <= FAR * places.len() as f64 {
            return plain;
        }
        // Map coordinates are far from zero, but not wide.
        let along = |axis: usize| places.iter().map(|&i| still.mean[i][axis]).collect();
        let Some(off) = middle([along(0), along(1), along(2)]) else { return plain };
        let (near, less) = Fixed::best(still, places, off);
        if less < 0.5 * cost { near } else { plain }
    }

    /// Returns the best format with this offset, and its cost.
    fn best(still: &Still, places: &[usize], off: [f64; 3]) -> (Fixed, f64) {
        let at = |bits| Fixed { bits, off };
        let fits = |bits| places.iter().all(|&i| at(bits).holds(still.mean[i]));
        if fits(MOST_BITS) {
            let enough = |bits: &u32| at(*bits).cost(still, places) <= COARSE * places.len() as f64 || !fits(bits + 1);
            let bits = (MOST_BITS..FINEST).find(enough).unwrap_or(FINEST);
            return (at(bits), at(bits).cost(still, places));
        }
        (0..=MOST_BITS).map(|bits| (at(bits), at(bits).cost(still, places))).fold(
            (at(0), f64::INFINITY),
            // Fewer bits clamp less.
            |best, next| if next.1 < best.1 { next } else { best },
        )
    }

    fn cost(self, still: &Still, places: &[usize]) -> f64 {
        let half = 0.5 / self.scale();
        let one = |&i: &usize| {
            if !self.holds(still.mean[i]) {
                return 1.0;
            }
            let widest = still.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max);
            // Below the format's least scale, the Gaussian is stored with that scale.
            let share = half / streamsplat_kernels::math::f64::exp(f64::from(widest.max(-10.0)));
            (share * share).min(1.0)
        };
        places.iter().map(one).sum()
    }

    fn scale(self) -> f64 {
        f64::from(1_u32 << self.bits)
    }

    fn parts(self, mean: [f32; 3]) -> [f64; 3] {
        std::array::from_fn(|k| ((f64::from(mean[k]) - self.off[k]) * self.scale()).round())
    }

    fn holds(self, mean: [f32; 3]) -> bool {
        self.parts(mean).iter().all(|x| (-END..END).contains(x))
    }

    /// Returns the nine bytes of a centre.
    pub(super) fn bytes(self, mean: [f32; 3]) -> impl Iterator<Item = u8> {
        self.parts(mean).into_iter().flat_map(|x| {
            let [a, b, c, _] = (x.clamp(-END, END - 1.0) as i32).to_le_bytes();
            [a, b, c]
        })
    }

    /// Returns the offset of the coordinates in the file.
    pub(super) fn offset(self, still: &Still) -> [f64; 3] {
        std::array::from_fn(|k| still.about.offset[k] + self.off[k])
    }

    /// Adds notes on moved Gaussians and on positions coarser than usual for the format.
    pub(super) fn notes(self, still: &Still, places: &[usize], notes: &mut Notes) {
        let far = places.iter().filter(|i| !self.holds(still.mean[**i])).count();
        let reach = END / self.scale();
        notes.changed(
            far,
            places.len(),
            &format!("moved to {reach} units, the farthest that keeps the others' precision"),
        );
        if self.bits < MOST_BITS {
            let all = 1_u32 << self.bits;
            notes.0.push(format!("positions to 1/{all} unit, as the scene reaches farther than 2048 units"));
        }
    }
}
