//! Video in, scene and images out: the bytes of `streamsplat run clip.y4m --out out`.
//!
//! cargo run --release -p streamsplat --example run

use streamsplat::run::{Error, Run, RunOptions};

/// Runs with the defaults.
pub fn main() -> Result<(), Error> {
    let record = Run::new("clip.y4m", RunOptions::default()).out("out").finish()?;
    println!("{} frames, {} key frames", record.input.count, record.key_frames.unwrap_or_default());
    Ok(())
}
