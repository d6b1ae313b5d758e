//! Any video file, through an installed `ffmpeg` program that writes y4m into a pipe.
//!
//! ffmpeg decodes and applies the file's rotation. Frames that do not follow each other at a constant rate keep their own times. Pixels that are
//! not square are made so, by enlarging. High dynamic range (HLG, PQ) becomes BT.709 of standard range: display light of 203 cd/m² is white
//! (ITU-R BT.2408) and what is brighter is rolled off, or 100 cd/m² where a video has hardly anything brighter. What was done to the
//! pictures, and what is left out of the file, [`Ffmpeg::notes`] says. Conversion to RGB is ours ([`super::y4m::convert`]). Decoders differ between versions
//! of ffmpeg, so equal digests of a run need equal ffmpeg output; the input digest in `run.json` tells.

mod probe;

use std::ffi::OsString;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use super::SourceError;
use super::y4m::{Header, Y4m};
use crate::output::Sound;
use crate::picture::Picture;
use probe::{Probe, Transfer};

/// Formats of pictures that [`Y4m`] reads, in ffmpeg's names; it takes the one nearest to the file's own.
const FORMATS: &str = "format=pix_fmts=yuv420p|yuv422p|yuv444p|yuvj420p|yuvj422p|yuvj444p|yuv411p|gray|yuv420p10|yuv422p10|yuv444p10|yuv420p12|yuv422p12|yuv444p12";
/// Light of white in standard range where a video goes beyond it, and where it does not, in cd/m².
const WHITE: [u32; 2] = [203, 100];
/// Samples of which one may be brighter than [`WHITE`]'s second.
const RARE: usize = 500;
/// Frames that are looked at for it, one a second, and their size.
const LOOKED_AT: (usize, usize) = (20, 64 * 36);

/// A video file being decoded by ffmpeg.
pub struct Ffmpeg {
    child: Child,
    y4m: Y4m<BufReader<ChildStdout>>,
    messages: Option<JoinHandle<String>>,
    path: PathBuf,
    times: Option<Vec<f64>>,
    notes: Vec<String>,
    sound: Option<String>,
    frames: Option<usize>,
}

/// The file as ffmpeg takes it: a name that starts with a dash or holds a colon must not be taken as an option or a protocol.
fn url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

impl Ffmpeg {
    /// Starts ffmpeg on the file and reads the stream's header.
    ///
    /// # Errors
    /// ffmpeg is not installed, or cannot read the file.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let mut probe = Probe::of(path);
        let mut notes = Vec::new();
        let mut filters = Vec::new();
        if let Some((width, height)) = probe.aspect {
            filters.push("scale=if(gt(sar\\,1)\\,round(iw*sar)\\,iw):if(gt(sar\\,1)\\,ih\\,round(ih/sar)):flags=bicubic+accurate_rnd,setsar=1".to_owned());
            notes.push(format!("pixels of {width}:{height} were made square"));
        }
        if let Some((filter, note)) = to_standard(path, &probe) {
            filters.push(filter);
            notes.push(note);
        }
        filters.push(FORMATS.to_owned());
        if probe.alpha {
            notes.push("the alpha plane is left out".to_owned());
        }
        let times = probe.times.take();
        let passthrough: &[&str] = if times.is_some() { &["-fps_mode", "passthrough"] } else { &[] };
        let child = Command::new("ffmpeg")
            // A playlist may name other files, but nothing on a network.
            .args(["-nostdin", "-v", "error", "-protocol_whitelist", "file", "-i"])
            .arg(url(path))
            .args(["-map", "0:v:0", "-vf", &filters.join(","), "-sws_flags", "+accurate_rnd+bitexact"])
            .args(passthrough)
            .args(["-strict", "-1", "-f", "yuv4mpegpipe", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = match child {
            Ok(child) => child,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                return Err(SourceError::NoFfmpeg { path: path.to_owned() });
            }
            Err(e) => return Err(SourceError::Ffmpeg { path: path.to_owned(), cause: e.to_string() }),
        };
        let pipe_error = || SourceError::Ffmpeg { path: path.to_owned(), cause: "no pipe to it".into() };
        let stdout = child.stdout.take().ok_or_else(pipe_error)?;
        let mut stderr = child.stderr.take().ok_or_else(pipe_error)?;
        // Read beside the frames, or a full pipe of messages would stop both.
        let messages = std::thread::spawn(move || {
            let mut text = Vec::new();
            let mut block = [0; 4096];
            while let Ok(n @ 1..) = stderr.read(&mut block) {
                if text.len() < 16 * block.len() {
                    text.extend_from_slice(&block[..n]);
                }
            }
            String::from_utf8_lossy(&text).into_owned()
        });
        match Y4m::new(BufReader::with_capacity(1 << 16, stdout), path) {
            Ok(y4m) => {
                let (path, sound) = (path.to_owned(), probe.sound.take());
                Ok(Ffmpeg { child, y4m, messages: Some(messages), path, times, notes, sound, frames: probe.frames })
            }
            Err(e) => {
                let _ = child.kill();
                let failed = child.wait().is_ok_and(|status| !status.success());
                let text = messages.join().unwrap_or_default();
                if is_text(path) {
                    let cause = "expected a video, found a text file".to_owned();
                    Err(SourceError::Decode { path: path.to_owned(), cause })
                } else if !text.trim().is_empty() || failed {
                    Err(SourceError::Ffmpeg { path: path.to_owned(), cause: first_line(&text, path) })
                } else {
                    Err(e)
                }
            }
        }
    }

