//! Streams of a file, as ffmpeg lists them, and the choice of the video among them.
//!
//! This uses only `ffmpeg -i FILE`, so installations without ffprobe read the same frames. The list is made for people,
//! but the form of its lines has been stable for many versions. Format and colours of the frames are taken from the
//! first decoded frame ([`super::shown`]). The list's values are only a guess that saves a second start.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::path::Path;

use super::chain::ALPHA;
use super::program;
use super::shown::Look;
use crate::source::colour::Tags;

/// Frame counts above this are implausible and ignored.
const MOST_FRAMES: f64 = 1e9;
/// Relative difference of mean and nominal rate above which a stream's frames are counted.
const SAME_RATE: f64 = 0.01;
/// Fraction of the longest stream's length from which a stream counts as equally long.
const AS_LONG: f64 = 0.5;

/// ffmpeg's names of formats that are frames without a container.
const RAW: [&str; 7] = ["mjpeg", "obu", "h264", "hevc", "vvc", "m4v", "vc1"];

/// Names that denote a matrix, primaries and a transfer; the list prints one name where all three are the same.
const SHARED: [&str; 4] = ["bt709", "bt470bg", "smpte170m", "smpte240m"];

/// A video stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Stream {
    /// Its number in the file.
    pub(super) index: usize,
    /// ffmpeg's name of its codec.
    pub(super) codec: String,
    pub(super) size: (usize, usize),
    /// Properties of its frames according to the list.
    pub(super) look: Look,
    /// Frames per second: mean (`mean`) and nominal.
    mean: Option<f64>,
    nominal: Option<f64>,
    /// Start in seconds, on the same clock as the file's [`Listing::start`].
    start: Option<f64>,
    default: bool,
    /// True for a cover, or another picture that does not move.
    pub(super) cover: bool,
    /// True if the file declares it a still.
    still: bool,
    /// True for a part of another stream's pictures.
    dependent: bool,
    /// Properties that are not used, a line each.
    notes: Vec<String>,
}

/// Content of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Listing {
    pub(super) videos: Vec<Stream>,
    /// Codec of the first sound track, in ffmpeg's names.
    pub(super) sound: Option<String>,
    /// Notes on further sound tracks and on subtitles.
    others: Vec<String>,
    /// Seconds of the longest stream (`duration`), and the time when the first one starts.
    duration: Option<f64>,
    start: Option<f64>,
    /// True if pictures are composed of tiles.
    tiles: bool,
    /// True for transport streams, whose packets are marked as broken where two streams were joined.
    pub(super) joined: bool,
    /// True for text, which ffmpeg draws as a terminal would.
    text: bool,
    /// True for frames without a container.
    pub(super) raw: bool,
    /// True for Matroska: its rates are only declarations, which the frames' times may contradict.
    pub(super) declared: bool,
}

/// Number and times of a stream's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Count {
    pub(super) frames: usize,
    /// Seconds from the first frame to the last.
    pub(super) seconds: f64,
    /// True if the durations of the frames, except the last, differ.
    pub(super) uneven: bool,
}

impl Listing {
    /// Lists the streams of the file. The list is empty if ffmpeg cannot read it; decoding then reports the error.
    pub(super) fn of(path: &Path) -> std::io::Result<Listing> {
        Ok(Listing::parse(&program::list(path)?))
    }

    fn parse(text: &str) -> Listing {
        let mut found = Listing::default();
        // Lines of metadata, such as titles, are indented by four blanks or more; so are the streams of a group.
        let mut deepest = 2;
        for line in text.lines() {
            let depth = line.len() - line.trim_start().len();
            let line = line.trim_start();
            if depth > deepest {
                if let Some(stream) = found.videos.last_mut() {
                    stream.notes.extend(mark(line));
                }
                continue;
            }
            if let Some(format) = line.strip_prefix("Input #0, ") {
                found.joined = format.starts_with("mpegts");
                found.declared = format.starts_with("matroska");
                found.raw = RAW.contains(&first_word(format));
                found.text = format.starts_with("tty,");
            } else if let Some(rest) = line.strip_prefix("Duration: ") {
                found.duration = rest.split(',').next().and_then(clock);
                found.start = after(rest, "start: ");
            } else if line.starts_with("Stream group #0:") {
                let tiles = line.contains("Tile Grid");
                found.tiles |= tiles;
                deepest = if tiles { 2 } else { 4 };
            } else if let Some((index, kind, rest)) = stream(line) {
                match kind {
                    "Video" => found.videos.extend(video(index, rest)),
                    "Audio" if found.sound.is_none() => found.sound = Some(first_word(rest).to_owned()),
                    "Audio" => found.others.push(format!("the sound track 0:{index} is left out")),
                    "Subtitle" => found.others.push(format!("the subtitles 0:{index} are left out")),
                    _ => {}
                }
            }
        }
        found
    }

