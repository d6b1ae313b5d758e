//! Properties of a video file, as `ffprobe` reads them.

use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use serde::Deserialize;

use super::url;

/// Most bytes that are read of ffprobe's answers: time stamps of two million frames.
const MAX_ANSWER: u64 = 64 << 20;
/// By how much two rates of a file may differ before its time stamps are looked at.
const SAME_RATE: f64 = 0.01;
/// Frames beyond which a file is not believed.
const MOST_FRAMES: f64 = 1e9;
/// How far from its place in a constant rate a frame may be shown, in frames.
const JITTER: f64 = 0.2;

/// The curve of a stream's samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Transfer {
    /// Any of standard dynamic range, which are told apart by nobody.
    #[default]
    Standard,
    /// Hybrid log-gamma (ARIB STD-B67, ITU-R BT.2100).
    Hlg,
    /// Perceptual quantiser (SMPTE ST 2084, ITU-R BT.2100).
    Pq,
}

/// The video stream, and what is beside it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Probe {
    /// Frames there may be, as the file says.
    pub(super) frames: Option<usize>,
    pub(super) transfer: Transfer,
    /// A pixel's width to its height, where it is not square.
    pub(super) aspect: Option<(u32, u32)>,
    /// True if the stream names its matrix and its primaries.
    pub(super) matrix: bool,
    pub(super) primaries: bool,
    /// Codec of the first sound track, in ffmpeg's names, if there is one.
    pub(super) sound: Option<String>,
    /// True if the pictures have an alpha plane.
    pub(super) alpha: bool,
    /// Seconds since the first frame, where frames do not follow each other at a constant rate.
    pub(super) times: Option<Vec<f64>>,
}

#[derive(Deserialize)]
struct Answer {
    #[serde(default)]
    streams: Vec<Stream>,
    #[serde(default)]
    format: Format,
}

#[derive(Deserialize)]
struct Stream {
    codec_type: Option<String>,
    codec_name: Option<String>,
    pix_fmt: Option<String>,
    sample_aspect_ratio: Option<String>,
    color_transfer: Option<String>,
    color_space: Option<String>,
    color_primaries: Option<String>,
    r_frame_rate: Option<String>,
    avg_frame_rate: Option<String>,
    nb_frames: Option<String>,
    duration: Option<String>,
}

#[derive(Default, Deserialize)]
struct Format {
    duration: Option<String>,
}

impl Probe {
    /// Properties found in the file; none where ffprobe is not installed or cannot read it, which ffmpeg will say.
    pub(super) fn of(path: &Path) -> Probe {
        let entries = "stream=codec_type,codec_name,pix_fmt,sample_aspect_ratio,color_transfer,color_space,color_primaries,r_frame_rate,avg_frame_rate,nb_frames,duration:format=duration";
        let answer = ask(path, ["-show_entries", entries, "-of", "json"]);
        let Some(Answer { streams, format: container }) = answer.and_then(|text| serde_json::from_str(&text).ok())
        else {
            return Probe::default();
        };
        let is = |stream: &&Stream, kind: &str| stream.codec_type.as_deref() == Some(kind);
        let sound = streams.iter().find(|stream| is(stream, "audio"));
        let sound = sound.map(|stream| stream.codec_name.clone().unwrap_or_default());
        let Some(video) = streams.iter().find(|stream| is(stream, "video")) else { return Probe::default() };
        let transfer = match video.color_transfer.as_deref() {
            Some("arib-std-b67") => Transfer::Hlg,
            Some("smpte2084") => Transfer::Pq,
            _ => Transfer::Standard,
        };
        let named = |name: &Option<String>| name.as_deref().is_some_and(|name| name != "unknown" && name != "reserved");
        let format = video.pix_fmt.as_deref().unwrap_or_default();
        let rates = [&video.r_frame_rate, &video.avg_frame_rate].map(|rate| rate.as_deref().and_then(ratio));
        let times = match rates {
            [Some(a), Some(b)] if (quotient(a) / quotient(b) - 1.0).abs() > SAME_RATE => times(path),
            _ => None,
        };
        // The stream's own count, or its length, or the file's, at the mean rate.
        let count = video.nb_frames.as_deref().and_then(|count| count.parse::<usize>().ok()).filter(|count| *count > 0);
        let seconds = video.duration.as_deref().or(container.duration.as_deref()).and_then(|text| text.parse().ok());
        let by_length = seconds.zip(rates[1]).map(|(seconds, rate): (f64, _)| seconds * quotient(rate));
        let by_length =
            by_length.filter(|count| (1.0..MOST_FRAMES).contains(count)).map(|count| count.round() as usize);
        Probe {
            frames: count.or(by_length),
            transfer,
            aspect: video.sample_aspect_ratio.as_deref().and_then(ratio).filter(|(w, h)| w != h),
            matrix: named(&video.color_space),
            primaries: named(&video.color_primaries),
            sound,
            // A GIF's says what stays from the frame before.
            alpha: video.codec_name.as_deref() != Some("gif") && has_alpha(format),
            times,
        }
    }
}

