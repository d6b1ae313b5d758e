//! Files: pictures, depth maps, video. A file gets its own name only once it is complete.
//!
//! A file is written under a temporary name in the same folder (`.NAME.partial`), synced, and renamed; no symbolic link
//! is written through ([`storage`]). Every file's BLAKE3 digest is computed while it is written. PNG and WebP are
//! written with fixed encoder settings by pure-Rust code, so their bytes are a function of the pixels.

pub mod storage;
mod video;

use std::io::{self, Cursor, Write};
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};

use crate::openexr::{self, NamedLayer, Planes};
use crate::picture::{Picture, to_u8};
use crate::render::Image;
pub use video::{Finished, Pace, VIDEOS, Video, VideoFormat, VideoPoint, holds_sound, qualities};

/// Errors of writing results.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The file or folder cannot be written.
    #[error("{}: cannot write: {cause}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Cause reported by the system.
        cause: io::Error,
    },
    /// The `ffmpeg` program is not installed.
    #[error(
        "{}: writing this file needs the ffmpeg program, which is not installed (Debian: apt install ffmpeg); \
         without it, write a .y4m file or a folder of images",
        .0.display()
    )]
    NoFfmpeg(PathBuf),
    /// `ffmpeg` cannot write the file.
    #[error("{}: ffmpeg cannot write it: {cause}", path.display())]
    Ffmpeg {
        /// The video file.
        path: PathBuf,
        /// The message of ffmpeg.
        cause: String,
    },
    /// A file to resume has changed.
    #[error("{}: expected its first {bytes} bytes to have the digest {expected}, found {found}", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
        /// Number of bytes compared.
        bytes: u64,
        /// Recorded digest.
        expected: String,
        /// Digest found.
        found: String,
    },
    /// A frame has another size than the video's first.
    #[error("{}: expected frames of {}×{}, found {}×{}", path.display(), expected.0, expected.1, found.0, found.1)]
    FrameSize {
        /// The video file.
        path: PathBuf,
        /// Width and height of the first frame.
        expected: (usize, usize),
        /// Width and height of this one.
        found: (usize, usize),
    },
}

impl OutputError {
    pub(crate) fn write(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> OutputError {
        let path = path.into();
        move |cause| OutputError::Write { path, cause }
    }
}

/// Length and digest of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// Bytes.
    pub bytes: u64,
    /// BLAKE3 digest in hexadecimal.
    pub blake3: String,
}

impl Written {
    /// Length and digest of these bytes.
    pub fn of(bytes: &[u8]) -> Written {
        Written { bytes: bytes.len() as u64, blake3: blake3::hash(bytes).to_hex().to_string() }
    }
}

/// Path of a file while it is written.
pub fn partial_name(path: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".partial");
    path.with_file_name(name)
}

/// The folder that contains `path`.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Writes `bytes` as the file `path`, completely or not at all. It survives a power loss.
///
/// # Errors
/// The system's, with the file's name; no partial file remains.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<Written, OutputError> {
    write_whole(path, bytes)?;
    storage::sync_folder(folder_of(path)).map_err(OutputError::write(path))?;
    Ok(Written::of(bytes))
}

/// [`write_file`] without the digest, and without waiting until the name is durable: [`storage::sync_folder`] does that
/// for all files of a folder.
///
/// # Errors
/// As [`write_file`].
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    let partial = partial_name(path);
    let result = storage::create(&partial)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync()))
        .and_then(|()| storage::rename(&partial, path));
    match result {
        Ok(()) => Ok(()),
        Err(cause) => {
            let _ = storage::remove(&partial);
            Err(OutputError::Write { path: path.to_owned(), cause })
        }
    }
}

/// A file that other code writes under its temporary name; removed unless it is [kept](Self::keep).
#[derive(Debug)]
pub struct Partial {
    target: PathBuf,
    partial: Option<PathBuf>,
}

impl Partial {
    /// Creates the temporary file, so that an unwritable folder is an error before the work starts.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(target: &Path) -> Result<Partial, OutputError> {
        let partial = partial_name(target);
        storage::create(&partial).map_err(OutputError::write(target))?;
        Ok(Partial { target: target.to_owned(), partial: Some(partial) })
    }

    /// Path to write to.
    pub fn path(&self) -> &Path {
        self.partial.as_deref().unwrap_or(&self.target)
    }

    /// Syncs the file and renames it to its own name.
    ///
    /// # Errors
    /// The file cannot be synced or renamed.
    pub fn keep(mut self) -> Result<(), OutputError> {
        let Some(partial) = self.partial.take() else { return Ok(()) };
        keep(&partial, &self.target)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if let Some(partial) = &self.partial {
            let _ = storage::remove(partial);
        }
    }
}

