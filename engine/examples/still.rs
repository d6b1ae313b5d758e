//! A splat file in, an image out: the bytes of `streamsplat render garden.ply --size 640x360 --out garden.png`.
//!
//! cargo run --release -p streamsplat --example still garden.ply garden.png

use std::error::Error;

use streamsplat::still::{Drawable, Still};
use streamsplat::{Level, RenderOptions, Size, Workers, output};

/// Draws a file as it is framed by itself.
pub fn draw(file: &str, out: &str) -> Result<(), Box<dyn Error>> {
    let workers = Workers::new(Level::detect(), 0)?;
    let scene = Drawable::new(Still::open(file)?, &workers)?;
    let camera = scene.still().framing().ok_or("an empty scene")?.camera(0.0, 16.0 / 9.0);
    let options = RenderOptions { size: Size::Exact { width: 640, height: 360 }, ..RenderOptions::default() };
    let image = scene.render(&camera, &options, &workers)?;
    output::write_file(out.as_ref(), &output::image_png(&image))?;
    Ok(())
}

/// Draws the first argument into the second.
pub fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [file, out] = paths.as_slice() else { return Err("expected a splat file and an image to write".into()) };
    draw(file, out)
}
