//! Check that a file is as long as its container declares.
//!
//! ffmpeg does not report every truncated file. If the cut is between two packets, or the container can be read up to
//! any position, there are fewer frames and the exit status is 0. This module checks the container's own declaration:
//!
//! | container | check |
//! |---|---|
//! | MP4, QuickTime | the sizes of the outermost boxes |
//! | Matroska, WebM | the size of the segment |
//! | AVI | the sizes of the outermost chunks |
//! | FLV | `filesize` of its metadata |
//! | Ogg | the flag of the last page |
//! | GIF | the trailer |
//!
//! Sizes that are left open, as in live recordings, are not checked. MPEG streams declare nothing.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Outermost boxes of MP4 and QuickTime. Other data may follow them.
const BOXES: [&[u8; 4]; 14] = [
    b"ftyp", b"styp", b"moov", b"mdat", b"free", b"skip", b"wide", b"moof", b"mfra", b"sidx", b"uuid", b"meta",
    b"pnot", b"udta",
];
/// Maximum size of an Ogg page, in bytes.
const PAGE: u64 = 65_307;
/// Bytes at the beginning of an FLV file that hold its metadata.
const METADATA: u64 = 1 << 16;

/// Describes the missing part; `None` if the file is whole or its container declares no length.
pub(super) fn missing(path: &Path) -> Option<String> {
    let mut file = File::open(path).ok()?;
    let length = file.metadata().ok().filter(std::fs::Metadata::is_file)?.len();
    let start = bytes(&mut file, 0, 64)?;
    let declared = match start.get(..4)? {
        b"RIFF" => chunks(&mut file, length),
        b"OggS" => return last_page(&mut file, length),
        b"GIF8" => return trailer(file),
        b"\x1a\x45\xdf\xa3" => segment(&start),
        b"FLV\x01" => filesize(&bytes(&mut file, 0, METADATA)?),
        _ if BOXES.iter().any(|name| start.get(4..8) == Some(&name[..])) => boxes(&mut file, length),
        _ => None,
    }?;
    (declared > length).then(|| format!("the file is cut off: expected {declared} bytes, found {length}"))
}

/// Reads at most `count` bytes from offset `at`.
fn bytes(file: &mut File, at: u64, count: u64) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(at)).ok()?;
    file.take(count).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// Returns the end of the first outermost box that extends past the file's end, or else of the last box.
fn boxes(file: &mut File, length: u64) -> Option<u64> {
    let mut at = 0_u64;
    while at < length {
        let head = bytes(file, at, 16)?;
        let name = head.get(4..8)?;
        if !BOXES.iter().any(|known| name == &known[..]) {
            break;
        }
        let size = match u32::from_be_bytes(*head.first_chunk()?) {
            // The box extends to the end of the file.
            0 => break,
            1 => u64::from_be_bytes(head.get(8..16)?.try_into().ok()?),
            size => u64::from(size),
        };
        at = at.checked_add(size.max(8))?;
    }
    Some(at)
}

/// Returns the end of the first outermost chunk of an AVI file that extends past the file's end, or else of the last.
fn chunks(file: &mut File, length: u64) -> Option<u64> {
    let mut at = 0_u64;
    while at < length {
        let head = bytes(file, at, 12)?;
        if head.get(..4)? != b"RIFF" || !head.get(8..)?.starts_with(b"AVI") {
            break;
        }
        match u32::from_le_bytes(head.get(4..8)?.try_into().ok()?) {
            0 | u32::MAX => return None,
            // The padding byte of an odd chunk may be missing.
            size => at = at.checked_add(8 + u64::from(size))?,
        }
        at += u64::from(at % 2 == 1 && at < length);
    }
    Some(at)
}

/// Returns the declared end of a Matroska file's segment, from EBML's header and the segment's; each is an identifier
/// and a length of variable size.
fn segment(start: &[u8]) -> Option<u64> {
    let (head, at) = variable(start, 4)?;
    let at = at.checked_add(usize::try_from(head?).ok()?)?;
    if start.get(at..at + 4)? != b"\x18\x53\x80\x67" {
        return None;
    }
    let (size, at) = variable(start, at + 4)?;
    size?.checked_add(at as u64)
}