/// Syncs a file that is complete under its temporary name, and renames it to its own name.
fn keep(partial: &Path, target: &Path) -> Result<(), OutputError> {
    let kept = storage::reopen(partial)
        .and_then(|file| file.sync())
        .and_then(|()| storage::rename(partial, target))
        .and_then(|()| storage::sync_folder(folder_of(target)));
    kept.map_err(|cause| {
        let _ = storage::remove(partial);
        OutputError::Write { path: target.to_owned(), cause }
    })
}

/// Creates a folder and tries to write in it, so that an unwritable one is an error before the work starts. The folder
/// itself may be a link.
///
/// # Errors
/// The folder cannot be created or written in.
pub fn prepare_folder(path: &Path) -> Result<(), OutputError> {
    create_all(path).and_then(|()| probe(path)).map_err(OutputError::write(path))
}

/// As [`prepare_folder`], for a subfolder of results: a link is refused.
///
/// # Errors
/// The folder cannot be created or written in, or is a link.
pub fn prepare_subfolder(path: &Path) -> Result<(), OutputError> {
    storage::create_folder(path).and_then(|()| probe(path)).map_err(OutputError::write(path))
}

/// Creates a folder and its missing parents.
fn create_all(path: &Path) -> io::Result<()> {
    if path.as_os_str().is_empty() || path.is_dir() {
        return Ok(());
    }
    create_all(folder_of(path))?;
    match storage::create_folder(path) {
        // Another process may have created it first.
        Err(e) if !path.is_dir() => Err(e),
        _ => storage::sync_folder(folder_of(path)),
    }
}

fn probe(folder: &Path) -> io::Result<()> {
    let probe = folder.join(".streamsplat.partial");
    storage::create(&probe).and_then(|_| storage::remove(&probe))
}

fn png(width: usize, height: usize, samples: &[u8], colour: ExtendedColorType) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    match encoder.write_image(samples, width as u32, height as u32, colour) {
        Ok(()) => bytes,
        // Encoding to memory with matching lengths cannot fail.
        Err(e) => unreachable!("PNG of {width}×{height} in memory: {e}"),
    }
}

/// Encodes the picture as an 8-bit PNG file.
pub fn picture_png(picture: &Picture) -> Vec<u8> {
    png(picture.width, picture.height, &picture.to_rgb8(), ExtendedColorType::Rgb8)
}

/// Encodes the colours of an image as an 8-bit PNG file, with the bytes of [`picture_png`].
pub fn image_png(image: &Image) -> Vec<u8> {
    picture_png(&Picture { width: image.width, height: image.height, rgb: image.rgb.clone() })
}

/// Encodes a picture that was drawn over black, with its alpha, as an 8-bit PNG file. PNG's colours are not multiplied
/// by alpha, so they are divided by it before they are rounded.
///
/// # Panics
/// When `alpha` does not hold `width · height` values.
pub fn transparent_png(picture: &Picture, alpha: &[f32]) -> Vec<u8> {
    let Picture { width, height, .. } = picture;
    let plane = width * height;
    assert_eq!(alpha.len(), plane, "a plane of {width}×{height}");
    png(*width, *height, &straight(picture, alpha), ExtendedColorType::Rgba8)
}

/// Divides colours by the alpha that they are multiplied by; returns them with alpha, rounded to 8 bits.
fn straight(picture: &Picture, alpha: &[f32]) -> Vec<u8> {
    let Picture { width, height, rgb } = picture;
    let plane = width * height;
    let mut samples = Vec::with_capacity(4 * plane);
    for (pixel, &alpha) in alpha.iter().enumerate() {
        let opaque = to_u8(alpha);
        for channel in 0..3 {
            let colour = if opaque == 0 { 0.0 } else { rgb[channel * plane + pixel] / alpha.min(1.0) };
            samples.push(to_u8(colour));
        }
        samples.push(opaque);
    }
    samples
}

/// Longest side of a WebP file.
pub const WEBP_SIDE: usize = 16_383;

