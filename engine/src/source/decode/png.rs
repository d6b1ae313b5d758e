//! Metadata chunks of PNG files: colour tags, and frame control of animations.

/// Iterates over the chunks, each as name and data, up to the first that is truncated.
pub(super) fn chunks(bytes: &[u8]) -> impl Iterator<Item = (&[u8; 4], &[u8])> {
    let mut rest = bytes.get(8..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (name, after) = after.split_first_chunk::<4>()?;
        let length = u32::from_be_bytes(*length) as usize;
        let (data, after) = after.split_at_checked(length)?;
        // The checksum.
        (_, rest) = after.split_first_chunk::<4>()?;
        Some((name, data))
    })
}

/// Returns true if the file has its last chunk.
pub(super) fn has_end(bytes: &[u8]) -> bool {
    chunks(bytes).any(|(name, _)| name == b"IEND")
}

fn numbers(data: &[u8]) -> Vec<u32> {
    data.as_chunks::<4>().0.iter().map(|b| u32::from_be_bytes(*b)).collect()
}

/// Returns a note on tags of a colour space other than sRGB: `cICP`, or `gAMA` and `cHRM` unless a profile or `sRGB`
/// overrides them.
pub(super) fn colour_note(bytes: &[u8]) -> Option<String> {
    let (mut gamma, mut chromaticities) = (None, None);
    for (name, data) in chunks(bytes).take_while(|(name, _)| *name != b"IDAT") {
        match (name, data) {
            // Primaries of BT.709 with the curve of sRGB.
            (b"cICP", [1, 13, ..]) | (b"sRGB" | b"iCCP", _) => return None,
            (b"cICP", [primaries, transfer, ..]) => {
                return Some(format!(
                    "the PNG tag cICP (primaries {primaries}, transfer {transfer}) is not applied: colours are taken as sRGB"
                ));
            }
            (b"gAMA", data) => gamma = numbers(data).first().copied(),
            (b"cHRM", data) => chromaticities = Some(numbers(data)),
            _ => (),
        }
    }
    if let Some(gamma) = gamma
        && !(43_000..=48_000).contains(&gamma)
    {
        return Some(format!(
            "the PNG tag gAMA ({:.5}) is not applied: colours are taken as sRGB",
            f64::from(gamma) / 100_000.0
        ));
    }
    const SRGB: [u32; 8] = [31_270, 32_900, 64_000, 33_000, 30_000, 60_000, 15_000, 6_000];
    let other =
        chromaticities.is_some_and(|found| found.iter().zip(SRGB).any(|(&found, srgb)| found.abs_diff(srgb) > 1_000));
    other.then(|| "the PNG tag cHRM (other primaries) is not applied: colours are taken as sRGB".to_owned())
}

/// Returns the duration of each frame of an animation, in seconds as a fraction; `None` if the file is no animation.
///
/// # Errors
/// A number of frames other than the declared one.
pub(super) fn delays(bytes: &[u8]) -> Result<Option<Vec<(u32, u32)>>, String> {
    let promised = chunks(bytes)
        .take_while(|(name, _)| *name != b"IDAT")
        .find(|(name, _)| *name == b"acTL")
        .and_then(|(_, data)| numbers(data).first().copied());
    let Some(promised) = promised.filter(|&frames| frames > 1) else { return Ok(None) };
    let short = |data: &[u8], at: usize| data.get(at..).and_then(|b| b.first_chunk()).map(|b| u16::from_be_bytes(*b));
    let delays: Vec<(u32, u32)> = chunks(bytes)
        .filter(|(name, _)| *name == b"fcTL")
        .map(|(_, data)| {
            let (numerator, denominator) = (short(data, 20).unwrap_or(0), short(data, 22).unwrap_or(0));
            // A denominator of 0 means 100.
            (u32::from(numerator), if denominator == 0 { 100 } else { u32::from(denominator) })
        })
        .collect();
    if delays.len() != promised as usize {
        return Err(format!("expected {promised} frames as the PNG promises, found {}", delays.len()));
    }
    Ok(Some(delays))
}
