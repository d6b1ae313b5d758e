//! JSON as other programs write it: with a byte order mark, and with numbers that are not valid JSON.

use serde_json::Value;

/// Numbers that Python's `json` writes although JSON does not allow them.
const NOT_FINITE: [&str; 3] = ["-Infinity", "Infinity", "NaN"];

/// Parses a text; or returns expected and found values.
pub(crate) fn value(bytes: &[u8]) -> Result<Value, [String; 2]> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let not_json = |found: String| ["JSON".to_owned(), found];
    if text.starts_with(b"\xff\xfe") || text.starts_with(b"\xfe\xff") {
        return Err(["text in UTF-8".to_owned(), "UTF-16 (save it as UTF-8)".to_owned()]);
    }
    let text = std::str::from_utf8(text).map_err(|_| not_json("bytes that are no text".to_owned()))?;
    serde_json::from_str(text).map_err(|e| match not_finite(text) {
        Some((key, word)) => {
            let of = if key.is_empty() { "a number".to_owned() } else { format!("a finite number for {key}") };
            [of, format!("{word}, which Python's json module writes and JSON has not")]
        }
        None if text.trim().is_empty() => not_json("nothing".to_owned()),
        None => not_json(format!("text that is none ({e})")),
    })
}

/// Returns the first number outside of strings that JSON does not allow, and the key before it.
fn not_finite(text: &str) -> Option<(String, &'static str)> {
    let (mut key, mut last, mut rest) = (String::new(), String::new(), text);
    while let Some(c) = rest.chars().next() {
        if let Some(word) = NOT_FINITE.into_iter().find(|word| rest.starts_with(word)) {
            return Some((key, word));
        }
        rest = &rest[c.len_utf8()..];
        match c {
            '"' => {
                let end = end_of_string(rest)?;
                last = rest[..end].chars().take(40).collect();
                rest = &rest[end + 1..];
            }
            ':' => key = std::mem::take(&mut last),
            _ => {}
        }
    }
    None
}

/// Returns the position of the quotation mark that ends a string.
fn end_of_string(text: &str) -> Option<usize> {
    let mut escaped = false;
    text.bytes().position(|byte| {
        let ends = byte == b'"' && !escaped;
        escaped = byte == b'\\' && !escaped;
        ends
    })
}

/// Describes a value for messages: the keys of an object.
pub(crate) fn keys(value: &Value) -> String {
    let Value::Object(map) = value else { return "neither an array nor an object".to_owned() };
    let short = |key: &String| key.chars().take(40).collect::<String>();
    let keys: Vec<String> = map.keys().take(8).map(short).collect();
    let more = if map.len() > keys.len() { " and others" } else { "" };
    match keys.len() {
        0 => "an empty object".to_owned(),
        _ => format!("an object with {:?}{more}", keys.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_order_mark_is_no_part_of_the_text() {
        assert_eq!(value(b"\xef\xbb\xbf[1]"), value(b"[1]"));
        let [_, found] = value(b"\xff\xfe[\0").expect_err("UTF-16");
        assert!(found.starts_with("UTF-16"), "{found}");
    }

    #[test]
    fn numbers_that_json_has_not_are_named_with_their_key() {
        for (text, key, word) in [
            (r#"{"a": "NaN \" Infinity", "k1": NaN}"#, "k1", "NaN"),
            (r#"{"m": [[1, -Infinity]]}"#, "m", "-Infinity"),
            (r#"{"m": Infinity}"#, "m", "Infinity"),
        ] {
            let [expected, found] = value(text.as_bytes()).expect_err("no JSON");
            assert!(expected.ends_with(&format!("for {key}")) && found.starts_with(&format!("{word},")), "{found}");
        }
        for text in ["", "{", r#"{"NaN": }"#, "\"NaN", "NaN", "[NaN"] {
            assert!(value(text.as_bytes()).is_err(), "{text}");
        }
    }
}
