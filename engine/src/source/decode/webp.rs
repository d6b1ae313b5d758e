//! Metadata of WebP files: length, and frame durations of animations.

/// Returns true if the bytes begin as WebP.
pub(super) fn is(bytes: &[u8]) -> bool {
    bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP")
}

/// Returns the declared number of bytes, including the first eight.
pub(super) fn promised(bytes: &[u8]) -> u64 {
    let length = bytes.get(4..).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b));
    u64::from(length) + 8
}

/// Iterates over the chunks, each as name and data, up to the first that is truncated.
fn chunks(bytes: &[u8]) -> impl Iterator<Item = (&[u8; 4], &[u8])> {
    let mut rest = bytes.get(12..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (name, after) = rest.split_first_chunk::<4>()?;
        let (length, after) = after.split_first_chunk::<4>()?;
        let length = u32::from_le_bytes(*length) as usize;
        let data = after.get(..length)?;
        rest = after.get(length.next_multiple_of(2)..).unwrap_or_default();
        Some((name, data))
    })
}

/// Returns the duration of each frame of an animation, in seconds as a fraction; `None` if the file is no animation.
pub(super) fn delays(bytes: &[u8]) -> Option<Vec<(u32, u32)>> {
    let delays: Vec<(u32, u32)> = chunks(bytes)
        .filter(|(name, _)| *name == b"ANMF")
        .filter_map(|(_, data)| data.get(12..15).map(|b| (u32::from_le_bytes([b[0], b[1], b[2], 0]), 1000)))
        .collect();
    (delays.len() > 1).then_some(delays)
}
