//! ffmpeg as the encoder of pictures: its options for each kind of file.
//!
//! | file | codec | colours | quality |
//! |---|---|---|---|
//! | mp4, m4v, mov, mkv | H.264 | 4:2:0, BT.709, limited range, tagged; odd sides get one more row or column that repeats the last | `-crf` [`H264_QUALITY`] |
//! | webm | VP9 | 4:2:0, BT.709, limited range, tagged | `-crf` [`VP9_QUALITY`] |
//! | avif | AV1 | 4:2:0, BT.601, full range, tagged: all readers of still images convert these correctly, but not all convert BT.709 | `-crf` [`AV1_QUALITY`] |
//! | webp | VP8 | 4:2:0, BT.601, limited range: the format has no other | 90 of 100 |
//! | gif | GIF | 256 colours, chosen for each frame | |
//!
//! Frames without a constant rate are encoded in the order in which they are shown: in an mp4, reordered ones would get
//! the duration of their neighbours, which makes the video too short.

use std::ffi::OsString;
use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use super::y4m::fraction;
use super::{Pace, VideoFormat, matroska};
use crate::output::{OutputError, partial_name, storage};

/// Default rate factors. That of H.264 is chosen so that the decoded video is only half a decibel less close to the
/// source's frames than the encoded images are, by the mean squared error over all frames of a clip.
const H264_QUALITY: u8 = 6;
const VP9_QUALITY: u8 = 18;
const AV1_QUALITY: u8 = 18;
/// Least number of ticks per second.
const TICKS: u64 = 90_000;
/// Nanoseconds in a unit of time of GIF, and the least number of them between two images: players show shorter ones
/// several times as long.
const GIF: (u64, u64) = (10_000_000, 2);
/// Longest messages that are kept, in bytes.
const MESSAGES: u64 = 1 << 16;

/// ffmpeg's name for the kind of file that a path has.
pub(super) fn container(path: &Path) -> String {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "mkv" => "matroska".to_owned(),
        "m4v" => "mp4".to_owned(),
        _ => extension,
    }
}

/// The constant rate factors at which a file of this name can be encoded, the best first; `None` if its codec has none.
/// H.264's 0 is left out: it requires a profile that few players support.
pub fn qualities(path: &Path) -> Option<RangeInclusive<u8>> {
    match &container(path)[..] {
        "mp4" | "mov" | "matroska" => Some(1..=51),
        "webm" | "avif" => Some(0..=63),
        _ => None,
    }
}

/// The file in the form passed to ffmpeg: a name that starts with a dash or contains a colon must not be read as an
/// option or a protocol.
pub(super) fn url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// ffmpeg in a separate process group, so that Ctrl-C in the terminal does not stop it before the caller has finished
/// the file.
pub(super) fn ffmpeg() -> Command {
    #[cfg(not(test))]
    let program = "ffmpeg";
    #[cfg(test)]
    let program = storage::faults::ffmpeg();
    let mut command = Command::new(program);
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command.args(["-nostdin", "-v", "error"]);
    command
}

/// An encoder under way.
pub(super) struct Encoder {
    child: Child,
    messages: Option<JoinHandle<String>>,
    size: (usize, usize),
    /// Width and height of the pictures in the file.
    even: (usize, usize),
    /// Time of the last frame in nanoseconds.
    last: Option<u64>,
    name: String,
    /// True if images that follow the one before too closely for players of GIF are left out.
    thins: bool,
    /// Number of images that are left out.
    pub(super) left_out: usize,
}