    /// Returns the reason why no stream is a video, or `None` if one is.
    pub(super) fn refusal(&self) -> Option<&'static str> {
        match (self.videos.iter().any(Stream::may_move), &self.sound) {
            _ if self.text => Some("expected a video, found a text file"),
            (true, _) => None,
            (false, _) if self.tiles => Some("expected a video, found a picture put together of tiles (HEIC)"),
            (false, None) if self.videos.is_empty() => None,
            (false, None) => Some("expected a video, found a cover picture alone"),
            (false, Some(_)) if self.videos.is_empty() => Some("expected a video, found sound alone"),
            (false, Some(_)) => Some("expected a video, found sound with a cover picture"),
        }
    }

    /// Chooses the stream to read, and returns a note for each that is left out. `count` counts frames, stream by
    /// stream; it is called only if there is a choice.
    pub(super) fn choose(&self, count: impl FnOnce() -> Vec<(usize, Count)>) -> Option<(&Stream, Vec<String>)> {
        let candidates: Vec<&Stream> = self.videos.iter().filter(|stream| stream.may_move()).collect();
        let counts = if candidates.len() > 1 { count() } else { Vec::new() };
        let of = |stream: &Stream| {
            counts.iter().find(|(index, _)| *index == stream.index).map(|(_, count)| *count).unwrap_or_default()
        };
        let longest = candidates.iter().map(|stream| of(stream).seconds).fold(0.0, f64::max);
        let score = |stream: &Stream| {
            let Count { frames, seconds, .. } = of(stream);
            let long = seconds >= AS_LONG * longest;
            (frames > 1, !stream.still, stream.default, long, stream.size.0.saturating_mul(stream.size.1))
        };
        // The first of equal ones.
        let chosen = candidates.iter().rev().max_by_key(|stream| score(stream))?;
        let left_out =
            self.videos.iter().filter(|stream| stream.index != chosen.index && !stream.dependent).map(|stream| {
                let kind = match of(stream).frames {
                    _ if stream.cover => "cover picture",
                    1 => "still picture",
                    _ => "video stream",
                };
                let (width, height) = stream.size;
                format!("the {kind} 0:{} ({}, {width}×{height}) is left out", stream.index, stream.codec)
            });
        Some((chosen, left_out.chain(chosen.notes.iter().chain(&self.others).cloned()).collect()))
    }

    /// Estimates the number of frames in a stream from the file's duration, the stream's mean rate and, if already
    /// read, the time of its first frame.
    pub(super) fn frames(&self, stream: &Stream, first: Option<f64>) -> Option<usize> {
        let own = first.or(stream.start);
        let late = own.zip(self.start).map_or(0.0, |(own, file)| (own - file).max(0.0));
        let frames = (self.duration? - late) * stream.mean?;
        (1.0..MOST_FRAMES).contains(&frames).then(|| frames.round() as usize)
    }
}

impl Stream {
    fn may_move(&self) -> bool {
        !self.cover && !self.dependent
    }

    /// Returns true if the mean rate is missing or differs from the nominal rate; the frames are then counted to find
    /// it.
    pub(super) fn rate_is_open(&self) -> bool {
        match self.mean.zip(self.nominal) {
            Some((mean, nominal)) => (mean / nominal - 1.0).abs() > SAME_RATE,
            None => true,
        }
    }
}

/// Splits `Stream #0:1[0x2](und): Video: h264 …` into its number, kind and the rest.
fn stream(line: &str) -> Option<(usize, &str, &str)> {
    let rest = line.strip_prefix("Stream #0:")?;
    let digits = rest.find(|c: char| !c.is_ascii_digit())?;
    let index = rest[..digits].parse().ok()?;
    let (_, rest) = rest[digits..].split_once(": ")?;
    let (kind, rest) = rest.split_once(": ")?;
    Some((index, kind, rest))
}

