//! The same network for smaller frames, on part of its patch grid.
//!
//! A token's place enters the network only through position tables. With the tables' rows for the grid's upper left
//! `rows × columns` places, the same weights take frames of that many patches. A token's neighbours are then as far
//! from it, in the tables, as in training. Scales and velocities, which are fractions of a frame's sides, grow by the
//! ratio of the sides. This needs attention over every token of the frame, or over none: windows are runs of tokens of
//! a whole grid, and are undefined in a part of it.

use crate::Network;
use crate::layers::Workspaces;

impl Network {
    /// Returns true if [`Network::on_grid`] takes every grid that is not larger than this network's: neither encoder
    /// and decoder nor the upsamplers mix tokens within windows.
    pub fn takes_part_of_its_grid(&self) -> bool {
        self.config.encoder_window.is_none() && self.upsamplers_are_local
    }

    /// Returns this network for frames of `grid` patches (rows, columns), sharing its weights. `None` when a side is
    /// zero or larger than this network's, or when only the whole grid is possible
    /// ([`Network::takes_part_of_its_grid`]).
    pub fn on_grid(&self, grid: [usize; 2]) -> Option<Network> {
        let [whole_rows, whole_columns] = self.config.grid();
        let [rows, columns] = grid;
        let inside = (1..=whole_rows).contains(&rows) && (1..=whole_columns).contains(&columns);
        if !inside || !(grid == self.config.grid() || self.takes_part_of_its_grid()) {
            return None;
        }
        let mut config = self.config.clone();
        config.resolution = grid.map(|side| side * config.patch_size);
        // Only branches that add nothing still have windows; these must divide the tokens.
        config.upsampler_window = gcd(config.upsampler_window, 4 * rows * columns);
        let places: Vec<usize> =
            (0..rows).flat_map(|row| (0..columns).map(move |column| row * whole_columns + column)).collect();
        let mut encoder = self.encoder.clone();
        encoder.keep_positions(&places);
        let mut decoder = self.decoder.clone();
        decoder.keep_positions(&places, &self.config);
        let (mut static_head, mut deformation_head) = (self.static_head.clone(), self.deformation_head.clone());
        let ratio = [(whole_columns, columns), (whole_rows, rows)].map(|(whole, part)| whole as f32 / part as f32);
        if grid != self.config.grid() {
            static_head.fit_to(&config, ratio);
            deformation_head.fit_to(ratio);
        }
        Some(Network {
            config,
            options: self.options,
            zero_output: self.zero_output.clone(),
            upsamplers_are_local: self.upsamplers_are_local,
            workspaces: Workspaces::default(),
            encoder,
            static_upsampler: self.static_upsampler.clone(),
            static_head,
            decoder,
            deformation_upsampler: self.deformation_upsampler.clone(),
            deformation_head,
        })
    }
}

/// The rows `places` of a table whose rows have `width` values.
pub(crate) fn rows_of(table: &[f32], width: usize, places: &[usize]) -> Vec<f32> {
    places.iter().flat_map(|place| &table[place * width..][..width]).copied().collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}
