//! ICC profiles: detection of sRGB.
//!
//! Profiles are not applied. A profile that differs from sRGB adds a note with its name.

/// Columns of sRGB's matrix, adapted to D50 as in profiles: red, green and blue.
const SRGB: [[f64; 3]; 3] = [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];
/// Linear light of sRGB's sample ½.
const HALF: f64 = 0.2140;

/// Returns a note if the profile is not sRGB.
pub(super) fn note(profile: &[u8]) -> Option<String> {
    if is_srgb(profile) == Some(true) {
        return None;
    }
    let name = description(profile).unwrap_or_else(|| "without a name".to_owned());
    Some(format!("the colour profile \"{name}\" is not applied: colours are taken as sRGB"))
}

fn is_srgb(profile: &[u8]) -> Option<bool> {
    let near = |a: f64, b: f64, by: f64| (a - b).abs() <= by;
    match profile.get(16..20)? {
        b"GRAY" => Some(near(half(tag(profile, b"kTRC")?)?, HALF, 0.01)),
        b"RGB " => {
            for (name, column) in [b"rXYZ", b"gXYZ", b"bXYZ"].into_iter().zip(SRGB) {
                let found = xyz(tag(profile, name)?)?;
                if !found.iter().zip(column).all(|(&a, b)| near(a, b, 0.003)) {
                    return Some(false);
                }
            }
            for name in [b"rTRC", b"gTRC", b"bTRC"] {
                if !near(half(tag(profile, name)?)?, HALF, 0.01) {
                    return Some(false);
                }
            }
            Some(true)
        }
        _ => Some(false),
    }
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|b| u32::from_be_bytes(*b))
}

fn short(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|b| u16::from_be_bytes(*b))
}

/// Reads a fixed-point number with 16 integer and 16 fractional bits.
fn fixed(bytes: &[u8], at: usize) -> Option<f64> {
    Some(f64::from(word(bytes, at)? as i32) / 65536.0)
}

/// Returns the bytes of a tag.
fn tag<'a>(profile: &'a [u8], name: &[u8; 4]) -> Option<&'a [u8]> {
    let count = word(profile, 128)?.min(100) as usize;
    let entry = (0..count).map(|i| 132 + 12 * i).find(|&at| profile.get(at..at + 4) == Some(name))?;
    let (start, length) = (word(profile, entry + 4)? as usize, word(profile, entry + 8)? as usize);
    profile.get(start..start.checked_add(length)?)
}

fn xyz(tag: &[u8]) -> Option<[f64; 3]> {
    (tag.get(..4)? == b"XYZ ").then_some(())?;
    Some([fixed(tag, 8)?, fixed(tag, 12)?, fixed(tag, 16)?])
}

/// Returns the linear light of the sample ½ by a curve.
fn half(tag: &[u8]) -> Option<f64> {
    match tag.get(..4)? {
        b"curv" => match word(tag, 8)? as usize {
            0 => Some(0.5),
            1 => Some(0.5_f64.powf(f64::from(short(tag, 12)?) / 256.0)),
            count => {
                let at = |i: usize| short(tag, 12 + 2 * i).map(|v| f64::from(v) / 65535.0);
                Some((at((count - 1) / 2)? + at(count / 2)?) / 2.0)
            }
        },
        b"para" => {
            let p = |i: usize| fixed(tag, 12 + 4 * i);
            let g = p(0)?;
            // At ½ every parametric curve in use is in its power segment.
            Some(match short(tag, 8)? {
                0 => 0.5_f64.powf(g),
                1 => (p(1)? * 0.5 + p(2)?).powf(g),
                2 => (p(1)? * 0.5 + p(2)?).powf(g) + p(3)?,
                3 => (p(1)? * 0.5 + p(2)?).powf(g),
                4 => (p(1)? * 0.5 + p(2)?).powf(g) + p(5)?,
                _ => return None,
            })
        }
        _ => None,
    }
}

/// Returns the profile's name: printable characters, at most 60.
fn description(profile: &[u8]) -> Option<String> {
    let tag = tag(profile, b"desc")?;
    let text: String = match tag.get(..4)? {
        b"desc" => tag.get(12..)?.iter().map(|&b| char::from(b)).take(word(tag, 8)?.min(200) as usize).collect(),
        b"mluc" => {
            let (length, start) = (word(tag, 20)? as usize, word(tag, 24)? as usize);
            let (units, _) = tag.get(start..start.checked_add(length)?)?.as_chunks::<2>();
            char::decode_utf16(units.iter().map(|b| u16::from_be_bytes(*b))).map_while(Result::ok).collect()
        }
        _ => return None,
    };
    let text: String = text.chars().filter(|c| !c.is_control() && *c != '"').take(60).collect();
    (!text.trim().is_empty()).then(|| text.trim().to_owned())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Builds a profile of these colorants, one gamma and a name.
    pub fn profile(columns: [[f64; 3]; 3], gamma: f64, name: &str) -> Vec<u8> {
        let number = |v: f64| ((v * 65536.0).round() as i32).to_be_bytes();
        let mut tags: Vec<(&[u8; 4], Vec<u8>)> = Vec::new();
        for (name, column) in [b"rXYZ", b"gXYZ", b"bXYZ"].into_iter().zip(columns) {
            tags.push((name, [b"XYZ \0\0\0\0".to_vec(), column.into_iter().flat_map(number).collect()].concat()));
        }
        for name in [b"rTRC", b"gTRC", b"bTRC"] {
            tags.push((name, [b"para\0\0\0\0\0\0\0\0".to_vec(), number(gamma).to_vec()].concat()));
        }
        let length = (name.len() as u32 + 1).to_be_bytes();
        tags.push((b"desc", [b"desc\0\0\0\0", &length[..], name.as_bytes(), b"\0"].concat()));
        let mut bytes = vec![0; 128];
        bytes[16..20].copy_from_slice(b"RGB ");
        bytes.extend((tags.len() as u32).to_be_bytes());
        let mut start = 132 + 12 * tags.len();
        for (name, data) in &tags {
            bytes.extend([&name[..], &(start as u32).to_be_bytes(), &(data.len() as u32).to_be_bytes()].concat());
            start += data.len();
        }
        bytes.extend(tags.into_iter().flat_map(|(_, data)| data));
        bytes
    }

    /// Display P3.
    pub const P3: [[f64; 3]; 3] = [[0.5151, 0.2412, -0.0011], [0.2920, 0.6922, 0.0419], [0.1571, 0.0666, 0.7841]];

    #[test]
    fn a_profile_that_is_not_srgb_is_named() {
        assert_eq!(note(&profile(SRGB, 2.2, "any name")), None);
        let line = note(&profile(P3, 2.2, "Display P3")).expect("another gamut");
        assert!(line.contains("\"Display P3\""), "{line}");
        assert!(note(&profile(SRGB, 1.0, "linear")).is_some());
        for end in [0, 20, 128, 140, 200] {
            assert!(note(&profile(P3, 2.2, "cut")[..end]).is_some(), "{end} bytes");
        }
    }
}
