//! Conversion of a frame to a depth network's input, and of the output to a map of the frame's size.

use streamsplat_kernels::Level;
use streamsplat_kernels::resize::{self, Filter, Grid};

use super::{NetworkOptions, NetworkSize};

/// Maximum number of pixels of a network's input.
const MOST_PIXELS: usize = 1 << 23;

/// Returns true if an input of `[height, width]` is within the limit; checked before memory is allocated.
pub(super) fn is_allowed([height, width]: [usize; 2]) -> bool {
    height > 0 && width > 0 && height.checked_mul(width).is_some_and(|pixels| pixels <= MOST_PIXELS)
}

/// Returns height and width of the input for a frame of `[height, width]`.
///
/// Axes that the network fixes are kept; if both are fixed, the frame is stretched. An open axis keeps the frame's
/// aspect ratio: with the other axis if that is fixed, else with the requested shorter side. It is rounded to the
/// nearest multiple, at least one. An exact requested size replaces both open axes.
pub(super) fn input_size(frame: [usize; 2], axes: [Option<usize>; 2], options: &NetworkOptions) -> [usize; 2] {
    let multiple = options.multiple as u128;
    // length · numerator / denominator, rounded to the nearest multiple.
    let rounded = |length: usize, numerator: usize, denominator: usize| {
        let (numerator, denominator) = (length as u128 * numerator as u128, denominator as u128 * multiple);
        let whole = ((2 * numerator + denominator) / (2 * denominator)).max(1) * multiple;
        usize::try_from(whole).unwrap_or(usize::MAX)
    };
    match (axes, options.size) {
        ([Some(height), Some(width)], _) => [height, width],
        ([height, width], NetworkSize::Exact(size)) => [height.unwrap_or(size[0]), width.unwrap_or(size[1])],
        ([Some(height), None], _) => [height, rounded(frame[1], height, frame[0])],
        ([None, Some(width)], _) => [rounded(frame[0], width, frame[1]), width],
        ([None, None], NetworkSize::Shorter(side)) => {
            let shorter = frame[0].min(frame[1]);
            frame.map(|length| rounded(length, side, shorter))
        }
    }
}

/// Converts the planes of a `[height, width]` frame, clamped to [0, 1], to the network's input `[3, height, width]` of
/// size `to`.
///
/// The frame is resized with the antialiased cubic (Keys, −½), clamped again, and mapped by `(x − mean) / std` for each
/// channel: a difference and a quotient, each rounded once.
///
/// # Panics
/// If `rgb` does not hold three planes of the frame's size, or a side is zero.
pub(super) fn image(
    level: Level,
    rgb: &[f32],
    frame: [usize; 2],
    to: [usize; 2],
    options: &NetworkOptions,
) -> Vec<f32> {
    let mut input = vec![0.0; 3 * to[0] * to[1]];
    let grid = Grid { outer: 3, height: frame[0], width: frame[1], inner: 1 };
    let rgb: Vec<f32> = rgb.iter().map(|x| x.clamp(0.0, 1.0)).collect();
    resize::antialiased(level, Filter::Cubic, &rgb, grid, to[0], to[1], &mut input);
    let channels = options.mean.iter().zip(&options.std);
    for (plane, (mean, std)) in input.chunks_exact_mut(to[0] * to[1]).zip(channels) {
        plane.iter_mut().for_each(|x| *x = (x.clamp(0.0, 1.0) - mean) / std);
    }
    input
}