/// Reads the variable-length number at `at`. Returns it, `None` if it is unknown, and the index after it.
fn variable(bytes: &[u8], at: usize) -> Option<(Option<u64>, usize)> {
    let first = *bytes.get(at)?;
    let count = first.leading_zeros() as usize + 1;
    let rest = bytes.get(at + 1..at + count)?;
    let mask = (1_u64 << (7 * count)) - 1;
    let number = rest.iter().fold(u64::from(first), |number, &byte| number << 8 | u64::from(byte)) & mask;
    Some(((number != mask).then_some(number), at + count))
}

/// Returns the number `filesize` of an FLV file's metadata.
fn filesize(start: &[u8]) -> Option<u64> {
    const NAME: &[u8] = b"\x00\x08filesize\x00";
    let at = start.windows(NAME.len()).position(|word| word == NAME)? + NAME.len();
    let size = f64::from_be_bytes(start.get(at..at + 8)?.try_into().ok()?);
    // `as` saturates.
    (size > 0.0).then_some(size as u64)
}

/// Checks that the last page ends one of the streams.
fn last_page(file: &mut File, length: u64) -> Option<String> {
    let end = bytes(file, length.saturating_sub(2 * PAGE), 2 * PAGE)?;
    let at = end.windows(4).rposition(|word| word == b"OggS")?;
    let ends = end.get(at + 5).is_some_and(|flags| flags & 4 != 0);
    // A page has 26 bytes, the number of lengths, the lengths, and the data.
    let size = || {
        let segments = usize::from(*end.get(at + 26)?);
        let lengths = end.get(at + 27..at + 27 + segments)?;
        Some(27 + segments + lengths.iter().map(|&length| usize::from(length)).sum::<usize>())
    };
    let whole = size().is_some_and(|size| at + size <= end.len());
    (!ends || !whole)
        .then(|| format!("the file is cut off: expected a page that ends the stream, found none in {length} bytes"))
}

/// Checks that a GIF file ends in a trailer after its blocks.
fn trailer(file: File) -> Option<String> {
    let length = file.metadata().ok()?.len();
    let mut reader = BufReader::new(file);
    reader.seek(SeekFrom::Start(0)).ok()?;
    let whole = ends_in_trailer(&mut reader).unwrap_or(false);
    (!whole).then(|| format!("the file is cut off: expected a trailer, found none in {length} bytes"))
}