/// Returns the note on a line of a stream's metadata.
fn mark(line: &str) -> Option<String> {
    let (name, value) = line.split_once(':')?;
    match (name.trim_end(), value.trim_start()) {
        // ffmpeg's own decoder of VP8 and VP9 omits it.
        ("alpha_mode", "1") => Some(ALPHA.to_owned()),
        ("stereo3d", kind) if !kind.starts_with("2D") => {
            Some(format!("the pictures are marked as stereo ({kind}): they are taken as they are stored"))
        }
        _ => None,
    }
}

fn first_word(text: &str) -> &str {
    text.split([' ', ',']).next().unwrap_or_default()
}

/// Returns the number after `key`.
fn after(text: &str, key: &str) -> Option<f64> {
    let (_, rest) = text.split_once(key)?;
    first_word(rest).parse().ok()
}

/// Parses `00:01:02.50` to seconds.
fn clock(text: &str) -> Option<f64> {
    let mut seconds = 0.0;
    for part in text.trim().split(':') {
        seconds = 60.0 * seconds + part.parse::<f64>().ok().filter(|part| *part >= 0.0)?;
    }
    Some(seconds)
}

/// Splits a line at its commas, except those in brackets.
fn parts(text: &str) -> Vec<&str> {
    let (mut parts, mut depth, mut from) = (Vec::new(), 0usize, 0);
    for (at, c) in text.char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' => depth = depth.saturating_sub(1),
            ',' if depth == 0 => {
                parts.push(text[from..at].trim());
                from = at + 1;
            }
            _ => {}
        }
    }
    parts.push(text[from..].trim());
    parts
}

/// Parses a rate of the list: `29.97`, `90k`.
fn rate(part: &str, unit: &str) -> Option<f64> {
    let number = part.strip_suffix(unit)?.trim_end();
    let (number, times) = number.strip_suffix('k').map_or((number, 1.0), |number| (number, 1000.0));
    number.parse::<f64>().ok().map(|rate| rate * times).filter(|rate| *rate > 0.0)
}

/// Parses `320x180 [SAR 4:3 DAR 64:27]` to columns and rows.
fn size(part: &str) -> Option<(usize, usize)> {
    let (width, height) = first_word(part).split_once('x')?;
    Some((width.parse().ok()?, height.parse().ok()?))
}

/// Parses a stream's description after `Video: `.
fn video(index: usize, text: &str) -> Option<Stream> {
    let mut parts = parts(text);
    let mut found = Stream { index, codec: first_word(text).to_owned(), ..Stream::default() };
    // The stream's dispositions follow the last part in brackets.
    let last = parts.pop()?;
    let (last, words) = last.find(" (").map_or((last, ""), |at| last.split_at(at));
    parts.push(last);
    let is = |word: &str| words.contains(&format!("({word})"));
    found.default = is("default");
    found.cover = is("attached pic") || is("timed thumbnails");
    found.still = is("still image") || is("still");
    found.dependent = is("dependent");
    let mut format = "";
    for (at, part) in parts.iter().enumerate().skip(1) {
        if at == 1 {
            format = part;
        } else if let Some(size) = size(part).filter(|_| found.size == (0, 0)) {
            found.size = size;
        }
        if let Some((_, aspect)) = part.split_once("SAR ") {
            // The container's aspect is printed later and overrides the codec's.
            found.look.aspect = super::shown::ratio(first_word(aspect)).filter(|(w, h)| w != h);
        }
        found.mean = found.mean.or_else(|| rate(part, " fps"));
        found.nominal = found.nominal.or_else(|| rate(part, " tbr"));
        found.start = found.start.or_else(|| after(part, "start "));
    }
    let (name, inside) = format.split_once('(').unwrap_or((format, ""));
    found.look.format = name.to_owned();
    for word in inside.trim_end_matches(')').split(", ") {
        match word {
            _ if word.starts_with("top ") || word.starts_with("bottom ") => found.look.interlaced = true,
            "tv" | "pc" => found.look.tags.range = Some(word.to_owned()),
            _ => {
                let mut names = word.split('/');
                let (matrix, primaries, transfer) = (names.next(), names.next(), names.next());
                if primaries.is_some() || matrix.is_some_and(|name| SHARED.contains(&name)) {
                    // A single name is printed if matrix, primaries and transfer are the same.
                    let range = found.look.tags.range.take();
                    found.look.tags = Tags::of(matrix, primaries.or(matrix), transfer.or(matrix));
                    found.look.tags.range = range;
                }
            }
        }
    }
    Some(found)
}

/// ffmpeg's flag of packets whose frames are not shown.
const DISCARD: u32 = 4;

/// Maximum number of packets by which decoding order and display order differ.
const REORDERED: usize = 32;
/// Ticks by which rounding changes the frame durations of an even rate.
const ROUNDED: i64 = 2;