    /// Parameters of the stream.
    pub fn header(&self) -> &Header {
        self.y4m.header()
    }

    /// The file's first sound track, if it has one.
    pub fn sound(&self) -> Option<Sound> {
        let codec = self.sound.clone()?;
        Some(Sound { file: self.path.clone(), codec, start: 0.0 })
    }

    /// Frames there may be, as the file says.
    pub fn expected_frames(&self) -> Option<usize> {
        self.times.as_ref().map(Vec::len).or(self.frames)
    }

    /// Conversions of the pictures and parts of the file that are left out, a line each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Seconds from the first frame to the last and the number of frames, where they do not follow each other at a constant rate.
    pub fn uneven(&self) -> Option<(f64, usize)> {
        self.times.as_ref().and_then(|times| Some((*times.last()?, times.len())))
    }

    /// When frame `index` is shown, in seconds since the first, where frames do not follow each other at a constant rate.
    pub fn time(&self, index: usize) -> Option<f64> {
        let times = self.times.as_ref()?;
        let (last, before) = (times[times.len() - 1], times[times.len() - 2]);
        // A frame that the file did not announce follows as the last one did.
        let after = |past: usize| last + (past + 1) as f64 * (last - before);
        Some(times.get(index).copied().unwrap_or_else(|| after(index - times.len())))
    }