impl Encoder {
    /// Starts ffmpeg on the temporary file of `path`.
    pub(super) fn start(
        path: &Path,
        size: (usize, usize),
        pace: Pace,
        quality: Option<u8>,
    ) -> Result<Encoder, OutputError> {
        let failed = |cause: String| OutputError::Ffmpeg { path: path.to_owned(), cause };
        let kind = &container(path)[..];
        // ffmpeg writes into the existing file, which then is not a link.
        storage::create(&partial_name(path)).map_err(OutputError::write(path))?;
        let halved = ["mp4", "mov", "matroska"].contains(&kind);
        let (width, height) = size;
        let even = if halved { (width.next_multiple_of(2), height.next_multiple_of(2)) } else { size };
        let child = ffmpeg()
            // The stream's head is complete, so ffmpeg need not probe the first frames.
            .args(["-y", "-f", "matroska", "-probesize", "32", "-fpsprobesize", "0", "-i", "-"])
            .args([
                "-fps_mode",
                "passthrough",
                "-enc_time_base",
                &format!("1:{}", if pace.uneven { TICKS } else { ticks(pace.fps) }),
            ])
            .args(arguments(kind, pace.uneven, quality))
            .args(["-f", kind])
            .arg(url(&partial_name(path)))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = match child {
            Ok(child) => child,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Err(OutputError::NoFfmpeg(path.to_owned())),
            Err(e) => return Err(failed(e.to_string())),
        };
        let Some(mut stderr) = child.stderr.take() else { return Err(failed("no pipe to it".into())) };
        let messages = std::thread::spawn(move || {
            let mut text = Vec::new();
            let _ = stderr.by_ref().take(MESSAGES).read_to_end(&mut text);
            let _ = io::copy(&mut stderr, &mut io::sink());
            String::from_utf8_lossy(&text).into_owned()
        });
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (messages, thins) = (Some(messages), kind == "gif");
        let mut encoder = Encoder { child, messages, size, even, last: None, name, thins, left_out: 0 };
        if let Err(e) = encoder.write(&matroska::head(even.0, even.1, pace.fps)) {
            return Err(failed(encoder.finish().err().unwrap_or_else(|| e.to_string())));
        }
        Ok(encoder)
    }

    /// Appends a frame that is shown `seconds` after the first.
    pub(super) fn push(&mut self, samples: Vec<u8>, seconds: f64) -> io::Result<()> {
        // `as` saturates.
        let wanted = (seconds * 1e9).round() as u64;
        if self.thins && self.last.is_some_and(|last| follows_closely(last, wanted)) {
            self.left_out += 1;
            return Ok(());
        }
        let samples = evened(samples, self.size, self.even);
        let time = self.last.map_or(wanted, |last| wanted.max(last + 1_000_000));
        self.last = Some(time);
        self.write(&matroska::frame(time, samples.len()))?;
        self.write(&samples)
    }

    /// Writes to ffmpeg.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self.child.stdin.as_mut() {
            Some(pipe) => pipe.write_all(bytes),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    /// How pictures in the file differ from those pushed.
    pub(super) fn note(&self) -> Option<String> {
        let ((width, height), (wide, high)) = (self.size, self.even);
        let (name, left_out) = (&self.name, self.left_out);
        if left_out > 0 {
            return Some(format!("{name}: {left_out} images are left out: players of GIF show at most 50 a second"));
        }
        (self.size != self.even).then(|| {
            format!(
                "{name}: {width}×{height} became {wide}×{high}, its edge repeated, as players of H.264 need even sides"
            )
        })
    }

