//! Checks that a file written by ffmpeg is complete: it has its trailer and as many frames as were written.
//!
//! The exit code does not suffice: ffmpeg 5.1 exits with 0 after the error that no space is left.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::process::Stdio;

use super::encode::{ffmpeg, first_line, url};

/// Returns an error unless the file `path` of this kind holds `frames` frames.
pub(super) fn whole(path: &Path, kind: &str, frames: usize) -> Result<(), String> {
    let unreadable = |e: std::io::Error| e.to_string();
    match kind {
        // ffmpeg 5.1 cannot read it. In WebP repeated frames extend the duration of the first of them.
        "webp" => {
            let found = webp_frames(path).map_err(unreadable)?;
            return match found {
                Some(found) if (1..=frames).contains(&found) => Ok(()),
                _ => Err(format!("expected at most {frames} frames in the file it wrote, found {}", shown(found))),
            };
        }
        "gif" if !ends_in(path, 0x3B).map_err(unreadable)? => return Err(no_end()),
        "matroska" | "webm" if !segment_is_whole(path).map_err(unreadable)? => return Err(no_end()),
        _ => {}
    }
    let answer = ffmpeg()
        .args(["-protocol_whitelist", "file", "-i"])
        .arg(url(path))
        .args(["-map", "0:v", "-c", "copy", "-f", "framecrc", "-"])
        .stdin(Stdio::null())
        .output()
        .map_err(unreadable)?;
    let said = first_line(&String::from_utf8_lossy(&answer.stderr));
    if let Some(said) = said.filter(|_| !answer.status.success()) {
        return Err(format!("the file it wrote: {said}"));
    }
    let found = most_packets(&String::from_utf8_lossy(&answer.stdout));
    if found == frames { Ok(()) } else { Err(format!("expected {frames} frames in the file it wrote, found {found}")) }
}

fn shown(found: Option<usize>) -> String {
    found.map_or("a file that is cut".to_owned(), |found| found.to_string())
}

fn no_end() -> String {
    "expected a whole file, found one without its end".to_owned()
}

/// The largest number of packets of a stream, in a list whose lines begin with the stream's number. An animated AVIF
/// has its first picture as a separate stream.
fn most_packets(list: &str) -> usize {
    let mut counts = std::collections::BTreeMap::<&str, usize>::new();
    for line in list.lines().filter(|line| !line.starts_with('#')) {
        *counts.entry(line.split(',').next().unwrap_or_default()).or_default() += 1;
    }
    counts.into_values().max().unwrap_or(0)
}

fn ends_in(path: &Path, byte: u8) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    if file.metadata()?.len() == 0 {
        return Ok(false);
    }
    let mut last = [0];
    file.seek(SeekFrom::End(-1))?;
    file.read_exact(&mut last)?;
    Ok(last == [byte])
}

/// Number of frames in a WebP file; `None` if its length does not match its header and chunks.
fn webp_frames(path: &Path) -> std::io::Result<Option<usize>> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut head = [0; 12];
    if length < 12 {
        return Ok(None);
    }
    file.read_exact(&mut head)?;
    let said = 8 + u64::from(u32::from_le_bytes([head[4], head[5], head[6], head[7]]));
    if !head.starts_with(b"RIFF") || head[8..] != *b"WEBP" || said != length {
        return Ok(None);
    }
    let (mut at, mut still, mut moving) = (12, 0, 0);
    while at + 8 <= length {
        let mut chunk = [0; 8];
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(&mut chunk)?;
        match &chunk[..4] {
            b"ANMF" => moving += 1,
            b"VP8 " | b"VP8L" => still = 1,
            _ => {}
        }
        at += 8 + u64::from(u32::from_le_bytes([chunk[4], chunk[5], chunk[6], chunk[7]])).next_multiple_of(2);
    }
    Ok((at == length).then_some(if moving > 0 { moving } else { still }))
}

/// Returns true if a Matroska file's segment has a length, which its writer fills in at the end, and is that long.
fn segment_is_whole(path: &Path) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut head = Vec::new();
    file.by_ref().take(1 << 12).read_to_end(&mut head)?;
    // EBML's head, whose id has four bytes, then the segment's id and length.
    let header = head.get(4..).and_then(ebml_length);
    let segment =
        header.and_then(|(bytes, width)| 4_usize.checked_add(width)?.checked_add(usize::try_from(bytes).ok()?));
    let Some(at) = segment.filter(|at| head.get(*at..at + 4) == Some(&[0x18, 0x53, 0x80, 0x67])) else {
        return Ok(false);
    };
    let said = head.get(at + 4..).and_then(ebml_length);
    Ok(said.is_some_and(|(bytes, width)| bytes.checked_add((at + 4 + width) as u64) == Some(length)))
}

/// A length and its number of bytes; `None` for an unknown length.
fn ebml_length(bytes: &[u8]) -> Option<(u64, usize)> {
    let width = bytes.first()?.leading_zeros() as usize + 1;
    let field = bytes.get(..width).filter(|_| width <= 8)?;
    let all = field.iter().fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte));
    let mask = (1_u64 << (7 * width)) - 1;
    (all & mask != mask).then_some((all & mask, width))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(bytes: &[u8]) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::write(file.path(), bytes).expect("writable");
        file
    }

    #[test]
    fn packets_of_the_longest_stream_count() {
        assert_eq!(most_packets("#tb 0: 1/24\n0, 0, 0\n1, 0, 0\n1, 1, 1\n"), 2);
        assert_eq!(most_packets(""), 0);
    }

    #[test]
    fn a_webp_that_is_cut_has_no_frames() {
        let mut bytes = b"RIFF\x16\0\0\0WEBPANMF\x02\0\0\0abVP8 \0\0\0\0".to_vec();
        bytes[4] = (bytes.len() - 8) as u8;
        assert_eq!(webp_frames(file(&bytes).path()).expect("readable"), Some(1));
        for cut in 0..bytes.len() {
            assert_eq!(webp_frames(file(&bytes[..cut]).path()).expect("readable"), None, "{cut}");
        }
    }

    #[test]
    fn a_segment_without_its_length_is_not_whole() {
        let ebml = [0x1A, 0x45, 0xDF, 0xA3, 0x82, 1, 2];
        let of = |length: &[u8], content: &[u8]| {
            let bytes = [&ebml[..], &[0x18, 0x53, 0x80, 0x67], length, content].concat();
            segment_is_whole(file(&bytes).path()).expect("readable")
        };
        assert!(of(&[0x83], &[1, 2, 3]) && of(&[0x40, 3], &[1, 2, 3]));
        assert!(!of(&[0x83], &[1, 2]) && !of(&[0x01, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF], &[1, 2, 3]));
        assert!(!segment_is_whole(file(&ebml).path()).expect("readable"));
        assert!(
            !ends_in(file(b"").path(), 0x3B).expect("readable") && ends_in(file(b"a;").path(), 0x3B).expect("readable")
        );
    }
}
