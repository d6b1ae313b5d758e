//! Contracts across crates, in one executable: each would contain the whole engine.

mod container;
mod exact_savings;
mod extremes;
mod found_depth;
mod golden;
mod hostile_bytes;
mod model_files;
mod other_sizes;
mod parity;
mod raster_oracle;
mod reference;
mod reuse;
mod stream_bits;
mod stream_continuity;
mod stream_long;
mod stream_pictures;
mod stream_refusals;
mod stream_reuse;
mod stream_sizes;
mod stream_still;
mod tensors;
mod track_accuracy;
mod turned_views;
