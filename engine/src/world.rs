//! Depth in the world and in the scene.
//!
//! World positions are x right, y inverse depth, z up. The scene is x right, y down, z forward, with
//!
//! ```text
//! z = 1 / (9.8·y + 0.2 + 10⁻⁶)   for normalised inverse depths y in [0, 1]; other Gaussians are not drawn
//! ```
//!
//! (StreamSplat (ICLR 2026), camera and image). A depth map has values from 0, farthest, to 1, nearest: y from [`FAR`]
//! to [`NEAR`], so that Gaussians around them stay in [0, 1].

/// y of a map's farthest value.
pub const FAR: f32 = 0.1;
/// y of a map's nearest value.
pub const NEAR: f32 = 0.95;

/// The scene-space place of a world position; `None` outside 0 ≤ y ≤ 1.
pub fn to_scene([x, y, z]: [f32; 3]) -> Option<[f32; 3]> {
    (0.0..=1.0).contains(&y).then(|| [x, -z, 1.0 / (9.8 * y + 0.2 + 1e-6)])
}

/// z in the scene of a map's value.
pub(crate) fn scene_depth(d: f32) -> f32 {
    let y = (NEAR - FAR).mul_add(d.clamp(0.0, 1.0), FAR);
    1.0 / 9.8f32.mul_add(y, 0.2)
}

/// The map's value for a z in the scene.
pub(crate) fn map_value(z: f32) -> f32 {
    (y_of(z) - FAR) / (NEAR - FAR)
}

/// y of a z in the scene.
fn y_of(z: f32) -> f32 {
    (1.0 / z - 0.2) / 9.8
}

/// The same clamped to [0, 1].
pub(crate) fn y_at(z: f32) -> f32 {
    y_of(z).clamp(0.0, 1.0)
}
