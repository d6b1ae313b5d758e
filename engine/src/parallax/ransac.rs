//! The camera's motion by random samples: a fixed number of draws, the same on every machine.

use glam::DVec3;
use streamsplat_kernels::philox::Stream;

use super::Motion;
use super::epipolar::{cost, refine, rotation};
use super::matches::Match;
use super::triangulate::inverse_depth;

/// Number of draws.
const DRAWS: usize = 48;
/// The same where the motion along a shorter baseline is known, from which the first one starts.
const AGAIN: usize = 12;
/// Matches per sample.
const SAMPLE: usize = 40;
/// Maximum number of matches on which motions are compared.
const JURY: usize = 400;
/// Number of motions that are refined on all matches.
const BEST: usize = 3;
/// Distance within which a match counts in this refinement, relative to the distance within which it fits. Errors of
/// the flow extend over whole regions: with a short parallax, a smaller distance would keep the regions that agree by
/// chance.
const WITHIN: f64 = 2.0;
/// Elements of the random stream that belong to one draw.
const ELEMENTS: u64 = 64;

/// Returns the motion of least cost over the matches. Each draw starts from the rotation that explains all matches best
/// and a random direction, and is refined on a sample.
pub(super) fn motion(
    matches: &[Match],
    fits: f64,
    stream: Stream,
    part: u64,
    shorter: Option<&Motion>,
) -> Option<Motion> {
    let turn = rotation(matches, 4.0 * fits)?;
    let draws = if shorter.is_some() { AGAIN } else { DRAWS };
    let every = matches.len().div_ceil(JURY);
    let jury = || matches.iter().step_by(every);
    let mut drawn: Vec<(f64, Motion)> = (0..draws as u64)
        .filter_map(|draw| {
            let first = (part * DRAWS as u64 + draw) * ELEMENTS;
            let words = stream.words(first);
            let side = |word: u32| f64::from(word) / f64::from(u32::MAX) * 2.0 - 1.0;
            let random = DVec3::new(side(words[0]), side(words[1]), side(words[2]));
            let translation =
                shorter.filter(|_| draw == 0).map_or(random, |motion| motion.translation).try_normalize()?;
            let sample: Vec<&Match> = (1..=SAMPLE as u64)
                .map(|k| &matches[((u64::from(stream.words(first + k)[0]) * matches.len() as u64) >> 32) as usize])
                .collect();
            let start = Motion { rotation: turn, translation, focal: super::FOCAL };
            let rough = refine(start, sample.iter().copied(), 4.0 * fits, 4)?;
            let motion = refine(rough, jury(), 2.0 * fits, 3)?;
            Some((cost(&motion, jury(), fits), motion))
        })
        .collect();
    drawn.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut refined: Vec<(f64, Motion)> = drawn
        .iter()
        .take(BEST)
        .filter_map(|(_, motion)| {
            let motion = refine(*motion, matches.iter(), WITHIN * fits, 8)?;
            Some((cost(&motion, matches.iter(), fits), motion))
        })
        .collect();
    refined.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (_, motion) = refined.first()?;
    Some(before_the_camera(*motion, matches))
}

/// Returns the motion with the sign of its translation that puts most matches in front of the camera.
fn before_the_camera(motion: Motion, matches: &[Match]) -> Motion {
    let sides = matches.iter().fold(0.0, |sum, m| {
        let (inverse, ..) = inverse_depth(&motion, m.one, m.other);
        sum + if inverse > 0.0 { m.weight } else { -m.weight }
    });
    Motion { translation: if sides < 0.0 { -motion.translation } else { motion.translation }, ..motion }
}