    /// Closes ffmpeg's input and waits for its exit. The error is its first message, or its exit status. Its input is
    /// written by this program and valid, so any message is a failure.
    pub(super) fn finish(mut self) -> Result<(), String> {
        drop(self.child.stdin.take());
        let status = self.child.wait().map_err(|e| e.to_string())?;
        let text = self.messages.take().map(|thread| thread.join().unwrap_or_default()).unwrap_or_default();
        match first_line(&text) {
            Some(line) => Err(line),
            None if !status.success() => Err("it gives no reason".into()),
            None => Ok(()),
        }
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // No effect after it has exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns true if a GIF's image at `time` is too close to that at `last`.
fn follows_closely(last: u64, time: u64) -> bool {
    let (unit, least) = GIF;
    let place = |time: u64| time.saturating_add(unit / 2) / unit;
    place(time) < place(last).saturating_add(least)
}

/// The first line of ffmpeg's messages that is not blank.
pub(super) fn first_line(text: &str) -> Option<String> {
    text.lines().map(str::trim).find(|line| !line.is_empty()).map(str::to_owned)
}

/// Ticks per second such that frames at a rate of `fps` have whole numbers of ticks.
fn ticks(fps: f64) -> u64 {
    let (numerator, denominator) = fraction(fps);
    let (mut divisor, mut rest) = (numerator, denominator);
    while rest > 0 {
        (divisor, rest) = (rest, divisor % rest);
    }
    let numerator = numerator / divisor.max(1);
    let ticks = numerator * TICKS.div_ceil(numerator.max(1));
    // ffmpeg's fractions have 31 bits.
    if ticks < 1 << 31 { ticks } else { 1_000_000 }
}

fn arguments(kind: &str, uneven: bool, quality: Option<u8>) -> Vec<String> {
    const EXACT: &str = "flags=bicubic+accurate_rnd+full_chroma_int+full_chroma_inp";
    const SAME: &str = "setparams=color_primaries=bt709:color_trc=bt709";
    // Frames carry neither primaries nor a transfer function. Since ffmpeg 9 an encoder takes those of the frames, not
    // those of its options.
    let scale = |matrix: &str, range: &str| {
        format!("-vf scale=out_color_matrix={matrix}:out_range={range}:{EXACT},{SAME} -pix_fmt yuv420p")
    };
    let tags = |matrix: &str, range: &str| {
        format!(" -color_range {range} -colorspace {matrix} -color_primaries bt709 -color_trc bt709 ")
    };
    let quality = |default: u8| format!("-crf {}", quality.unwrap_or(default));
    let how = match kind {
        // 256 colours, chosen for each frame.
        "gif" => "-vf split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1".to_owned(),
        "webp" => scale("bt601", "limited").replace(SAME, "null") + " -c:v libwebp_anim -quality 90 -loop 0",
        // Without a bit rate, the quality alone decides.
        "avif" => scale("bt601", "full") + &tags("smpte170m", "pc") + &quality(AV1_QUALITY) + " -b:v 0 -cpu-used 8",
        "webm" => scale("bt709", "limited") + &tags("bt709", "tv") + &quality(VP9_QUALITY) + " -b:v 0 -row-mt 1",
        _ => {
            let order = if uneven { " -bf 0" } else { "" };
            scale("bt709", "limited") + &tags("bt709", "tv") + &quality(H264_QUALITY) + order
        }
    };
    how.split(' ').map(str::to_owned).collect()
}

/// 8-bit RGB of width and height `size`, with its last column and row repeated where `even` is larger.
fn evened(samples: Vec<u8>, size: (usize, usize), even: (usize, usize)) -> Vec<u8> {
    if size == even || size.0 == 0 {
        return samples;
    }
    let mut out = Vec::with_capacity(3 * even.0 * even.1);
    for row in samples.chunks_exact(3 * size.0) {
        out.extend_from_slice(row);
        if even.0 > size.0 {
            out.extend_from_slice(&row[row.len() - 3..]);
        }
    }
    if even.1 > size.1 {
        out.extend_from_within(out.len() - 3 * even.0..);
    }
    out
}

/// Returns true for a video that ffmpeg writes.
pub(super) fn is_encoded(path: &Path) -> bool {
    VideoFormat::of(path) == Some(VideoFormat::Ffmpeg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_frames_are_whole_ticks() {
        for (fps, expected) in
            [(24.0, 90_000), (25.0, 90_000), (24000.0 / 1001.0, 96_000), (30000.0 / 1001.0, 90_000), (12.5, 90_000)]
        {
            assert_eq!(ticks(fps), expected, "{fps}");
        }
        assert!(ticks(1e-9) < 1 << 31 && ticks(3_999.999_999) < 1 << 31);
    }

    #[test]
    fn images_of_a_gif_are_shown_two_hundredths_of_a_second_at_least() {
        let kept = |fps: u64| {
            let times = (0..fps).map(|i| i * 1_000_000_000 / fps);
            let kept = times.fold((0, None), |(count, last), time| match last {
                Some(last) if follows_closely(last, time) => (count, Some(last)),
                _ => (count + 1, Some(time)),
            });
            kept.0
        };
        assert_eq!([10, 24, 25, 40, 50, 60, 100, 120].map(kept), [10, 24, 25, 40, 50, 40, 50, 50]);
    }

    #[test]
    fn odd_sides_get_their_edge_once_more() {
        let samples: Vec<u8> = (0..9).collect();
        assert_eq!(evened(samples.clone(), (3, 1), (3, 1)), samples);
        let row = [0, 1, 2, 3, 4, 5, 6, 7, 8, 6, 7, 8];
        assert_eq!(evened(samples, (3, 1), (4, 2)), [row, row].concat());
    }

    #[test]
    fn kinds_of_files_have_the_matrix_that_they_can_say() {
        let of = |name: &str| arguments(&container(Path::new(name)), false, None).join(" ");
        assert!(of("a.webp").contains("out_color_matrix=bt601") && !of("a.webp").contains("709"));
        assert!(of("a.avif").contains("out_color_matrix=bt601:out_range=full"));
        assert!(of("a.avif").contains("-color_range pc -colorspace smpte170m"));
        for name in ["a.mp4", "a.mkv", "a.mov", "a.m4v", "a.webm"] {
            assert!(of(name).contains("out_color_matrix=bt709") && of(name).contains("-colorspace bt709"), "{name}");
        }
    }
}
