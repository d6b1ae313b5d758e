//! Frames from folders of images, y4m streams and video files.
//!
//! | input | meaning |
//! |---|---|
//! | a folder | its images ([`EXTENSIONS`](folder::EXTENSIONS)) in natural order; hidden and other files are ignored |
//! | an image file | a video of one frame; for an animated PNG or WebP, of all its frames; for a TIFF, of its pages |
//! | `*.y4m`, or a file that starts as one | read by [`y4m`] |
//! | `-` | y4m on standard input |
//! | any other file | decoded by an installed [`ffmpeg`] program |
//!
//! Frame i has the timestamp `i / fps`. The rate is [`Options::fps`] if set, else the stream's own, else
//! [`DEFAULT_FPS`]. If no rate is set, frames of video files and animations have their own times. A video whose own
//! times match its rate has `i / fps` too. All frames of a source have one size; a frame of another size is an error
//! with both sizes. The meaning of colours is decided in [`colour`].

pub mod colour;
pub mod decode;
mod error;
pub mod ffmpeg;
mod images;
mod memory;
mod sound;
pub mod y4m;

use std::fs::File;
use std::io::{BufReader, Read, Stdin};
use std::path::{Path, PathBuf};

use crate::folder;
use crate::picture::{Picture, size_is_allowed};
use crate::recognise;
use colour::Matrix;
pub use error::SourceError;
use ffmpeg::Ffmpeg;
use images::Images;
use memory::Memory;
pub use memory::{FrameInMemory, MEMORY};
pub use sound::Sound;
use y4m::Y4m;

/// The header of a y4m frame without parameters.
const FRAME: &[u8] = b"FRAME\n";

/// Frames per second if neither the user nor the stream sets a rate.
pub const DEFAULT_FPS: f64 = 24.0;

/// Options of reading a source.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Frames per second, instead of the stream's own.
    pub fps: Option<f64>,
    /// The Y'CbCr matrix, instead of the stream's own or the one chosen by size.
    pub matrix: Option<Matrix>,
}

/// A frame with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPicture {
    /// Position in the source, from 0.
    pub index: usize,
    /// Seconds since the first frame.
    pub timestamp: f64,
    /// The image file, or the stream.
    pub path: PathBuf,
    /// The frame.
    pub picture: Picture,
}

impl AsRef<Picture> for TimedPicture {
    fn as_ref(&self) -> &Picture {
        &self.picture
    }
}

/// A video being read, frame by frame; holds one frame at a time.
pub struct Source {
    kind: Input,
    path: PathBuf,
    /// Frames per second as a fraction.
    rate: (f64, f64),
    /// True if the times of a video file's own frames are used.
    own_times: bool,
    /// Width and height of pictures after their pixels are made square.
    square: Option<(usize, usize)>,
    next: usize,
    first: Option<(PathBuf, (usize, usize))>,
    /// Conversions, and parts that are left out.
    notes: Vec<String>,
}

enum Input {
    Images(Box<Images>),
    File(Y4m<BufReader<File>>),
    Stdin(Y4m<BufReader<Stdin>>),
    Ffmpeg(Box<Ffmpeg>),
    Memory(Memory),
}

/// Returns the error of a missing input.
fn missing(input: &Path, cause: std::io::Error) -> SourceError {
    match input.to_str().filter(|text| text.contains("://")) {
        Some(address) => SourceError::Address { address: address.to_owned() },
        None => SourceError::read(input)(cause),
    }
}

/// Returns true if [`Source::open`] passes `input` to ffmpeg: it is neither a folder, an image, y4m nor standard input.
pub fn is_encoded(input: &Path) -> bool {
    let is_file = input != Path::new("-") && input.is_file() && !folder::is_image(input);
    is_file && starts_as_y4m(input).is_ok_and(|y4m| !y4m)
}

