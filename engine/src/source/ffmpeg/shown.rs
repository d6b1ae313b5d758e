//! Parser of ffmpeg's messages: times and properties of frames from the `showinfo` filter, and errors.

use crate::source::colour::Tags;

/// Properties of a frame's picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Look {
    /// ffmpeg's name of the samples' format.
    pub(super) format: String,
    /// A pixel's width to its height, where it is not square.
    pub(super) aspect: Option<(u32, u32)>,
    /// True if the frame is two fields.
    pub(super) interlaced: bool,
    pub(super) tags: Tags,
}

impl Look {
    /// Returns the properties that differ from the first frame's: a name, the value here, and the first frame's. A tag
    /// that is absent here does not differ, and progressive frames pass the filter that deinterlaces.
    pub(super) fn differing(&self, first: &Look) -> Vec<(&'static str, String, String)> {
        let tag = |name, [here, first]: [&Option<String>; 2]| {
            let here = here.as_ref().filter(|here| Some(*here) != first.as_ref())?;
            Some((name, here.clone(), first.clone().unwrap_or_else(|| "not stated".to_owned())))
        };
        let (tags, theirs) = (&self.tags, &first.tags);
        let mut found: Vec<_> = [
            tag(MATRIX, [&tags.matrix, &theirs.matrix]),
            tag("the range", [&tags.range, &theirs.range]),
            tag("the primaries", [&tags.primaries, &theirs.primaries]),
            tag("the transfer", [&tags.transfer, &theirs.transfer]),
        ]
        .into_iter()
        .flatten()
        .collect();
        let aspect =
            |look: &Look| look.aspect.map_or("square".to_owned(), |(width, height)| format!("{width}:{height}"));
        if self.aspect != first.aspect {
            found.push(("the shape of pixels", aspect(self), aspect(first)));
        }
        if self.interlaced && !first.interlaced {
            found.push(("the scan", "interlaced".to_owned(), "progressive".to_owned()));
        }
        found
    }
}

/// Name of the matrix in [`Look::differing`].
pub(super) const MATRIX: &str = "the matrix";

/// A line of messages, as printed with `-v repeat+level+info`.
#[derive(Debug, PartialEq)]
pub(super) enum Message {
    /// Seconds per tick of the frames' times, and frames per second if frames are evenly spaced; as fractions.
    Config { tick: (u32, u32), rate: Option<(u32, u32)> },
    /// A frame: its number since the filters were set up, and its time in ticks.
    Frame { number: usize, time: Option<i64>, size: (usize, usize), look: Look },
    /// Colours of the previous frame.
    Colours(Tags),
    /// An error in the file, or in reading it.
    Complaint(String),
    /// Anything else.
    Other,
}

/// Errors of H.264 decoders that do not affect pictures: a reference frame that should be released was released
/// already.
const HARMLESS: [&str; 1] = ["mmco: unref short failure"];

/// Warnings about missing data.
const LOST: [&str; 2] = ["dropping it", "corrupt decoded frame"];

impl Message {
    pub(super) fn parse(line: &str) -> Message {
        let (context, level, text) = split(line);
        let lost = || LOST.iter().any(|lost| text.contains(lost));
        if matches!(level, "error" | "fatal" | "panic") || (level == "warning" && lost()) {
            let harmless = HARMLESS.iter().any(|harmless| text.starts_with(harmless));
            return if harmless || text.is_empty() { Message::Other } else { Message::Complaint(text.to_owned()) };
        }
        // The context is missing if another thread's message came first on the line.
        if !context.contains("showinfo") && !starts(text) {
            return Message::Other;
        }
        if let Some(rest) = text.strip_prefix("config in ") {
            let tick = value(rest, "time_base:").and_then(ratio);
            let rate = value(rest, "frame_rate:").and_then(ratio);
            return tick.map_or(Message::Other, |tick| Message::Config { tick, rate });
        }
        if starts_a_frame(text) {
            let number = value(text, "n:").and_then(|number| number.parse().ok()).unwrap_or_default();
            let size = value(text, " s:").and_then(|size| size.split_once('x'));
            let size = size.and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?))).unwrap_or_default();
            let look = Look {
                format: value(text, "fmt:").unwrap_or_default().to_owned(),
                aspect: value(text, "sar:").and_then(ratio).filter(|(w, h)| w != h),
                interlaced: matches!(value(text, " i:"), Some("T" | "B")),
                tags: Tags::default(),
            };
            return Message::Frame { number, time: value(text, "pts:").and_then(|time| time.parse().ok()), size, look };
        }
        if text.starts_with("color_range:") {
            let [matrix, primaries, transfer] =
                ["color_space:", "color_primaries:", "color_trc:"].map(|key| value(text, key));
            let range = value(text, "color_range:");
            return Message::Colours(Tags::of(matrix, primaries, transfer).with_range(range));
        }
        Message::Other
    }
}