/// Frame counts of streams, from the lines of the `framecrc` muxer: `0, DTS, PTS, DURATION, SIZE, CRC` after `#tb 0:
/// 1/1000`.
#[derive(Debug, Default)]
pub(super) struct Counter {
    streams: Vec<Counted>,
}

#[derive(Debug, Default)]
struct Counted {
    /// Seconds per tick.
    tick: f64,
    frames: usize,
    /// Times in ticks that are not in `shown` yet, the smallest on top.
    waiting: BinaryHeap<Reverse<i64>>,
    shown: Shown,
}

/// Times in ticks, in display order.
#[derive(Clone, Copy, Debug, Default)]
struct Shown {
    /// The first and the last time.
    span: Option<(i64, i64)>,
    /// The smallest and the largest difference of consecutive times.
    lengths: Option<(i64, i64)>,
}

impl Shown {
    fn add(&mut self, time: i64) {
        let Some((first, last)) = self.span else { return self.span = Some((time, time)) };
        let length = time.saturating_sub(last);
        let (least, most) = self.lengths.unwrap_or((length, length));
        self.lengths = Some((least.min(length), most.max(length)));
        self.span = Some((first.min(time), last.max(time)));
    }
}

impl Counter {
    pub(super) fn add(&mut self, line: &str) {
        if let Some(rest) = line.strip_prefix("#tb ") {
            if let Some((_, base)) = rest.split_once(": ")
                && let Some((a, b)) = super::shown::ratio(base.trim())
            {
                self.streams.push(Counted { tick: f64::from(a) / f64::from(b), ..Counted::default() });
            }
            return;
        }
        // Flags of packets that are decoded for other packets and not shown.
        let flags = line.split_once("F=0x").and_then(|(_, flags)| u32::from_str_radix(first_word(flags), 16).ok());
        if flags.is_some_and(|flags| flags & DISCARD != 0) {
            return;
        }
        let mut numbers = line.split(',').map(|number| number.trim().parse::<i64>());
        let (Some(Ok(stream)), Some(_), Some(Ok(time))) = (numbers.next(), numbers.next(), numbers.next()) else {
            return;
        };
        let Some(counted) = usize::try_from(stream).ok().and_then(|at| self.streams.get_mut(at)) else { return };
        counted.frames += 1;
        // A packet without a time.
        if time == i64::MIN {
            return;
        }
        counted.waiting.push(Reverse(time));
        if counted.waiting.len() > REORDERED
            && let Some(Reverse(time)) = counted.waiting.pop()
        {
            counted.shown.add(time);
        }
    }