impl Source {
    /// Opens `input` (see the table above).
    ///
    /// # Errors
    /// No readable input, an empty folder, a stream with an invalid start, ffmpeg needed but missing, or a rate that is
    /// not positive and finite.
    pub fn open(input: &Path, options: &Options) -> Result<Source, SourceError> {
        if let Some(fps) = options.fps
            && !(fps.is_finite() && fps > 0.0)
        {
            return Err(SourceError::FrameRate(fps));
        }
        if input != Path::new("-")
            && let Some(wrong) = recognise::not_a_video(input)
        {
            return Err(SourceError::Decode { path: input.to_owned(), cause: wrong.to_string() });
        }
        let mut kind = if input == Path::new("-") {
            Input::Stdin(Y4m::new(BufReader::with_capacity(1 << 16, std::io::stdin()), input)?)
        } else if std::fs::metadata(input).map_err(|cause| missing(input, cause))?.is_dir() {
            Input::Images(Box::new(Images::folder(input)?))
        } else if folder::is_image(input) {
            Input::Images(Box::new(Images::file(input)?))
        } else if starts_as_y4m(input)? {
            let file = File::open(input).map_err(SourceError::read(input))?;
            Input::File(Y4m::new(BufReader::with_capacity(1 << 16, file), input)?)
        } else {
            Input::Ffmpeg(Box::new(Ffmpeg::open(input, options.matrix)?))
        };
        let whole =
            |rate: Option<(u64, u64)>| rate.map(|(numerator, denominator)| (numerator as f64, denominator as f64));
        let own = match &kind {
            Input::Images(images) => whole(images.rate()),
            Input::File(y4m) => whole(y4m.header().rate),
            Input::Stdin(y4m) => whole(y4m.header().rate),
            Input::Ffmpeg(video) => video.rate(),
            Input::Memory(_) => None,
        };
        // A requested rate replaces the file's own times.
        let uneven = match &kind {
            Input::Images(images) if options.fps.is_none() => images.uneven(),
            _ => None,
        };
        let rate = match (options.fps, uneven, own) {
            (Some(fps), ..) => (fps, 1.0),
            (None, Some((seconds, frames)), _) => ((frames - 1) as f64, seconds),
            (None, None, own) => own.unwrap_or((DEFAULT_FPS, 1.0)),
        };
        let mut notes = match &mut kind {
            Input::File(y4m) => y4m.take_in(options.matrix),
            Input::Stdin(y4m) => y4m.take_in(options.matrix),
            Input::Images(_) | Input::Ffmpeg(_) | Input::Memory(_) => Vec::new(),
        };
        let alpha = match &kind {
            Input::File(y4m) => y4m.header().has_alpha(),
            Input::Stdin(y4m) => y4m.header().has_alpha(),
            Input::Images(_) | Input::Ffmpeg(_) | Input::Memory(_) => false,
        };
        if alpha {
            notes.push(decode::OVER_GREY.to_owned());
        }
        let rate_note = match (&kind, own) {
            _ if options.fps.is_some() => None,
            (Input::Images(_) | Input::Memory(_), _) => None,
            (Input::Ffmpeg(video), Some(_)) => video.is_raw().then(|| {
                "a raw stream need not state a rate, and ffmpeg then takes 25 a second (--fps takes another)".to_owned()
            }),
            (_, Some(_)) => None,
            (_, None) => {
                Some(format!("the rate is not stated: {DEFAULT_FPS} a second were taken (--fps takes another)"))
            }
        };
        match &mut kind {
            Input::Ffmpeg(video) => video.note(rate_note),
            _ => notes.extend(rate_note),
        }
        let square = match &kind {
            Input::Images(_) | Input::Memory(_) => None,
            Input::File(y4m) => y4m.header().square_size(),
            Input::Stdin(y4m) => y4m.header().square_size(),
            Input::Ffmpeg(video) => video.header().square_size(),
        };
        if let Some((width, height)) = square.filter(|&(width, height)| !size_is_allowed(width, height)) {
            return Err(SourceError::TooLarge { path: input.to_owned(), width, height });
        }
        let path = input.to_owned();
        let own_times = options.fps.is_none() && (uneven.is_some() || matches!(kind, Input::Ffmpeg(_)));
        Ok(Source { kind, path, rate, own_times, square, next: 0, first: None, notes })
    }

