//! Bytes as text without characters that HTML interprets: 13 bits in two of 91 printable characters, 23 % more than the
//! bytes (base64: 33 %).

/// The characters, in ascending order: ASCII from `!` to `~` except `&`, `<` and `\\`.
fn digits() -> [u8; 91] {
    let mut printable = (b'!'..=b'~').filter(|c| !b"&<\\".contains(c));
    std::array::from_fn(|_| printable.next().unwrap_or(b'~'))
}

/// Encodes 13 bits as two characters, the lowest bits first; the last ones are padded with zeros. The first character
/// of a number is its digit of ones, the second that of 91s.
pub(super) fn text(bytes: &[u8]) -> String {
    let digits = digits();
    let mut out = String::with_capacity(bytes.len() * 16 / 13 + 4);
    let (mut word, mut bits) = (0_u32, 0);
    let mut put = |word: u32| out.extend([word % 91, word / 91].map(|digit| digits[digit as usize] as char));
    for byte in bytes {
        word |= u32::from(*byte) << bits;
        bits += 8;
        if bits >= 13 {
            put(word & 8191);
            word >>= 13;
            bits -= 13;
        }
    }
    if bits > 0 {
        put(word);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_from_printable_characters_that_html_leaves_alone() {
        let digits = digits();
        assert!(digits.is_sorted() && digits.first() == Some(&b'!') && digits.last() == Some(&b'~'));
        for length in [0, 1, 2, 12, 13, 14, 1000] {
            let bytes: Vec<u8> = (0..length).map(|i| (i * i * 7919 + i) as u8).collect();
            let text = text(&bytes);
            assert_eq!(text.len(), (8 * bytes.len()).div_ceil(13) * 2);
            let value = |c: u8| digits.iter().position(|digit| *digit == c).expect("a digit") as u64;
            let (mut again, mut word, mut bits) = (Vec::new(), 0_u64, 0);
            for pair in text.as_bytes().chunks(2) {
                word |= (value(pair[0]) + 91 * value(pair[1])) << bits;
                bits += 13;
                while bits >= 8 {
                    again.push(word as u8);
                    word >>= 8;
                    bits -= 8;
                }
            }
            again.truncate(length);
            assert!(again == bytes, "{length}");
        }
    }
}
