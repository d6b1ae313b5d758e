//! Adds the source's sound to the encoded pictures.

use std::path::Path;
use std::process::Stdio;

use super::encode::{container, ffmpeg, first_line, is_encoded, url};
use crate::output::storage;
use crate::source::Sound;

/// Returns true if video files of this name get the source's sound, if it has any.
pub fn holds_sound(path: &Path) -> bool {
    is_encoded(path) && !["gif", "webp", "avif"].contains(&&container(path)[..])
}

/// The encoder of sound for a kind of file: `copy` where the kind supports the codec.
fn encoder(kind: &str, codec: &str) -> &'static str {
    match kind {
        "webm" if ["opus", "vorbis"].contains(&codec) => "copy",
        "webm" => "libopus",
        "mp4" | "mov" if !["aac", "mp3", "ac3", "eac3", "alac"].contains(&codec) => "aac",
        _ => "copy",
    }
}

impl Sound {
    /// Replaces the file `pictures` of this kind by one with `seconds` of the sound as well. If the file is written but
    /// ffmpeg printed a message, returns that message: it is about faults of the sound.
    pub(super) fn join(&self, pictures: &Path, kind: &str, seconds: f64) -> Result<Option<String>, String> {
        let joined = pictures.with_extension("sound.partial");
        storage::create(&joined).map_err(|e| e.to_string())?;
        let mut command = ffmpeg();
        command.args(["-y", "-i"]).arg(url(pictures));
        if self.start > 0.0 {
            command.args(["-ss", &self.start.to_string()]);
        }
        command.args(["-t", &seconds.to_string(), "-protocol_whitelist", "file", "-i"]).arg(url(&self.file));
        command.args(["-map", "0:v:0", "-map", "1:a:0", "-c:v", "copy", "-c:a", encoder(kind, &self.codec)]);
        // The input's limit counts from the sound's own start, which may be later than that of the pictures.
        command.args(["-t", &seconds.to_string(), "-f", kind]);
        let ended = command.arg(url(&joined)).stdin(Stdio::null()).stdout(Stdio::null()).output();
        let named = ended.map_err(|e| e.to_string()).and_then(|ended| {
            let said = first_line(&String::from_utf8_lossy(&ended.stderr));
            if !ended.status.success() {
                let said = said.unwrap_or_else(|| "it gives no reason".into());
                return Err(format!("{said} (the sound; --no-audio leaves it out)"));
            }
            #[cfg(test)]
            storage::faults::foreign(&joined).map_err(|e| e.to_string())?;
            storage::rename(&joined, pictures).map_err(|e| e.to_string())?;
            Ok(said.map(|said| format!("the sound: {said}")))
        });
        if named.is_err() {
            let _ = storage::remove(&joined);
        }
        named
    }
}