    /// Reads frames from memory: pictures of one size with or without times in seconds. `fps` replaces the times.
    /// Without `fps`, the spacing of the first two frames sets the rate, or [`DEFAULT_FPS`] if they have no times.
    /// `count` is the number of frames, if it is known beforehand.
    ///
    /// # Errors
    /// A rate that is not positive and finite, and the first two frames' errors.
    pub fn of_frames(
        frames: impl Iterator<Item = FrameInMemory> + Send + 'static,
        fps: Option<f64>,
        count: Option<usize>,
    ) -> Result<Source, SourceError> {
        if let Some(fps) = fps
            && !(fps.is_finite() && fps > 0.0)
        {
            return Err(SourceError::FrameRate(fps));
        }
        let mut memory = Memory::new(Box::new(frames), count);
        let own = if fps.is_none() { memory.step()? } else { None };
        let rate = (fps.or(own.map(|step| 1.0 / step)).unwrap_or(DEFAULT_FPS), 1.0);
        Ok(Source {
            kind: Input::Memory(memory),
            path: MEMORY.into(),
            rate,
            own_times: own.is_some(),
            square: None,
            next: 0,
            first: None,
            notes: Vec::new(),
        })
    }

    /// Returns the seconds from the beginning of a video file, which may be the start of its sound, to its first frame.
    pub fn start(&self) -> f64 {
        match &self.kind {
            Input::Ffmpeg(video) => video.start(),
            _ => 0.0,
        }
    }

    /// Returns the number of frames, if it can be found without decoding them: [`Source::frames`], or the counted
    /// frames of a video file, of which some may turn out not to be shown.
    pub fn counted_frames(&self) -> Option<usize> {
        match &self.kind {
            Input::Ffmpeg(video) => video.counted_frames(),
            _ => self.frames(),
        }
    }

    /// Returns the sound track of a video file, if it has one.
    pub fn sound(&self) -> Option<Sound> {
        match &self.kind {
            Input::Ffmpeg(video) => video.sound(),
            _ => None,
        }
    }

    /// Returns notes on conversions of the pictures and parts of the input that are left out, a line each. For image
    /// files and video files, lines are added as frames are read.
    pub fn notes(&self) -> &[String] {
        match &self.kind {
            Input::Images(images) => images.notes(),
            Input::Ffmpeg(video) => video.notes(),
            _ => &self.notes,
        }
    }

    /// Returns the number of frames, if it is known beforehand: for image files, and for a y4m file of whole frames.
    pub fn frames(&self) -> Option<usize> {
        match &self.kind {
            Input::Images(images) => Some(images.frames()),
            Input::File(y4m) => {
                let length = std::fs::metadata(&self.path).ok()?.len();
                let each = (FRAME.len() + y4m.header().frame_bytes()) as u64;
                let frames = length.checked_sub(y4m.header_bytes())?;
                frames.is_multiple_of(each).then(|| usize::try_from(frames / each).ok()).flatten()
            }
            Input::Memory(memory) => memory.count(),
            Input::Stdin(_) | Input::Ffmpeg(_) => None,
        }
    }

    /// Returns the expected number of frames, for progress: [`Source::frames`], or the number in a video file's
    /// metadata.
    pub fn expected_frames(&self) -> Option<usize> {
        match &self.kind {
            Input::Ffmpeg(video) => video.expected_frames(),
            _ => self.frames(),
        }
    }

    /// Returns the image files, if the frames are files.
    pub fn files(&self) -> Option<&[PathBuf]> {
        match &self.kind {
            Input::Images(images) => images.files(),
            _ => None,
        }
    }

    /// Returns the frames per second.
    pub fn fps(&self) -> f64 {
        self.rate.0 / self.rate.1
    }

