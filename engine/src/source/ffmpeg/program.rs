//! Calls of the `ffmpeg` program: local files only, with bounded output.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::streams::{Count, Counter};

/// Maximum bytes read of a stream list.
const MAX_LIST: u64 = 1 << 20;

/// Returns the file as an argument for ffmpeg. A name that starts with a dash or contains a colon must not be read as
/// an option or a protocol.
pub(super) fn url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// Builds an ffmpeg command with this verbosity and the file as its input. A playlist may name other files, but none on
/// a network.
fn ffmpeg(path: &Path, verbosity: &str, options: &[&str]) -> Command {
    let mut command = Command::new("ffmpeg");
    command.args(["-nostdin", "-nostats", "-hide_banner", "-v", verbosity, "-protocol_whitelist", "file"]);
    command.args(options).arg("-i").arg(url(path)).stdin(Stdio::null());
    command
}

/// Returns ffmpeg's list of a file's streams.
pub(super) fn list(path: &Path) -> std::io::Result<String> {
    let mut child = ffmpeg(path, "info", &[]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn()?;
    let mut bytes = Vec::new();
    let read = child.stderr.take().map(|err| err.take(MAX_LIST).read_to_end(&mut bytes));
    // ffmpeg would block on the pipe if it printed more than the limit.
    let _ = child.kill();
    let _ = child.wait();
    read.transpose()?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Counts the frames of these streams without decoding them.
pub(super) fn count(path: &Path, streams: &[usize]) -> Vec<(usize, Count)> {
    let mut command = ffmpeg(path, "quiet", &[]);
    streams.iter().for_each(|stream| _ = command.args(["-map", &format!("0:{stream}")]));
    let child =
        command.args(["-c", "copy", "-f", "framecrc", "-"]).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
    let Ok(mut child) = child else { return Vec::new() };
    let mut counter = Counter::default();
    if let Some(out) = child.stdout.take() {
        let mut out = BufReader::new(out);
        let mut line = Vec::new();
        while let Ok(1..) = Read::by_ref(&mut out).take(4096).read_until(b'\n', &mut line) {
            counter.add(String::from_utf8_lossy(&line).trim_end());
            line.clear();
        }
    }
    let _ = child.wait();
    streams.iter().copied().zip(counter.counts()).collect()
}

/// Parameters of decoding a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Decoding {
    /// The stream, in the form of `-map`.
    pub(super) stream: String,
    pub(super) filters: Vec<String>,
    /// True to decode incomplete or corrupted packets too.
    pub(super) parts: bool,
    /// True for versions before 5.1, where the options have other names.
    pub(super) old: bool,
}

impl Decoding {
    /// Starts ffmpeg, which decodes to y4m on its standard output and writes the messages for [`super::shown::Message`]
    /// to its standard error. Every frame is passed once. The first filter prints the times.
    pub(super) fn start(&self, path: &Path) -> std::io::Result<Child> {
        let parts: &[&str] = if self.parts { &[] } else { &["-fflags", "+discardcorrupt"] };
        let sync = if self.old { "-vsync" } else { "-fps_mode" };
        ffmpeg(path, "repeat+level+info", parts)
            .args(["-map", &self.stream, "-vf", &format!("showinfo=checksum=0,{}", self.filters.join(","))])
            .args([
                "-sws_flags",
                "+accurate_rnd+bitexact",
                sync,
                "passthrough",
                "-strict",
                "-1",
                "-f",
                "yuv4mpegpipe",
                "-",
            ])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
    }
}

/// Returns at most `most` bytes of a stream through an ffmpeg filter, as raw video; empty if it fails.
pub(super) fn samples(path: &Path, stream: &str, filter: &str, frames: usize, most: usize) -> Vec<u8> {
    let child = ffmpeg(path, "quiet", &[])
        .args(["-map", stream, "-vf", filter, "-frames:v", &frames.to_string(), "-f", "rawvideo", "-"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let Ok(mut child) = child else { return Vec::new() };
    let mut bytes = Vec::new();
    let read = child.stdout.take().map(|out| out.take(most as u64).read_to_end(&mut bytes));
    let _ = child.kill();
    let _ = child.wait();
    if let Some(Ok(_)) = read { bytes } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ffmpeg_opens_files_and_nothing_else() {
        let command = ffmpeg(Path::new("clip.mp4"), "quiet", &["-ss", "1"]);
        let words: Vec<_> = command.get_args().map(|word| word.to_string_lossy().into_owned()).collect();
        let place = |word: &str| words.iter().position(|other| other == word).expect("the option");
        // An input option must come before the input's name.
        let (list, input) = (place("-protocol_whitelist"), place("-i"));
        assert_eq!(words[list + 1], "file");
        assert!(list < input && words[input + 1] == "file:clip.mp4");
    }
}