    /// The next frame; `None` at the end of the video.
    ///
    /// # Errors
    /// A frame that cannot be read, or a failure ffmpeg reports at the end.
    pub fn next_picture(&mut self) -> Result<Option<Picture>, SourceError> {
        if let Some(picture) = self.y4m.next_picture()? {
            return Ok(Some(picture));
        }
        let status = self.child.wait().map_err(SourceError::read(&self.path))?;
        let text = self.messages.take().map(|thread| thread.join().unwrap_or_default()).unwrap_or_default();
        if status.success() {
            Ok(None)
        } else {
            Err(SourceError::Ffmpeg { path: self.path.clone(), cause: first_line(&text, &self.path) })
        }
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // Stopped early, it would wait for ever on a full pipe.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The first line of ffmpeg's messages that says something, without the file's name in front.
fn first_line(text: &str, path: &Path) -> String {
    let name = format!("file:{}: ", path.display());
    let line = text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("no reason given");
    line.strip_prefix(&name).unwrap_or(line).to_owned()
}

/// Returns true if a file begins as text.
fn is_text(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(4096).read_to_end(&mut start));
    // The last character may be cut.
    let text = match std::str::from_utf8(&start) {
        Ok(text) => text,
        Err(e) if e.error_len().is_none() => std::str::from_utf8(&start[..e.valid_up_to()]).unwrap_or_default(),
        Err(_) => return false,
    };
    read.is_ok() && !text.is_empty() && !text.chars().any(|c| c.is_control() && !c.is_whitespace())
}

/// The filter that brings high dynamic range to BT.709, and what it did.
fn to_standard(path: &Path, probe: &Probe) -> Option<(String, String)> {
    let (name, curve, white) = match probe.transfer {
        Transfer::Standard => return None,
        Transfer::Hlg => ("HLG", "arib-std-b67", hlg(f64::from(WHITE[1]))),
        Transfer::Pq => ("PQ", "smpte2084", pq(f64::from(WHITE[1]))),
    };
    let bright = looks_brighter(path, white);
    let light = WHITE[usize::from(!bright)];
    let matrix = if probe.matrix { "" } else { ":min=2020_ncl" };
    let primaries = if probe.primaries { "" } else { ":pin=2020" };
    let roll = if bright { format!("tonemap=mobius:param=0.8:desat=0:peak={},", 1000 / light) } else { String::new() };
    let filter = format!(
        "zscale=tin={curve}{matrix}{primaries}:t=linear:npl={light},format=gbrpf32le,zscale=p=bt709,{roll}zscale=t=bt709:m=bt709:r=tv,format=yuv444p10"
    );
    Some((filter, format!("{name} was converted to BT.709 of standard range, white at {light} cd/m²")))
}

/// The sample of HLG, 0 to 1, that a display of 1000 cd/m² shows as grey of `light` cd/m².
fn hlg(light: f64) -> f64 {
    let scene = (light / 1000.0).powf(1.0 / 1.2);
    if scene <= 1.0 / 12.0 {
        (3.0 * scene).sqrt()
    } else {
        0.178_832_77 * (12.0 * scene - 0.284_668_92).ln() + 0.559_910_73
    }
}

/// The sample of PQ, 0 to 1, of `light` cd/m².
fn pq(light: f64) -> f64 {
    let y = (light / 10_000.0).powf(2610.0 / 16384.0);
    let (c1, c2, c3) = (3424.0 / 4096.0, 2413.0 / 128.0, 2392.0 / 128.0);
    ((c1 + c2 * y) / (1.0 + c3 * y)).powf(2523.0 / 32.0)
}

/// Returns true if more than one sample of luma in [`RARE`] is above `white`, 0 to 1 of the limited range.
fn looks_brighter(path: &Path, white: f64) -> bool {
    let (frames, size) = LOOKED_AT;
    let answer = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-protocol_whitelist", "file", "-i"])
        .arg(url(path))
        .args([
            "-map",
            "0:v:0",
            "-vf",
            "fps=1:round=up,scale=64:36:flags=area:in_range=tv:out_range=tv,format=gray16le",
        ])
        .args(["-frames:v", &frames.to_string(), "-f", "rawvideo", "-"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output();
    let samples = answer.map(|answer| answer.stdout).unwrap_or_default();
    let most = 2 * size * frames;
    // Limited range, 16 to 235 of 255, three hundredths above white for rounding and ringing.
    let threshold = (16.0 + 219.0 * (1.03 * white)) * 256.0;
    let (words, _) = samples[..samples.len().min(most)].as_chunks::<2>();
    let bright = words.iter().filter(|word| f64::from(u16::from_le_bytes(**word)) > threshold).count();
    bright * RARE > words.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_of_high_dynamic_range_have_the_values_of_their_standards() {
        // ITU-R BT.2408, table 1: white of 203 cd/m² is 75 % of HLG and 58 % of PQ.
        assert!((hlg(203.0) - 0.75).abs() < 0.005 && (pq(203.0) - 0.58).abs() < 0.005, "{} {}", hlg(203.0), pq(203.0));
        assert!((hlg(1000.0) - 1.0).abs() < 1e-6 && (pq(10_000.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn text_is_told_from_other_bytes() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.mp4");
        for (bytes, expected) in [
            (&b"Dear diary,\n\t\xc3\xa9\xc3"[..], true),
            (b"\0\0\0\x18ftypmp42", false),
            (b"", false),
            (b"\xff\xfe", false),
        ] {
            std::fs::write(&path, bytes).expect("writable");
            assert_eq!(is_text(&path), expected, "{bytes:?}");
        }
    }
}
