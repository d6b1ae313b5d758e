//! Pictures, videos and sounds, by their first bytes.

use super::{Head, Kind};

/// A kind of media.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Media {
    /// Moving pictures.
    Video,
    /// One picture, or a few.
    Image,
    /// Sound without a picture.
    Sound,
}

impl Media {
    /// Returns the kind with its article.
    pub(super) fn article(self) -> &'static str {
        match self {
            Media::Video => "a video",
            Media::Image => "an image",
            Media::Sound => "sound alone",
        }
    }
}

/// First bytes that identify one format.
const MAGIC: [(&[u8], Media, &str); 33] = [
    (b"\x1a\x45\xdf\xa3", Media::Video, "Matroska or WebM"),
    (b"YUV4MPEG2", Media::Video, "y4m"),
    (b"FLV\x01", Media::Video, "FLV"),
    (b"DKIF", Media::Video, "IVF"),
    (b"\x00\x00\x01\xba", Media::Video, "MPEG program stream"),
    (b"\x00\x00\x01\xb3", Media::Video, "MPEG video"),
    (b"\x00\x00\x00\x01\x67", Media::Video, "H.264 stream"),
    (b"\x00\x00\x00\x01\x40\x01", Media::Video, "H.265 stream"),
    (b"\x30\x26\xb2\x75\x8e\x66\xcf\x11", Media::Video, "WMV or ASF"),
    (b"\x06\x0e\x2b\x34\x02\x05\x01\x01", Media::Video, "MXF"),
    (b"GIF87a", Media::Video, "GIF"),
    (b"GIF89a", Media::Video, "GIF"),
    (b"\x89PNG\r\n\x1a\n", Media::Image, "PNG"),
    (b"\xff\xd8\xff", Media::Image, "JPEG"),
    (b"II*\0", Media::Image, "TIFF"),
    (b"MM\0*", Media::Image, "TIFF"),
    (b"II+\0", Media::Image, "BigTIFF"),
    (b"MM\0+", Media::Image, "BigTIFF"),
    (b"\x76\x2f\x31\x01", Media::Image, "OpenEXR"),
    (b"#?RADIANCE", Media::Image, "Radiance HDR"),
    (b"qoif", Media::Image, "QOI"),
    (b"\0\0\0\x0cJXL \r\n\x87\n", Media::Image, "JPEG XL"),
    (b"\0\0\0\x0cjP  \r\n\x87\n", Media::Image, "JPEG 2000"),
    (b"8BPS", Media::Image, "Photoshop"),
    (b"SDPX", Media::Image, "DPX"),
    (b"XPDS", Media::Image, "DPX"),
    (b"DDS ", Media::Image, "DDS"),
    (b"farbfeld", Media::Image, "farbfeld"),
    (b"fLaC", Media::Sound, "FLAC"),
    (b"ID3", Media::Sound, "MP3"),
    (b"MThd", Media::Sound, "MIDI"),
    (b"caff", Media::Sound, "CAF"),
    (b".snd", Media::Sound, "AU"),
];

/// Boxes at the start of a QuickTime or MP4 file.
const BOXES: [&[u8]; 5] = [b"moov", b"mdat", b"wide", b"free", b"skip"];
/// Brands of files that contain pictures.
const PICTURES: [&[u8]; 6] = [b"avif", b"heic", b"heix", b"mif1", b"heim", b"heis"];

pub(super) fn kind(head: &Head<'_>) -> Option<Kind> {
    let found = |media, name| Some(Kind::Media(media, name));
    if let Some((_, media, name)) = MAGIC.iter().find(|(magic, ..)| head.starts(magic)) {
        return found(*media, *name);
    }
    if head.holds(4, b"ftyp") {
        let brand = |endings: &[&[u8]]| endings.iter().any(|brand| head.holds(8, brand));
        return match () {
            () if brand(&[b"M4A", b"M4B", b"F4A"]) => found(Media::Sound, "M4A"),
            () if brand(&[b"avif"]) => found(Media::Image, "AVIF"),
            () if brand(&PICTURES) => found(Media::Image, "HEIF"),
            () if brand(&[b"qt  "]) => found(Media::Video, "QuickTime"),
            () => found(Media::Video, "MP4"),
        };
    }
    if BOXES.iter().any(|name| head.holds(4, name)) && head.named(&["mov", "mp4", "m4v", "qt"]) {
        return found(Media::Video, "QuickTime");
    }
    if head.starts(b"RIFF") {
        return match head.bytes.get(8..12)? {
            b"WEBP" => found(Media::Image, "WebP"),
            b"WAVE" => found(Media::Sound, "WAV"),
            b"AVI " => found(Media::Video, "AVI"),
            _ => None,
        };
    }
    if head.starts(b"FORM") && [b"AIFF", b"AIFC"].iter().any(|name| head.holds(8, *name)) {
        return found(Media::Sound, "AIFF");
    }
    if head.starts(b"OggS") {
        let theora = head.bytes.windows(7).any(|word| word == b"\x80theora");
        return if theora { found(Media::Video, "Ogg") } else { found(Media::Sound, "Ogg") };
    }
    // Packets of 188 bytes, or of 192 with a time before each.
    if [(0, 188), (4, 192)].iter().any(|(at, step)| (0..3).all(|k| head.bytes.get(at + k * step) == Some(&0x47))) {
        return found(Media::Video, "MPEG transport stream");
    }
    let bmp = head.bytes.get(2..6).and_then(|b| b.first_chunk()).map(|b| u64::from(u32::from_le_bytes(*b)));
    if head.starts(b"BM") && bmp == Some(head.length) {
        return found(Media::Image, "BMP");
    }
    // Frames of MPEG audio begin with eleven set bits, but so do other files.
    if head.named(&["mp3", "aac"]) && head.starts(b"\xff") && head.bytes.get(1).is_some_and(|b| b & 0xe0 == 0xe0) {
        return found(Media::Sound, "MP3 or AAC");
    }
    let netpbm = head.starts(b"P") && head.bytes.get(1).is_some_and(|b| (b'1'..=b'7').contains(b));
    if netpbm && head.named(&["ppm", "pgm", "pbm", "pnm", "pam"]) {
        return found(Media::Image, "Netpbm");
    }
    None
}
