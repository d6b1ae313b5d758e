//! Standard output.

use std::fmt::Write as _;
use std::io::Write;

use super::failure::Failure;

/// Maximum length of a printed text, in characters.
const LONGEST: usize = 20_000;

/// Prints a line on standard output, with text from files made [`visible`].
pub fn say(line: impl std::fmt::Display) -> Result<(), Failure> {
    print(format!("{}\n", visible(&line.to_string())).as_bytes())
}

/// Formats a count with its noun: `1 image`, `2 images`.
pub fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Makes text safe for a terminal: control characters, which names and tags of files may contain, become escapes, and
/// very long text is truncated. Line breaks and tabs stay.
pub fn visible(text: &str) -> String {
    let mut out = String::with_capacity(text.len().min(4 * LONGEST));
    for (at, c) in text.chars().enumerate() {
        if at == LONGEST {
            let _ = write!(out, "… ({} more characters)", text.chars().count() - at);
            break;
        }
        // Marks of text direction can hide text as control characters can.
        let hides = matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        if (c.is_control() && c != '\n' && c != '\t') || hides {
            let _ = write!(out, "{}", c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    out
}

/// Writes to standard output; a closed pipe is not an error.
pub fn print(text: &[u8]) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    match out.write_all(text).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::work(format!("standard output: cannot write: {e}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_of_files_are_escaped_and_long_text_is_cut() {
        assert_eq!(visible("a\u{1b}[2J\u{7}b\tc\nd é"), "a\\u{1b}[2J\\u{7}b\tc\nd é");
        assert_eq!(visible("\u{202e}gpj.exe\u{9b}"), "\\u{202e}gpj.exe\\u{9b}");
        let cut = visible(&"x".repeat(1 << 20));
        assert!(cut.len() < LONGEST + 50 && cut.ends_with("more characters)"), "{}", cut.len());
    }
}