/// Resizes the network's output of size `from` to inverse depth of the frame's size, bilinearly (half-pixel centres).
///
/// Depth is inverted before it is resized. Values not above 0 have no inverse: they become NaN, which the engine counts
/// and treats as farthest.
///
/// # Panics
/// If `answer` does not hold a plane of that size, or a side is zero.
pub(super) fn map(level: Level, mut answer: Vec<f32>, from: [usize; 2], frame: [usize; 2], metric: bool) -> Vec<f32> {
    if metric {
        answer.iter_mut().for_each(|d| *d = if *d > 0.0 { 1.0 / *d } else { f32::NAN });
    }
    if from == frame {
        return answer;
    }
    let mut out = vec![0.0; frame[0] * frame[1]];
    resize::bilinear(level, &answer, 1, from[0], from[1], frame[0], frame[1], &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Workers;

    fn options(text: &str) -> NetworkOptions {
        text.parse().expect("valid options")
    }

    #[test]
    fn open_axes_keep_the_shape_of_the_frame_in_multiples() {
        let open = [None, None];
        let default = NetworkOptions::default();
        assert_eq!(input_size([1080, 1920], open, &default), [518, 924]);
        assert_eq!(input_size([1920, 1080], open, &default), [924, 518]);
        assert_eq!(input_size([7, 7], open, &default), [518, 518]);
        assert_eq!(input_size([288, 512], open, &options("size=100,multiple=32")), [96, 192]);
        assert_eq!(input_size([10, 1000], open, &options("size=4")), [14, 406]);
        assert_eq!(input_size([288, 512], open, &options("size=300x200")), [200, 300]);
    }

    #[test]
    fn fixed_axes_are_what_they_are() {
        let default = NetworkOptions::default();
        assert_eq!(input_size([1080, 1920], [Some(518), Some(518)], &default), [518, 518]);
        assert_eq!(input_size([1080, 1920], [Some(252), None], &default), [252, 448]);
        assert_eq!(input_size([1080, 1920], [None, Some(448)], &default), [252, 448]);
    }

    #[test]
    fn sizes_too_large_are_refused_and_do_not_overflow() {
        let size = input_size([1, usize::MAX], [None, None], &NetworkOptions::default());
        assert!(!is_allowed(size) && !is_allowed([0, 14]) && is_allowed([518, 924]));
    }

    #[test]
    fn a_constant_frame_becomes_a_constant_input() {
        let rgb: Vec<f32> = [0.25, 0.5, 2.0].iter().flat_map(|&v| [v; 12]).collect();
        let input = image(Level::detect(), &rgb, [3, 4], [14, 28], &options("mean=0.25/0/0.5,std=1/2/0.25"));
        for (plane, expected) in input.chunks_exact(14 * 28).zip([0.0, 0.25, 2.0]) {
            // The weights of an output add up to 1 up to rounding.
            assert!(plane.iter().all(|v| (v - expected).abs() < 1e-6), "{expected}: {plane:?}");
        }
    }

    #[test]
    fn depth_is_inverted_and_what_has_no_inverse_is_marked() {
        let level = Level::detect();
        let inverse = map(level, vec![2.0, 0.0, -1.0, 0.5], [2, 2], [2, 2], true);
        assert_eq!((inverse[0], inverse[3]), (0.5, 2.0));
        assert!(inverse[1].is_nan() && inverse[2].is_nan());
        assert_eq!(map(level, vec![2.0, 4.0], [1, 2], [1, 4], false), [2.0, 2.5, 3.5, 4.0]);
    }

    #[test]
    fn the_bits_depend_on_neither_level_nor_threads() {
        let rgb: Vec<f32> = (0..3 * 45 * 61).map(|i| ((i * 37 + i / 7) % 256) as f32 / 255.0).collect();
        let depth: Vec<f32> = (0..28 * 42).map(|i| ((i * 29) % 101) as f32 / 7.0).collect();
        let options = NetworkOptions::default();
        let all = |level: Level, threads: usize| {
            Workers::new(level, threads).expect("threads").install(|| {
                let input = image(level, &rgb, [45, 61], [84, 112], &options);
                let map = map(level, depth.clone(), [28, 42], [45, 61], true);
                input.iter().chain(&map).map(|v| v.to_bits()).collect::<Vec<_>>()
            })
        };
        let expected = all(Level::detect(), 1);
        for level in Level::available() {
            for threads in [1, 2, 3, 8] {
                assert!(all(level, threads) == expected, "{} with {threads} threads", level.name());
            }
        }
    }
}