    /// Returns the counts, stream by stream.
    pub(super) fn counts(self) -> Vec<Count> {
        let count = |Counted { tick, frames, waiting, mut shown }| {
            waiting.into_sorted_vec().into_iter().rev().for_each(|Reverse(time)| shown.add(time));
            let ticks = shown.span.map_or(0, |(first, last)| last.saturating_sub(first));
            let uneven = shown.lengths.is_some_and(|(least, most)| most.saturating_sub(least) > ROUNDED);
            Count { frames, seconds: ticks as f64 * tick, uneven }
        };
        self.streams.into_iter().map(count).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Listings by two versions of ffmpeg for files of several kinds.
    const COVER: &str = "Input #0, mov,mp4,m4a,3gp,3g2,mj2, from 'covfirst.mp4':
  Metadata:
    title           : Stream #0:7: Video: h264, yuv420p, 8x8, 25 fps
  Duration: 00:00:01.20, start: 0.000000, bitrate: 88 kb/s
  Stream #0:0[0x0]: Video: png, rgb24(pc, gbr/unknown/unknown), 64x64 [SAR 1:1 DAR 1:1], 90k tbr, 90k tbn (attached pic)
  Stream #0:1[0x1](und): Video: h264 (High 4:4:4 Predictive) (avc1 / 0x31637661), yuv444p(tv, bt709, top coded first (swapped)), 320x180 [SAR 4:3 DAR 64:27], 45 kb/s, SAR 3:2 DAR 8:3, 29.97 fps, 29.97 tbr, 12800 tbn, start 0.200000 (default)
    Metadata:
      handler_name    : VideoHandler
  Stream #0:2(eng): Audio: aac (LC) (mp4a / 0x6134706D), 48000 Hz, mono, fltp, 1 kb/s (default)
At least one output file must be specified
";
    const AVIF: &str = "  Duration: 00:00:00.90, start: 0.000000, bitrate: 18 kb/s
  Stream #0:0[0x1]: Video: av1 (libdav1d) (High) (av01 / 0x31307661), gbrp(pc, gbr/unknown/unknown), 64x48 [SAR 1:1 DAR 4:3], 1 fps, 1 tbr, 1 tbn (default)
  Stream #0:1[0x1](und): Video: av1 (libdav1d) (High) (av01 / 0x31307661), gbrp(pc, gbr/bt709/iec61966-2-1, progressive), 64x48 [SAR 1:1 DAR 4:3], 9 kb/s, 10 fps, 10 tbr, 10240 tbn (default)
";
    const RECORDER: &str = "  Duration: N/A, start: 0.000000, bitrate: N/A
  Stream #0:0: Video: vp8, yuv420p(progressive), 160x96, SAR 1:1 DAR 5:3, 1k tbr, 1k tbn
";

    #[test]
    fn a_list_is_read_whatever_its_titles_hold() {
        let listing = Listing::parse(COVER);
        assert_eq!((listing.videos.len(), listing.sound.as_deref()), (2, Some("aac")));
        let video = &listing.videos[1];
        let tags = Tags::of(Some("bt709"), Some("bt709"), Some("bt709")).with_range(Some("tv"));
        let look = Look { format: "yuv444p".into(), aspect: Some((3, 2)), interlaced: true, tags };
        assert_eq!((video.index, &video.codec[..], video.size, &video.look), (1, "h264", (320, 180), &look));
        assert!(video.default && !video.cover && listing.videos[0].cover && !video.rate_is_open());
        assert_eq!((listing.frames(video, None), listing.frames(video, Some(0.6))), (Some(30), Some(18)));
        let recorder = Listing::parse(RECORDER);
        assert!(recorder.videos[0].rate_is_open() && recorder.frames(&recorder.videos[0], None).is_none());
        assert_eq!(recorder.videos[0].nominal, Some(1000.0));
    }

    #[test]
    fn the_moving_stream_is_chosen_and_the_others_are_named() {
        let listing = Listing::parse(COVER);
        let (stream, lines) = listing.choose(|| unreachable!("one candidate")).expect("a video");
        assert_eq!((stream.index, &lines[..]), (1, &["the cover picture 0:0 (png, 64×64) is left out".to_owned()][..]));
        let listing = Listing::parse(AVIF);
        let counts = |frames: [usize; 2], seconds: [f64; 2]| {
            (0..2)
                .map(move |i| (i, Count { frames: frames[i], seconds: seconds[i], uneven: false }))
                .collect::<Vec<_>>()
        };
        let (stream, lines) = listing.choose(|| counts([1, 9], [0.0, 0.8])).expect("a video");
        assert_eq!((stream.index, &lines[..]), (1, &["the still picture 0:0 (av1, 64×48) is left out".to_owned()][..]));
        // If two streams move: the default, then the longer, then the larger, then the first.
        let mut two = listing;
        let mut chosen = |default: [bool; 2], wide: [usize; 2], seconds: [f64; 2]| {
            for i in 0..2 {
                (two.videos[i].default, two.videos[i].size.0) = (default[i], wide[i]);
            }
            two.choose(|| counts([9, 9], seconds)).expect("a video").0.index
        };
        assert_eq!(chosen([true, true], [64, 64], [1.0, 1.0]), 0);
        assert_eq!(chosen([true, true], [64, 96], [1.0, 1.0]), 1);
        assert_eq!(chosen([true, true], [64, 96], [1.0, 0.2]), 0);
        assert_eq!(chosen([false, true], [96, 64], [1.0, 0.2]), 1);
    }

    #[test]
    fn parts_and_marks_that_are_not_used_are_told() {
        let listing = Listing::parse(
            "Input #0, matroska,webm, from 'a.webm':
  Metadata:
    title           : alpha_mode : 1
  Stream #0:0: Video: vp9 (Profile 0), yuv420p(tv, progressive), 64x48, SAR 1:1 DAR 4:3, 10 fps, 10 tbr, 1k tbn
    Metadata:
      alpha_mode      : 1
    Side data:
      stereo3d: side by side
  Stream #0:1: Audio: opus, 48000 Hz, mono, fltp
  Stream #0:2(ger): Audio: opus, 48000 Hz, mono, fltp
  Stream #0:3(ger): Subtitle: subrip
",
        );
        let (_, notes) = listing.choose(Vec::new).expect("a video");
        assert_eq!(listing.sound.as_deref(), Some("opus"));
        assert_eq!(
            notes,
            [
                ALPHA,
                "the pictures are marked as stereo (side by side): they are taken as they are stored",
                "the sound track 0:2 is left out",
                "the subtitles 0:3 are left out"
            ]
        );
        assert!(!listing.raw && Listing::parse("Input #0, mjpeg, from 'a.mjpeg':\n").raw);
    }

    #[test]
    fn files_without_a_video_are_refused_in_words() {
        let sound = "  Stream #0:0: Audio: mp3 (mp3float), 44100 Hz, mono, fltp, 64 kb/s\n";
        let cover = "  Stream #0:1: Video: png, rgb24(pc), 320x180, 90k tbr, 90k tbn (attached pic)\n";
        let tiles = "  Stream group #0:0[0x31]: Tile Grid: hevc (Main), yuvj420p(pc), 4032x3024 (default)\n    Stream #0:0[0x1]: Video: hevc (Main), yuvj420p(pc), 512x512, 1 fps, 1 tbr, 1 tbn (dependent)\n";
        for (text, expected) in [
            (sound.to_owned(), Some("expected a video, found sound alone")),
            (format!("{sound}{cover}"), Some("expected a video, found sound with a cover picture")),
            (cover.to_owned(), Some("expected a video, found a cover picture alone")),
            (tiles.to_owned(), Some("expected a video, found a picture put together of tiles (HEIC)")),
            // A file that ffmpeg cannot list causes an error when it decodes.
            (String::new(), None),
            (
                "Input #0, tty, from 'a.txt':\n  Stream #0:0: Video: ansi, pal8, 640x400, 25 fps, 25 tbr, 25 tbn\n"
                    .to_owned(),
                Some("expected a video, found a text file"),
            ),
            (RECORDER.to_owned(), None),
        ] {
            assert_eq!(Listing::parse(&text).refusal(), expected, "{text}");
        }
    }

    #[test]
    fn packets_are_counted_stream_by_stream() {
        let mut counter = Counter::default();
        let lines = "#software: Lavf59\n#tb 0: 1/1000\n#media_type 0: video\n#tb 1: 1/10\n0, 0, 40, 0, 61, 0xd, S=1\n0, 3, 0, 0, 5, 0x1, F=0x0, S=1\n0, -3, -40, 0, 5, 0x1, F=0x5\n1, 0, 0, 1, 9, 0x2\nrubbish\n1, 0, x\n7, 0, 0\n";
        lines.lines().for_each(|line| counter.add(line));
        let counts = counter.counts();
        assert_eq!((counts[0].frames, counts[1], counts.len()), (2, Count { frames: 1, ..Count::default() }, 2));
        assert!((counts[0].seconds - 0.04).abs() < 1e-12);
    }

    #[test]
    fn uneven_times_are_found_in_whatever_order_packets_come() {
        let count = |times: &[i64]| {
            let mut counter = Counter::default();
            counter.add("#tb 0: 1/1000");
            times.iter().for_each(|time| counter.add(&format!("0, 0, {time}, 41, 61, 0xd")));
            counter.counts()[0]
        };
        let even: Vec<i64> = (0..100).map(|i| (f64::from(i) / 0.024).round() as i64).collect();
        // Three frames are decoded before the one that is shown first.
        let reordered = |times: &[i64]| times.chunks(4).flat_map(|c| c.iter().rev().copied()).collect::<Vec<_>>();
        assert!(!count(&even).uneven && !count(&reordered(&even)).uneven);
        let mut late = even.clone();
        late[60] += 20;
        assert!(count(&late).uneven && count(&reordered(&late)).uneven);
        // A frame is missing near the end.
        let missing: Vec<i64> = even.iter().copied().filter(|time| *time != even[98]).collect();
        assert!(count(&missing).uneven);
        assert_eq!((count(&even).frames, count(&[]).uneven, count(&[5]).uneven), (100, false, false));
        let _ = count(&[i64::MAX, i64::MIN + 1, 0]);
    }

    proptest::proptest! {
        #[test]
        fn no_list_panics(text in "(  (Stream #0:|Duration: |start: |Video: |[0-9x():,\\[\\] ]|[a-z/]|\\PC){0,30}\n){0,4}") {
            let listing = Listing::parse(&text);
            let _ = (listing.refusal(), listing.choose(Vec::new).map(|(stream, _)| listing.frames(stream, None)));
        }
    }
}
