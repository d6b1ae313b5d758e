//! The stream.
#![deny(unsafe_code)]

pub mod metrics;
pub mod openexr;
pub mod picture;
pub mod source;
