//! A run under way: frames to key frames, key frames to intervals, intervals to images.

pub mod ahead;
pub mod catch_up;
pub mod closeness;
pub mod drawing;
pub mod keydepth;
pub mod keyframes;
pub mod opening;
pub mod serving;
pub mod stream;