/// Returns `None` if the file ends too early.
fn ends_in_trailer(reader: &mut (impl Read + Seek)) -> Option<bool> {
    let byte = |reader: &mut dyn Read| {
        let mut byte = [0];
        reader.read_exact(&mut byte).ok().map(|()| byte[0])
    };
    let skip = |reader: &mut dyn Read, count: u64| {
        std::io::copy(&mut Read::take(reader, count), &mut std::io::sink()).ok().filter(|skipped| *skipped == count)
    };
    let colours = |packed: u8| if packed & 0x80 == 0 { 0 } else { 3 << ((packed & 7) + 1) };
    let mut head = [0; 13];
    reader.read_exact(&mut head).ok()?;
    skip(reader, colours(head[10]))?;
    loop {
        match byte(reader)? {
            0x3b => return Some(true),
            0x21 => _ = byte(reader)?,
            0x2c => {
                let mut image = [0; 9];
                reader.read_exact(&mut image).ok()?;
                // The colours, and the minimum code size.
                skip(reader, colours(image[8]) + 1)?;
            }
            // Padding between blocks.
            0x00 => continue,
            _ => return Some(false),
        }
        loop {
            match byte(reader)? {
                0 => break,
                count => _ = skip(reader, u64::from(count))?,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the prefix lengths at which a file counts as whole.
    fn whole_at(file: &[u8]) -> Vec<usize> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a");
        let lengths = (0..=file.len()).filter(|&length| {
            std::fs::write(&path, &file[..length]).expect("writable");
            missing(&path).is_none()
        });
        // Shorter prefixes may not be recognised as this container.
        lengths.filter(|&length| length >= 40).collect()
    }

    fn mp4_box(name: &[u8; 4], body: &[u8]) -> Vec<u8> {
        [&(body.len() as u32 + 8).to_be_bytes(), &name[..], body].concat()
    }

    #[test]
    fn boxes_that_pass_the_end_are_found() {
        let mut file =
            [mp4_box(b"ftyp", b"isom\0\0\0\0"), mp4_box(b"moov", &[7; 30]), mp4_box(b"mdat", &[9; 50])].concat();
        let length = file.len();
        // A cut between two boxes cannot be detected.
        let between: Vec<usize> = (54..62).collect();
        assert_eq!(whole_at(&file), [&between[..], &[length]].concat());
        file.extend(b"a trailer of another kind");
        assert_eq!(whole_at(&file), [between, (length..=file.len()).collect()].concat());
        // A box that extends to the end of the file.
        let open = [mp4_box(b"ftyp", &[0; 40]), b"\0\0\0\0mdat".to_vec(), vec![1; 9]].concat();
        assert_eq!(whole_at(&open).last(), Some(&open.len()));
        assert!(whole_at(&open).contains(&(open.len() - 4)));
    }

    #[test]
    fn segments_chunks_and_sizes_are_found() {
        let ebml = |size: &[u8]| {
            let head = b"\x1a\x45\xdf\xa3\x84\x42\x86\x81\x01\x18\x53\x80\x67";
            [&head[..], size, &[3; 60]].concat()
        };
        let file = ebml(b"\x01\0\0\0\0\0\0\x3c");
        assert_eq!(whole_at(&file), [file.len()]);
        let open = ebml(b"\x01\xff\xff\xff\xff\xff\xff\xff");
        assert_eq!(whole_at(&open).len(), open.len() - 39);
        let avi = |size: u32| [&b"RIFF"[..], &size.to_le_bytes(), b"AVI ", &[5; 60]].concat();
        assert_eq!(whole_at(&avi(64)), [72]);
        assert_eq!(whole_at(&avi(0)).len(), 33);
        let flv =
            [&b"FLV\x01\x05\0\0\0\x09 onMetaData \0\x08filesize\0"[..], &90.0_f64.to_be_bytes(), &[1; 50]].concat();
        assert_eq!((flv.len(), whole_at(&flv).last()), (90, Some(&90)));
        assert!(!whole_at(&flv).contains(&89));
    }

    #[test]
    fn the_last_page_and_the_trailer_are_found() {
        let page = |flags: u8| [&b"OggS\0"[..], &[flags], &[0; 20], &[1, 30], &[2; 30]].concat();
        let file = [page(2), page(0), page(4)].concat();
        assert_eq!(whole_at(&file), [file.len()]);
        let gif = [
            &b"GIF89a\x08\0\x08\0\x80\0\0"[..],
            &[1; 6],
            b"\x21\xf9\x04\0\0\0\0\0",
            b"\x2c\0\0\0\0\x08\0\x08\0\0\x02\x05\x3b\x3b\x3b\x3b\x3b\0",
            b"\x3b",
        ]
        .concat();
        assert_eq!(whole_at(&gif), [gif.len()]);
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(start in 0..6_usize, rest in proptest::collection::vec(proptest::num::u8::ANY, 0..200)) {
            let magic: [&[u8]; 6] = [b"RIFF", b"OggS", b"GIF8", b"\x1a\x45\xdf\xa3", b"FLV\x01", b"\0\0\0\x10ftyp"];
            let folder = tempfile::tempdir().expect("a temporary folder");
            let path = folder.path().join("a");
            std::fs::write(&path, [magic[start], &rest].concat()).expect("writable");
            let _ = missing(&path);
        }
    }
}