/// Returns true if pictures of this format, by ffmpeg's name, have an alpha plane.
fn has_alpha(format: &str) -> bool {
    ["yuva", "rgba", "bgra", "argb", "abgr", "gbrap", "ya8", "ya16"].iter().any(|start| format.starts_with(start))
}

/// Output of ffprobe.
fn ask<const N: usize>(path: &Path, arguments: [&str; N]) -> Option<String> {
    let mut command = Command::new("ffprobe");
    command.args(["-v", "error", "-protocol_whitelist", "file"]).args(arguments).args([OsStr::new("-i"), &url(path)]);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().ok()?;
    let mut text = String::new();
    let read = child.stdout.take().map(|out| out.take(MAX_ANSWER).read_to_string(&mut text));
    // One that has more to say than is read would wait for ever.
    let _ = child.kill();
    let _ = child.wait();
    matches!(read, Some(Ok(_))).then_some(text)
}

/// Of a text such as `30000/1001` or `4:3`; none where a part is 0.
fn ratio(text: &str) -> Option<(u32, u32)> {
    let (a, b) = text.split_once(['/', ':'])?;
    let (a, b) = (a.parse().ok()?, b.parse().ok()?);
    (a > 0 && b > 0).then_some((a, b))
}

fn quotient((a, b): (u32, u32)) -> f64 {
    f64::from(a) / f64::from(b)
}

/// The frames' time stamps, where they are no constant rate's.
fn times(path: &Path) -> Option<Vec<f64>> {
    let entries = ["-select_streams", "v:0", "-show_entries", "packet=pts_time,flags", "-of", "csv=p=0"];
    shown(&ask(path, entries)?)
}

/// Seconds since the first of the frames that ffprobe lists; none where they are no constant rate's.
fn shown(text: &str) -> Option<Vec<f64>> {
    let shown = text.lines().filter_map(|line| {
        let (time, flags) = line.split_once(',').unwrap_or((line, ""));
        // D: decoded for the sake of others, and not shown.
        (!flags.contains('D')).then(|| time.parse::<f64>().ok()).flatten()
    });
    let mut times: Vec<f64> = shown.filter(|time| time.is_finite()).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let (first, last) = (*times.first()?, *times.last()?);
    let step = (last - first) / (times.len() - 1).max(1) as f64;
    times.iter_mut().for_each(|time| *time -= first);
    let even = |(i, time): (usize, &f64)| (time - i as f64 * step).abs() <= JITTER * step;
    (times.len() > 2 && !times.iter().enumerate().all(even)).then_some(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_kept_where_they_are_uneven() {
        assert_eq!(shown("0.000000,K_\n0.066,__\n0.033,__\n0.100,__\n"), None);
        assert_eq!(
            shown("1.0,K__\n1.1,___\n1.2,_D_\n1.9,___\n1.2,___\n"),
            Some(vec![0.0, 1.1 - 1.0, 1.2 - 1.0, 1.9 - 1.0])
        );
        assert_eq!(shown(""), None);
        assert_eq!(shown("N/A,K\nx\n"), None);
    }

    #[test]
    fn ratios_are_read_and_zeros_are_none() {
        assert_eq!(
            [ratio("30000/1001"), ratio("4:3"), ratio("0:1"), ratio("0/0"), ratio("N/A")],
            [Some((30000, 1001)), Some((4, 3)), None, None, None]
        );
    }
}
