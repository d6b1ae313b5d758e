//! Frames with their times for ffmpeg's input pipe: Matroska (RFC 9559) with uncompressed RGB, one cluster per frame.
//!
//! y4m and raw video have only a frame rate. In Matroska each frame has its own time, here in whole nanoseconds. The
//! default duration is that of the mean rate; ffmpeg takes the rate and the duration of the last frame from it.

/// The head of a stream of 8-bit RGB frames.
pub(super) fn head(width: usize, height: usize, fps: f64) -> Vec<u8> {
    let ebml = [
        element(&[0x42, 0x86], &number(1)),
        element(&[0x42, 0xF7], &number(1)),
        element(&[0x42, 0xF2], &number(4)),
        element(&[0x42, 0xF3], &number(8)),
        element(&[0x42, 0x82], b"matroska"),
        element(&[0x42, 0x87], &number(4)),
        element(&[0x42, 0x85], &number(2)),
    ];
    let mut out = element(&[0x1A, 0x45, 0xDF, 0xA3], &ebml.concat());
    // The segment, of unknown length.
    out.extend([0x18, 0x53, 0x80, 0x67, 0x01, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]);
    // A tick of one nanosecond, and the name of the writer.
    let info = [
        element(&[0x2A, 0xD7, 0xB1], &number(1)),
        element(&[0x4D, 0x80], b"streamsplat"),
        element(&[0x57, 0x41], b"streamsplat"),
    ];
    out.extend(element(&[0x15, 0x49, 0xA9, 0x66], &info.concat()));
    let video = [
        element(&[0xB0], &number(width as u64)),
        element(&[0xBA], &number(height as u64)),
        // The colour space: RGB of 24 bits.
        element(&[0x2E, 0xB5, 0x24], b"RGB\x18"),
    ];
    let track = [
        element(&[0xD7], &number(1)),
        element(&[0x73, 0xC5], &number(1)),
        element(&[0x83], &number(1)),
        element(&[0x86], b"V_UNCOMPRESSED"),
        element(&[0x23, 0xE3, 0x83], &number((1e9 / fps).round().max(1.0) as u64)),
        element(&[0xE0], &video.concat()),
    ];
    out.extend(element(&[0x16, 0x54, 0xAE, 0x6B], &element(&[0xAE], &track.concat())));
    out
}

/// The header of the samples of a frame of `bytes` bytes that is shown at `nanoseconds`.
pub(super) fn frame(nanoseconds: u64, bytes: usize) -> Vec<u8> {
    let time = element(&[0xE7], &number(nanoseconds));
    // A block of track 1 at the cluster's own time, which is a key frame.
    let block = [&[0xA3][..], &length(bytes + 4), &[0x81, 0, 0, 0x80]].concat();
    let cluster = length(time.len() + block.len() + bytes);
    [&[0x1F, 0x43, 0xB6, 0x75][..], &cluster, &time, &block].concat()
}

fn element(id: &[u8], content: &[u8]) -> Vec<u8> {
    [id, &length(content.len()), content].concat()
}

/// A length in eight bytes.
fn length(bytes: usize) -> [u8; 8] {
    ((1 << 56) | bytes as u64).to_be_bytes()
}

/// A whole number in as few bytes as possible.
fn number(value: u64) -> Vec<u8> {
    let bytes = value.to_be_bytes();
    let zeros = bytes.iter().take_while(|byte| **byte == 0).count().min(7);
    bytes[zeros..].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_numbers_are_those_of_ebml() {
        assert_eq!(number(0), [0]);
        assert_eq!(number(256), [1, 0]);
        assert_eq!(length(5), [1, 0, 0, 0, 0, 0, 0, 5]);
        let head = frame(1_000_000, 12);
        // The cluster's length counts the rest of the head and the samples.
        let said = u64::from_be_bytes([0, head[5], head[6], head[7], head[8], head[9], head[10], head[11]]);
        assert_eq!(said as usize, head.len() - 12 + 12);
    }
}
