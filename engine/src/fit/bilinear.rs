//! Bilinear resizing of planes.

use streamsplat_kernels::Level;
use streamsplat_kernels::parallel::for_each_chunk;

/// Resizes `[c, h, w]` planes to `[c, h', w']`: half-pixel centres, coordinates clamped to the frame, weights in f32,
/// first along x then along y, `a + (b − a)·w`. The same on every level.
pub(super) fn resize(_level: Level, from: &[f32], [h, w]: [usize; 2], [rows, columns]: [usize; 2], to: &mut [f32]) {
    let taps = |out: usize, source: usize| -> Vec<(usize, usize, f32)> {
        let scale = source as f64 / out as f64;
        let tap = |i: usize| {
            let x = ((i as f64 + 0.5) * scale - 0.5).clamp(0.0, (source - 1) as f64);
            let low = x as usize;
            (low, (low + 1).min(source - 1), (x - low as f64) as f32)
        };
        (0..out).map(tap).collect()
    };
    let (across, down) = (taps(columns, w), taps(rows, h));
    for_each_chunk(to, columns, |row, out| {
        let (channel, (top, bottom, v)) = (row / rows, down[row % rows]);
        let plane = &from[channel * h * w..(channel + 1) * h * w];
        let (top, bottom) = (&plane[top * w..(top + 1) * w], &plane[bottom * w..(bottom + 1) * w]);
        for (out, &(left, right, u)) in out.iter_mut().zip(&across) {
            let upper = top[left] + (top[right] - top[left]) * u;
            let lower = bottom[left] + (bottom[right] - bottom[left]) * u;
            *out = upper + (lower - upper) * v;
        }
    });
}
