//! A scene with ground truth: a replacement of the network that reconstructs a sprite moving in front of a backdrop.
//!
//! Every pixel of a frame holds the sprite's position as its red value. [`Theatre`] reads it and returns the exact
//! Gaussians and motion, on the same kind of lattice as the network. Nothing is learned and nothing is slow, so long
//! streams can be tested.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use streamsplat::Frame;
use streamsplat::stream::{Motion, Reconstructor, Session};
use streamsplat_model::reuse::Saving;
use streamsplat_model::{Embedding, FrameInput, ModelError, Sampling, Side, StaticGaussian, StaticGaussians};

/// Inverse depth of the backdrop.
pub const BACKDROP: f32 = 0.25;
/// Inverse depth of the sprite.
pub const SPRITE: f32 = 0.75;
/// Half the sprite's width and height.
pub const HALF: [f32; 2] = [0.3, 0.4];

/// Reconstructs the scene of [`Theatre::frame`].
#[derive(Debug)]
pub struct Theatre {
    /// Rows and columns of Gaussians.
    pub lattice: [usize; 2],
    /// γ of every Gaussian.
    pub gamma: [f32; 2],
    /// Sets this cell to NaN in its position (0), its velocity (1) or its γ (2).
    pub poison: Option<(usize, usize)>,
    /// True if positions are drawn: moved by a function of the sampling coordinates.
    pub draws: bool,
    /// Calls of `embed`, `gaussians` and `decode`.
    pub calls: [AtomicU64; 3],
}

impl Theatre {
    /// A stage of this many Gaussians.
    pub fn new(lattice: [usize; 2]) -> Self {
        Self { lattice, gamma: [3.0, 0.4], poison: None, draws: false, calls: Default::default() }
    }

    /// The frame in which the sprite's centre is at `x` in [−1, 1].
    pub fn frame(&self, x: f32) -> Frame {
        let [rows, columns] = self.lattice;
        let (height, width) = (2 * rows, 2 * columns);
        let mut rgb = vec![0.5 * (x + 1.0); height * width];
        rgb.resize(3 * height * width, 0.25);
        Frame { width, height, rgb, depth: None }
    }

    /// The sprite's centre in a frame passed to the network.
    fn sprite(code: f32) -> f32 {
        2.0 * code - 1.0
    }

    /// Returns true if the sprite at `sprite` covers a position of the image.
    pub fn covers(sprite: f32, [x, z]: [f32; 2]) -> bool {
        (x - sprite).abs() <= HALF[0] && z.abs() <= HALF[1]
    }

    /// Centre of a cell.
    pub fn cell(&self, cell: usize) -> [f32; 2] {
        let [rows, columns] = self.lattice;
        let (row, column) = (cell / columns, cell % columns);
        let x = (2.0 * column as f32 + 1.0) / columns as f32 - 1.0;
        let z = 1.0 - (2.0 * row as f32 + 1.0) / rows as f32;
        [x, z]
    }

    fn moves(&self, own: f32, moved: f32) -> Motion {
        let cells = self.lattice[0] * self.lattice[1];
        let mut velocity: Vec<[f32; 3]> = (0..cells)
            .map(|cell| if Self::covers(own, self.cell(cell)) { [moved, 0.0, 0.0] } else { [0.0; 3] })
            .collect();
        let mut gamma = vec![self.gamma; cells];
        match self.poison {
            Some((cell, 1)) => velocity[cell][2] = f32::NAN,
            Some((cell, 2)) => gamma[cell][0] = f32::INFINITY,
            _ => {}
        }
        (velocity, gamma)
    }
}

impl Reconstructor for Theatre {
    fn resolution(&self) -> [usize; 2] {
        self.lattice.map(|side| 2 * side)
    }

    fn session(self: Arc<Self>, _: Option<Saving>) -> Box<dyn Session> {
        Box::new(Performance(self))
    }
}

/// A session of a [`Theatre`].
struct Performance(Arc<Theatre>);

impl Session for Performance {
    fn embed(&mut self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        self.0.calls[0].fetch_add(1, Relaxed);
        Ok(Embedding { h: vec![frame.rgb[0]] })
    }

    fn upsample(&mut self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        Ok(embedding.h.clone())
    }

    fn gaussians(&mut self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.0.calls[1].fetch_add(1, Relaxed);
        let sprite = Theatre::sprite(tokens[0]);
        let shift = match *sampling {
            Sampling::Sample { seed, frame } if self.0.draws => ((seed + frame) % 7) as f32 * 1e-3,
            _ => 0.0,
        };
        let mut g = StaticGaussians::default();
        for cell in 0..self.0.lattice[0] * self.0.lattice[1] {
            let [x, z] = self.0.cell(cell);
            let (depth, colour) = if Theatre::covers(sprite, [x, z]) {
                let (u, v) = ((x - sprite) / HALF[0], z / HALF[1]);
                (SPRITE, [0.9, 0.5 + 0.4 * u, 0.5 + 0.4 * v])
            } else {
                (BACKDROP, [0.1, 0.5 + 0.3 * x, 0.5 - 0.3 * z])
            };
            let bad = self.0.poison == Some((cell, 0));
            let [height, width] = self.0.lattice.map(|side| 0.7 / side as f32);
            g.push(StaticGaussian {
                position: [x + shift, depth, if bad { f32::NAN } else { z }],
                scale: [width, height],
                opacity: 0.95,
                rgb: colour,
                ..StaticGaussian::default()
            });
        }
        Ok(g)
    }

    fn draws_positions(&self) -> bool {
        self.0.draws
    }

    fn reads_condition(&self) -> bool {
        false
    }

    fn condition(&mut self, _: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        Ok(None)
    }

    fn decode(&mut self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        self.0.calls[2].fetch_add(1, Relaxed);
        let (start, end) = (Theatre::sprite(a.h[0]), Theatre::sprite(b.h[0]));
        Ok([vec![start, end - start], vec![end, end - start]])
    }

    fn upsample_motion(&mut self, _: usize, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        Ok(d.to_vec())
    }

    fn motion(&mut self, _: usize, _: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        Ok(self.0.moves(motion_tokens[0], motion_tokens[1]))
    }
}