/// Encodes the picture as a lossless WebP file; with alpha, of a picture that was drawn over black, as in
/// [`transparent_png`].
///
/// # Errors
/// Sides longer than WebP allows.
///
/// # Panics
/// When `alpha` does not hold `width · height` values.
pub fn picture_webp(picture: &Picture, alpha: Option<&[f32]>) -> io::Result<Vec<u8>> {
    let &Picture { width, height, .. } = picture;
    if ![width, height].iter().all(|side| (1..=WEBP_SIDE).contains(side)) {
        let found = format!("WebP: expected sides of 1 to {WEBP_SIDE} pixels, found {width}×{height}");
        return Err(io::Error::other(found));
    }
    let (samples, colour) = match alpha {
        None => (picture.to_rgb8(), ExtendedColorType::Rgb8),
        Some(alpha) => {
            assert_eq!(alpha.len(), width * height, "a plane of {width}×{height}");
            (straight(picture, alpha), ExtendedColorType::Rgba8)
        }
    };
    let mut bytes = Vec::new();
    let encoder = WebPEncoder::new_lossless(&mut bytes);
    encoder.write_image(&samples, width as u32, height as u32, colour).map_err(io::Error::other)?;
    Ok(bytes)
}

/// Encodes a plane with values in `[0, 1]` as an 8-bit grey PNG file.
///
/// # Panics
/// When `plane` does not hold `width · height` values.
pub fn plane_png(width: usize, height: usize, plane: &[f32]) -> Vec<u8> {
    assert_eq!(plane.len(), width * height, "a plane of {width}×{height}");
    let samples: Vec<u8> = plane.iter().map(|&v| to_u8(v)).collect();
    png(width, height, &samples, ExtendedColorType::L8)
}

/// Encodes a depth image (`Σ d α T`) and, if present, its alpha (`Σ α T`) as an EXR file with the channels `Z` and `A`.
///
/// # Errors
/// Planes whose length is not `width · height`.
pub fn depth_exr(width: usize, height: usize, depth: &[f32], alpha: Option<&[f32]>) -> io::Result<Vec<u8>> {
    let mut channels = vec![("Z".to_owned(), depth.to_vec())];
    if let Some(alpha) = alpha {
        channels.insert(0, ("A".to_owned(), alpha.to_vec()));
    }
    let mut bytes = Cursor::new(Vec::new());
    openexr::write(&Planes { width, height, channels }, DEPTH_COMMENT, &mut bytes)?;
    Ok(bytes.into_inner())
}

/// Encodes an image as one lossless EXR file of 32-bit floats, in three layers: `colour` (channels R, G and B), `depth`
/// (Z, as in [`depth_exr`]) and `alpha` (A).
///
/// Colours are as drawn: in display (gamma) space, over the background. Over a black background they are multiplied by
/// alpha, as compositing requires.
///
/// # Errors
/// An image without depth or alpha, or planes whose length is not `width · height`.
pub fn layered_exr(image: &Image) -> io::Result<Vec<u8>> {
    layers(image, false)
}

/// Encodes the planes of an image as one lossless EXR file of 32-bit floats. With depth and alpha it is that of
/// [`layered_exr`]. Otherwise it has colours in the channels R, G and B of the layer `colour`, and depth or alpha, if
/// present, in their layers.
///
/// # Errors
/// Planes whose length is not `width · height`.
pub fn image_exr(image: &Image) -> io::Result<Vec<u8>> {
    write_layers(image, false, [image.depth.is_some(), image.alpha.is_some()])
}

/// As [`layered_exr`], for an image that was drawn over black: `colour` holds alpha as well (channels R, G, B and A),
/// and its colours are multiplied by it, as usual in that format.
///
/// # Errors
/// As [`layered_exr`].
pub fn transparent_exr(image: &Image) -> io::Result<Vec<u8>> {
    layers(image, true)
}

fn layers(image: &Image, transparent: bool) -> io::Result<Vec<u8>> {
    write_layers(image, transparent, [true; 2])
}

fn write_layers(image: &Image, transparent: bool, [depth, alpha]: [bool; 2]) -> io::Result<Vec<u8>> {
    let Image { width, height, .. } = *image;
    let wanted = |plane: &Option<Vec<f32>>, what: &str| {
        plane.clone().ok_or_else(|| io::Error::other(format!("expected an image with {what}, found none")))
    };
    let area = width * height;
    if image.rgb.len() != 3 * area {
        return Err(io::Error::other(format!("expected {} samples of colour, found {}", 3 * area, image.rgb.len())));
    }
    let colour = |name: &str, plane: usize| (name.to_owned(), image.rgb[plane * area..][..area].to_vec());
    let layer = |name, comment, channels, colour_space| NamedLayer {
        name,
        planes: Planes { width, height, channels },
        comment,
        colour_space,
    };
    let mut colours = vec![colour("B", 2), colour("G", 1), colour("R", 0)];
    if transparent {
        colours.insert(0, ("A".to_owned(), wanted(&image.alpha, "alpha")?));
    }
    let mut layers = vec![layer("colour", COLOUR_COMMENT, colours, Some("sRGB"))];
    if depth {
        layers.push(layer("depth", DEPTH_COMMENT, vec![("Z".to_owned(), wanted(&image.depth, "depth")?)], None));
    }
    if alpha {
        layers.push(layer("alpha", ALPHA_COMMENT, vec![("A".to_owned(), wanted(&image.alpha, "alpha")?)], None));
    }
    let mut bytes = Vec::new();
    openexr::write_layers(&layers, &mut bytes)?;
    Ok(bytes)
}