    /// Returns true if frames come from standard input or from memory.
    pub fn is_stream(&self) -> bool {
        matches!(self.kind, Input::Stdin(_) | Input::Memory(_))
    }

    /// Returns true if the frames are known to have no constant rate.
    pub fn is_uneven(&self) -> bool {
        let known = match &self.kind {
            Input::Ffmpeg(video) => video.is_uneven(),
            _ => true,
        };
        self.own_times && known
    }

    /// Returns the next frame; `None` at the end.
    ///
    /// # Errors
    /// A frame that cannot be read or has another size than the first.
    pub fn next_frame(&mut self) -> Result<Option<TimedPicture>, SourceError> {
        let mut own = None;
        let (path, picture) = match &mut self.kind {
            Input::Images(images) => match images.next()? {
                Some((file, picture)) => (file, Some(picture)),
                None => return Ok(None),
            },
            Input::File(y4m) => (self.path.clone(), y4m.next_picture()?),
            Input::Stdin(y4m) => (self.path.clone(), y4m.next_picture()?),
            Input::Ffmpeg(video) => {
                let (picture, time) = video.next_frame()?.unzip();
                own = time.filter(|_| self.own_times);
                (self.path.clone(), picture)
            }
            Input::Memory(memory) => {
                let (picture, time) = memory.next_frame()?.unzip();
                own = time.flatten().filter(|_| self.own_times);
                (self.path.clone(), picture)
            }
        };
        let picture = match (picture, self.square) {
            (Some(picture), Some((width, height))) => Some(picture.resized(width, height)),
            (picture, _) => picture,
        };
        let Some(picture) = picture else { return Ok(None) };
        let found = (picture.width, picture.height);
        let (first, expected) = self.first.get_or_insert_with(|| (path.clone(), found));
        if *expected != found {
            return Err(SourceError::MixedSizes { path, found, expected: *expected, first: first.clone() });
        }
        let index = self.next;
        self.next += 1;
        let own = match &self.kind {
            Input::Images(images) if self.own_times => images.time(index),
            _ => own,
        };
        let timestamp = own.unwrap_or(index as f64 * self.rate.1 / self.rate.0);
        Ok(Some(TimedPicture { index, timestamp, path, picture }))
    }
}