/// Returns true for text with which a message of the filter starts.
fn starts(text: &str) -> bool {
    starts_a_frame(text) || ["config in time_base:", "color_range:"].iter().any(|start| text.starts_with(start))
}

/// Returns true for text like `n:   7 pts: 280 …`.
fn starts_a_frame(text: &str) -> bool {
    let Some(rest) = text.strip_prefix("n:") else { return false };
    let rest = rest.trim_start().trim_start_matches(|c: char| c.is_ascii_digit());
    rest.starts_with(" pts:") && text.contains(" fmt:")
}

/// Splits a line into messages. The filter writes a line in several pieces, and other threads of ffmpeg may write
/// messages between them. A context after other text, or the start of one of the filter's messages, starts a message.
pub(super) fn messages(line: &str) -> Vec<&str> {
    let mut parts = Vec::new();
    let mut start = 0;
    for (at, first) in line.char_indices().filter(|&(at, c)| at > 0 && matches!(c, '[' | 'n' | 'c')) {
        let (before, rest) = (line[start..at].trim_end(), &line[at..]);
        let begins = || match first {
            '[' => rest.find(']').is_some_and(|end| rest[..end].contains(" @ 0x")),
            _ => starts(rest),
        };
        if !before.is_empty() && !before.ends_with(']') && begins() {
            parts.push(&line[start..at]);
            start = at;
        }
    }
    parts.push(&line[start..]);
    parts
}

/// Splits `[context @ 0x55] [level] text` into its parts; there may be any number of contexts.
fn split(line: &str) -> (&str, &str, &str) {
    let mut rest = line.trim();
    let (mut context, mut level) = ("", "");
    while let Some((inside, after)) = rest.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        if level.is_empty() && inside.contains(" @ ") {
            context = inside;
        } else if level.is_empty() && inside.bytes().all(|b| b.is_ascii_lowercase()) {
            level = inside;
        } else {
            break;
        }
        rest = after.trim_start();
    }
    (context, level, rest)
}

/// Returns the word after `key`, with or without blanks between them.
fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(key)?;
    rest.split_whitespace().next()
}