const DEPTH_COMMENT: &str = "Z: sum of depth * alpha * transmittance over the splats of a pixel, depth in scene units along the view axis \
                   (0.1 nearest, 5 farthest for the canonical camera); divide by alpha for the mean depth";
const COLOUR_COMMENT: &str = "display-referred: Gaussians are blended in display (gamma) space, not in linear light; over the \
                              background; where that is black, multiplied by alpha";
const ALPHA_COMMENT: &str = "sum of alpha * transmittance over the splats of a pixel";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_whole_or_absent() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.bin");
        let written = write_file(&path, b"hello").expect("writable");
        assert_eq!(written.blake3, blake3::hash(b"hello").to_hex().as_str());
        assert_eq!(std::fs::read(&path).expect("readable"), b"hello");
        // A folder has the file's name: the rename fails, and no file remains.
        std::fs::create_dir(folder.path().join("b.bin")).expect("writable");
        assert!(write_file(&folder.path().join("b.bin"), b"x").is_err());
        let names: Vec<_> =
            std::fs::read_dir(folder.path()).expect("readable").flatten().map(|e| e.file_name()).collect();
        assert_eq!(names.len(), 2, "{names:?}");
        let error = write_file(&folder.path().join("no/such/c.bin"), b"x").expect_err("no folder").to_string();
        assert!(error.contains("c.bin: cannot write"), "{error}");
    }

    #[test]
    fn a_transparent_png_holds_colours_that_are_not_multiplied_by_alpha() {
        let picture = Picture { width: 2, height: 1, rgb: vec![0.25, 0.0, 0.5, 0.0, 0.0, 0.0] };
        let bytes = transparent_png(&picture, &[0.5, 0.0]);
        let image = image::load_from_memory(&bytes).expect("a PNG").into_rgba8();
        assert_eq!(image.as_raw(), &[128, 255, 0, 128, 0, 0, 0, 0]);
    }

    #[test]
    fn a_webp_holds_the_samples_of_the_png() {
        let rgb: Vec<f32> = (0..3 * 35).map(|i| (i * 37 % 101) as f32 / 100.0).collect();
        let picture = Picture { width: 7, height: 5, rgb };
        let alpha: Vec<f32> = (0..35).map(|i| (i % 5) as f32 / 4.0).collect();
        let read = |bytes: &[u8]| image::load_from_memory(bytes).expect("an image").into_rgba8();
        let webp = |alpha: Option<&[f32]>| picture_webp(&picture, alpha).expect("small");
        assert_eq!(read(&webp(None)), read(&picture_png(&picture)));
        assert_eq!(read(&webp(Some(&alpha))), read(&transparent_png(&picture, &alpha)));
        let wide = Picture { width: WEBP_SIDE + 1, height: 1, rgb: vec![0.0; 3 * (WEBP_SIDE + 1)] };
        assert!(picture_webp(&wide, None).expect_err("too wide").to_string().contains("expected sides of 1 to 16383"));
    }

    #[test]
    fn png_and_exr_come_back_as_they_were() {
        let bytes: Vec<u8> = (0..60).map(|i| (i * 4) as u8).collect();
        let picture = Picture::from_rgb8(5, 4, &bytes).expect("20 pixels");
        let again = crate::source::decode::decode(&picture_png(&picture), Path::new("p.png")).expect("valid");
        assert_eq!(again, picture);
        let depth: Vec<f32> = (0..20).map(|i| i as f32 * 0.1).collect();
        let exr = depth_exr(5, 4, &depth, Some(&[0.5; 20])).expect("memory");
        let planes = openexr::read(&exr).expect("valid");
        assert_eq!((planes.channel("Z"), planes.channel("A")), (Some(depth.as_slice()), Some(&[0.5; 20][..])));
    }
}