fn starts_as_y4m(path: &Path) -> Result<bool, SourceError> {
    if folder::ends_in(path, &["y4m"]) {
        return Ok(true);
    }
    let mut start = Vec::new();
    File::open(path).and_then(|file| file.take(10).read_to_end(&mut start)).map_err(SourceError::read(path))?;
    if start.is_empty() {
        return Err(SourceError::EmptyFile { path: path.to_owned() });
    }
    Ok(start == b"YUV4MPEG2 ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write_png(path: &Path, width: u32, height: u32) {
        image::RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, 9])).save(path).expect("writable");
    }

    #[test]
    fn a_folder_without_images_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("notes.txt"), b"x").expect("writable");
        let error = Source::open(folder.path(), &Options::default()).err().expect("no image").to_string();
        assert!(error.contains(&folder.path().display().to_string()) && error.contains("png"), "{error}");
    }

    #[test]
    fn mixed_sizes_name_the_file_and_both_sizes() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        write_png(&folder.path().join("1.png"), 8, 6);
        write_png(&folder.path().join("2.png"), 6, 8);
        let mut source = Source::open(folder.path(), &Options::default()).expect("a folder");
        assert!(source.next_frame().expect("first").is_some());
        let error = source.next_frame().expect_err("other size").to_string();
        assert!(error.contains("2.png: the frame is 6×8, expected 8×6 as in") && error.ends_with("1.png"), "{error}");
    }

    #[test]
    fn a_zero_byte_image_is_named() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("0001.png"), b"").expect("writable");
        let mut source = Source::open(folder.path(), &Options::default()).expect("a folder");
        let error = source.next_frame().expect_err("empty").to_string();
        assert!(error.contains("0001.png") && error.contains("empty"), "{error}");
    }

    #[test]
    fn timestamps_follow_the_rate() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("v.y4m");
        std::fs::write(&path, b"YUV4MPEG2 W1 H1 F30000:1001 Cmono\nFRAME\nxFRAME\nyFRAME\nz").expect("writable");
        let times = |options: Options| {
            let mut source = Source::open(&path, &options).expect("valid");
            let mut times = Vec::new();
            while let Some(frame) = source.next_frame().expect("valid") {
                times.push(frame.timestamp);
            }
            times
        };
        assert_eq!(times(Options::default()), [0.0, 1001.0 / 30000.0, 2.0 * 1001.0 / 30000.0]);
        assert_eq!(times(Options { fps: Some(2.0), ..Options::default() }), [0.0, 0.5, 1.0]);
        assert!(Source::open(&path, &Options { fps: Some(f64::NAN), ..Options::default() }).is_err());
    }

    #[test]
    fn the_matrix_and_the_pixels_of_y4m_are_taken_in() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("v.y4m");
        // (200, 40, 40) in BT.709 of full range; pixels of 4:3.
        let [y, b, r] = Matrix::BT709.ycbcr([200.0, 40.0, 40.0].map(|v| v / 255.0));
        let sample =
            |value: f32| [(value * 65535.0).round().clamp(0.0, 65535.0) as u16; 6].map(u16::to_le_bytes).concat();
        let frame = [
            &b"YUV4MPEG2 W3 H2 A4:3 C444p16 XCOLORRANGE=FULL\nFRAME\n"[..],
            &sample(y),
            &sample(b + 32768.0 / 65535.0),
        ]
        .concat();
        std::fs::write(&path, [frame, sample(r + 32768.0 / 65535.0)].concat()).expect("writable");
        let read = |matrix| {
            let mut source = Source::open(&path, &Options { matrix, ..Options::default() }).expect("valid");
            let expected = [
                "pixels of 4:3 were made square",
                "the rate is not stated: 24 a second were taken (--fps takes another)",
            ];
            assert_eq!(source.notes(), expected);
            let picture = source.next_frame().expect("valid").expect("a frame").picture;
            assert_eq!((picture.width, picture.height), (4, 2));
            picture.to_rgb8()[..3].to_vec()
        };
        assert_eq!(read(Some(Matrix::BT709)), [200, 40, 40]);
        // Chosen by size, it would be BT.601.
        assert_ne!(read(None), [200, 40, 40]);
    }

    #[test]
    fn an_address_says_how_to_read_it() {
        let address = "https://example.org/clip.mp4";
        let error = Source::open(Path::new(address), &Options::default()).err().map(|e| e.to_string());
        let expected = format!(
            "{address}: expected a file or a folder, found an address: download it, or run ffmpeg -i {address} "
        );
        assert!(error.is_some_and(|e| e.starts_with(&expected)));
    }

    #[test]
    fn transparency_that_is_laid_over_grey_is_said() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let notes = |name: &str, image: image::DynamicImage| {
            let path = folder.path().join(name);
            image.save(&path).expect("writable");
            Source::open(&path, &Options::default()).expect("an image").notes().len()
        };
        assert_eq!(notes("alpha.png", image::DynamicImage::new_rgba8(3, 2)), 1);
        assert_eq!(notes("alpha.webp", image::DynamicImage::new_rgba8(3, 2)), 1);
        assert_eq!(notes("colour.png", image::DynamicImage::new_rgb8(3, 2)), 0);
    }

    /// Returns red and time of every frame of a file.
    fn frames(path: &Path, bytes: &[u8], options: Options) -> Vec<(f32, f64)> {
        std::fs::write(path, bytes).expect("writable");
        let mut source = Source::open(path, &options).expect("an image");
        let count = source.frames();
        let mut frames = Vec::new();
        while let Some(frame) = source.next_frame().expect("valid") {
            frames.push((frame.picture.rgb[0], frame.timestamp));
        }
        assert_eq!(count, Some(frames.len()));
        frames
    }

    #[test]
    fn every_frame_of_an_animation_comes_at_its_time() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (png, webp) = (folder.path().join("a.png"), folder.path().join("a.webp"));
        let rgba = |level: u8| image::RgbaImage::from_pixel(3, 2, image::Rgba([level, 0, 0, 255]));
        let rgb = |level: u8| image::RgbImage::from_pixel(3, 2, image::Rgb([level, 0, 0]));
        let even = decode::tests::apng(&[(rgba(0), [1, 8]), (rgba(51), [2, 16]), (rgba(255), [3, 4])]);
        assert_eq!(frames(&png, &even, Options::default()), [(0.0, 0.0), (0.2, 0.125), (1.0, 0.25)]);
        assert_eq!(
            frames(&png, &even, Options { fps: Some(2.0), ..Options::default() }),
            [(0.0, 0.0), (0.2, 0.5), (1.0, 1.0)]
        );
        let uneven =
            decode::tests::apng(&[(rgba(0), [1, 4]), (rgba(51), [1, 0]), (rgba(102), [0, 1]), (rgba(255), [1, 2])]);
        let times: Vec<f64> = frames(&png, &uneven, Options::default()).iter().map(|frame| frame.1).collect();
        assert_eq!(times, [0.0, 0.25, 0.26, 0.36]);
        let even = decode::tests::animated_webp(&[(rgb(0), 250), (rgb(255), 250), (rgb(51), 70)]);
        assert_eq!(frames(&webp, &even, Options::default()), [(0.0, 0.0), (1.0, 0.25), (0.2, 0.5)]);
        let uneven = decode::tests::animated_webp(&[(rgb(0), 500), (rgb(255), 250), (rgb(51), 70)]);
        assert_eq!(frames(&webp, &uneven, Options::default()), [(0.0, 0.0), (1.0, 0.5), (0.2, 0.75)]);
        // A missing frame is an error, not an end.
        let cut = uneven.len() - 40;
        std::fs::write(&webp, &uneven[..cut]).expect("writable");
        let mut source = Source::open(&webp, &Options::default());
        let error = match &mut source {
            Ok(source) => (0..4).find_map(|_| source.next_frame().err()).map(|e| e.to_string()),
            Err(e) => Some(e.to_string()),
        };
        assert!(error.is_some_and(|e| e.contains("cut off: expected")));
        // In a folder, each file is a frame.
        let error =
            Source::open(folder.path(), &Options::default()).expect("a folder").next_frame().expect_err("refused");
        assert!(
            error.to_string().contains("a.png: expected one picture, found an animated PNG of 4 frames"),
            "{error}"
        );
    }

    #[test]
    fn every_page_of_a_tiff_is_a_frame_and_that_is_said() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.tif");
        let mut pages = std::io::Cursor::new(Vec::new());
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut pages).expect("memory");
        for (level, kind) in [(0, 0), (51, 1), (255, 2)] {
            let mut image = encoder.new_image::<tiff::encoder::colortype::Gray8>(1, 1).expect("memory");
            // A reduced copy does not count as a page.
            image.encoder().write_tag(tiff::tags::Tag::NewSubfileType, kind as u32).expect("memory");
            image.write_data(&[level]).expect("memory");
        }
        let found = frames(&path, pages.get_ref(), Options { fps: Some(4.0), ..Options::default() });
        assert_eq!(found, [(0.0, 0.0), (1.0, 0.25)]);
        let source = Source::open(&path, &Options::default()).expect("pages");
        assert_eq!(source.notes(), ["2 pages of a TIFF are 2 frames"]);
    }

    #[test]
    fn a_missing_input_is_named() {
        let error = Source::open(Path::new("no/such/input"), &Options::default()).err().map(|e| e.to_string());
        assert!(error.is_some_and(|e| e.starts_with("no/such/input: ")));
    }
}
