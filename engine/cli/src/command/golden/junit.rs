//! Results as JUnit XML, for continuous integration.

use std::io;

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};

/// One test case.
pub struct Case {
    /// The render.
    pub render: String,
    /// The time of the image, or the step that failed.
    pub image: String,
    /// The reason of its failure.
    pub failure: Option<String>,
    /// Seconds.
    pub seconds: f64,
}

/// Replaces characters that XML cannot hold.
fn clean(text: &str) -> String {
    text.chars().map(|c| if c.is_control() && !"\t\n\r".contains(c) { '\u{fffd}' } else { c }).collect()
}

/// Writes one suite of `cases`, in order.
pub fn xml(suite: &str, cases: &[Case]) -> io::Result<Vec<u8>> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    let (count, failures) =
        (cases.len().to_string(), cases.iter().filter(|case| case.failure.is_some()).count().to_string());
    let seconds = format!("{:.3}", cases.iter().map(|case| case.seconds).sum::<f64>());
    let totals = [
        ("name", suite),
        ("tests", &count),
        ("failures", &failures),
        ("errors", "0"),
        ("skipped", "0"),
        ("time", &seconds),
    ];
    writer.create_element("testsuites").with_attributes(totals[..3].to_vec()).write_inner_content(|writer| {
        writer.create_element("testsuite").with_attributes(totals).write_inner_content(|writer| {
            for case in cases {
                let (render, image) = (clean(&case.render), clean(&case.image));
                let seconds = format!("{:.3}", case.seconds);
                let element = writer.create_element("testcase").with_attributes([
                    ("classname", render.as_str()),
                    ("name", image.as_str()),
                    ("time", seconds.as_str()),
                ]);
                match &case.failure {
                    None => element.write_empty()?,
                    Some(failure) => element.write_inner_content(|writer| {
                        let failure = clean(failure);
                        let element = writer.create_element("failure").with_attribute(("message", failure.as_str()));
                        element.write_text_content(BytesText::new(&failure))?;
                        Ok(())
                    })?,
                };
            }
            Ok(())
        })?;
        Ok(())
    })?;
    let mut bytes = writer.into_inner();
    bytes.push(b'\n');
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_xml_cannot_hold_is_replaced_and_the_rest_is_escaped() {
        let case = |failure: Option<&str>| Case {
            render: "a".into(),
            image: "0 s".into(),
            failure: failure.map(str::to_owned),
            seconds: 0.5,
        };
        let text = xml("list \"x\"", &[case(None), case(Some("a < b & \u{1}"))]).expect("memory");
        let text = String::from_utf8(text).expect("text");
        assert!(text.contains(r#"name="list &quot;x&quot;" tests="2" failures="1""#), "{text}");
        assert!(text.contains(r#"<testcase classname="a" name="0 s" time="0.500"/>"#), "{text}");
        assert!(text.contains("a &lt; b &amp; \u{fffd}</failure>"), "{text}");
    }
}
