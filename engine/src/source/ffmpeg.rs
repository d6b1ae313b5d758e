//! Any video file, through an installed `ffmpeg` program that writes y4m into a pipe.
//!
//! ffmpeg decodes; it keeps the frame rate constant (frames of a variable-rate file are repeated or left out so that the
//! times are right) and applies the file's rotation. Colour conversion is ours ([`super::y4m::convert`]). Decoders differ
//! between versions of ffmpeg, so equal digests of a run need equal ffmpeg output; the input digest in `run.json` tells.

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use super::SourceError;
use super::y4m::{Header, Y4m};
use crate::picture::Picture;

/// A video file being decoded by ffmpeg.
pub struct Ffmpeg {
    child: Child,
    y4m: Y4m<BufReader<ChildStdout>>,
    messages: Option<JoinHandle<String>>,
    path: PathBuf,
}

impl Ffmpeg {
    /// Starts ffmpeg on the file and reads the stream's header.
    ///
    /// # Errors
    /// ffmpeg is not installed, or cannot read the file.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        // A name that starts with a dash or holds a colon must not be taken as an option or a protocol.
        let mut url = std::ffi::OsString::from("file:");
        url.push(path);
        let child = Command::new("ffmpeg")
            // A playlist may name other files, but nothing on a network.
            .args(["-nostdin", "-v", "error", "-protocol_whitelist", "file", "-i"])
            .arg(url)
            .args(["-map", "0:v:0", "-sws_flags", "+accurate_rnd+bitexact"])
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
            Ok(y4m) => Ok(Ffmpeg { child, y4m, messages: Some(messages), path: path.to_owned() }),
            Err(e) => {
                let _ = child.kill();
                let failed = child.wait().is_ok_and(|status| !status.success());
                let text = messages.join().unwrap_or_default();
                if !text.trim().is_empty() || failed {
                    Err(SourceError::Ffmpeg { path: path.to_owned(), cause: first_line(&text, path) })
                } else {
                    Err(e)
                }
            }
        }
    }

    /// What the stream says about itself.
    pub fn header(&self) -> &Header {
        self.y4m.header()
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