/// Parses a ratio such as `30000/1001` or `4:3`; `None` where a part is 0.
pub(super) fn ratio(text: &str) -> Option<(u32, u32)> {
    let (a, b) = text.split_once(['/', ':'])?;
    let (a, b) = (a.trim_end_matches(',').parse().ok()?, b.trim_end_matches([',', ']']).parse().ok()?);
    (a > 0 && b > 0).then_some((a, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_two_versions_are_read() {
        for line in [
            "[Parsed_showinfo_0 @ 0x5561b5149a80] [info] n:   1 pts:  93600 pts_time:1.04    pos:      245 fmt:yuv420p sar:4/3 s:160x96 i:T iskey:1 type:I ",
            "[Parsed_showinfo_0 @ 0x7f0e58002540] [info] n:   1 pts:  93600 pts_time:1.04    duration:   3600 duration_time:0.04    fmt:yuv420p cl:left sar:4/3 s:160x96 i:T iskey:1 type:I",
        ] {
            let look = Look { format: "yuv420p".into(), aspect: Some((4, 3)), interlaced: true, tags: Tags::default() };
            assert_eq!(Message::parse(line), Message::Frame { number: 1, time: Some(93600), size: (160, 96), look });
        }
        let config = "[Parsed_showinfo_1 @ 0x1] [info] config in time_base: 1001/30000, frame_rate: 30000/1001";
        assert_eq!(Message::parse(config), Message::Config { tick: (1001, 30000), rate: Some((30000, 1001)) });
        let open = "[Parsed_showinfo_1 @ 0x1] [info] config in time_base: 1/1000, frame_rate: 1/0";
        assert_eq!(Message::parse(open), Message::Config { tick: (1, 1000), rate: None });
        let none = "[Parsed_showinfo_0 @ 0x1] [info] n:   0 pts:NOPTS pts_time:NOPTS fmt:gray sar:0/1 s:8x6 i:P";
        assert!(
            matches!(Message::parse(none), Message::Frame { number: 0, time: None, size: (8, 6), look } if look.aspect.is_none())
        );
        let colours = "[Parsed_showinfo_0 @ 0x1] [info] color_range:tv color_space:bt470bg color_primaries:unknown color_trc:unknown";
        assert_eq!(
            Message::parse(colours),
            Message::Colours(Tags::of(Some("bt470bg"), None, None).with_range(Some("tv")))
        );
    }

    #[test]
    fn a_message_without_its_line_end_does_not_hide_the_next() {
        let line = "[Parsed_rotate_1 @ 0x5] [warning] please write to ffmpeg-devel@ffmpeg.org)config in time_base: 1/10240, frame_rate: 24/1";
        let found: Vec<Message> = messages(line).into_iter().map(Message::parse).collect();
        assert_eq!(found, [Message::Other, Message::Config { tick: (1, 10240), rate: Some((24, 1)) }]);
    }

    #[test]
    fn properties_that_differ_from_the_first_frames_are_named() {
        let first = Look { tags: Tags::of(Some("bt709"), None, None).with_range(Some("tv")), ..Look::default() };
        assert_eq!(first.differing(&first), []);
        // Tags that are absent, and progressive frames after interlaced ones.
        assert_eq!(Look::default().differing(&Look { interlaced: true, ..first.clone() }), []);
        let tags = Tags::of(Some("smpte170m"), None, Some("arib-std-b67")).with_range(Some("pc"));
        let other = Look { aspect: Some((2, 1)), interlaced: true, tags, ..Look::default() };
        let found: Vec<String> =
            other.differing(&first).into_iter().map(|(name, here, first)| format!("{name} {here} {first}")).collect();
        assert_eq!(
            found,
            [
                "the matrix smpte170m bt709",
                "the range pc tv",
                "the transfer arib-std-b67 not stated",
                "the shape of pixels 2:1 square",
                "the scan interlaced progressive"
            ]
        );
    }

    #[test]
    fn messages_that_share_a_line_are_read() {
        let frame = "n:   7 pts:    280 pts_time:0.28    pos:     1 fmt:yuv420p sar:0/1 s:64x48 i:P iskey:0 type:P";
        let other = "[out#0/yuv4mpegpipe @ 0x55] [info] something n: 1";
        let broken = "[h264 @ 0x1] [error] Invalid NAL unit size (2 > 1).";
        let shown = format!("[Parsed_showinfo_0 @ 0x2] [info] {frame}");
        let of = |line: &str| -> Vec<Message> {
            messages(line).into_iter().map(Message::parse).filter(|message| *message != Message::Other).collect()
        };
        let is_frame = |found: &Message| matches!(found, Message::Frame { number: 7, time: Some(280), size: (64, 48), look } if look.format == "yuv420p");
        let complaint = Message::Complaint("Invalid NAL unit size (2 > 1).".to_owned());
        for line in [
            shown.clone(),
            format!("{shown} {other}"),
            format!("{other}{frame}"),
            format!("{shown}{other} {shown}").replacen(&shown, "", 1),
        ] {
            let found = of(&line);
            assert!(matches!(&found[..], [one] if is_frame(one)), "{line}: {found:?}");
        }
        let found = of(&format!("{shown} {broken}"));
        assert!(found.len() == 2 && is_frame(&found[0]) && found[1] == complaint, "{found:?}");
        let found = of(&format!("{broken} {frame}"));
        assert!(found.len() == 2 && is_frame(&found[1]) && found[0] == complaint, "{found:?}");
        // Several contexts in front of one message.
        let two = "[vist#0:0/h264 @ 0x1] [dec:h264 @ 0x2] [error] Error submitting packet";
        assert_eq!(messages(two), [two]);
    }

    #[test]
    fn complaints_are_told_from_information() {
        let complaint = |line| match Message::parse(line) {
            Message::Complaint(text) => Some(text),
            _ => None,
        };
        for (line, expected) in [
            ("[h264 @ 0x55a6] [error] Invalid NAL unit size (2 > 1).", Some("Invalid NAL unit size (2 > 1).")),
            ("[vist#0:0/h264 @ 0x1] [dec:h264 @ 0x2] [error] Error submitting packet", Some("Error submitting packet")),
            ("[error] file:a.mp4: No such file", Some("file:a.mp4: No such file")),
            (
                "[avi @ 0x1] [warning] Packet corrupt (stream = 0, dts = 81), dropping it.",
                Some("Packet corrupt (stream = 0, dts = 81), dropping it."),
            ),
            // Where streams were joined, a counter is out of step, and nothing is lost.
            ("[mpegts @ 0x1] [warning] Packet corrupt (stream = 0, dts = 297000).", None),
            ("[h264 @ 0x1] [error] mmco: unref short failure", None),
            ("[swscaler @ 0x1] [warning] deprecated pixel format used", None),
            ("[h264 @ 0x1] [info] concealing 34 DC, 34 AC, 34 MV errors in B frame", None),
            ("  title: [error] nothing", None),
            ("", None),
        ] {
            assert_eq!(complaint(line).as_deref(), expected, "{line}");
        }
    }

    #[test]
    fn ratios_are_read_and_zeros_are_none() {
        assert_eq!(
            [ratio("30000/1001"), ratio("4:3"), ratio("0:1"), ratio("0/0"), ratio("N/A")],
            [Some((30000, 1001)), Some((4, 3)), None, None, None]
        );
    }

    proptest::proptest! {
        #[test]
        fn no_line_panics(line in ".{0,80}") {
            let _ = Message::parse(&line);
            let _ = Message::parse(&format!("[Parsed_showinfo_0 @ 0x1] [info] n: {line}"));
        }
    }
}
