//! The page's parts put together.

use std::io::{self, Write};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::DeflateEncoder;

use super::Source;
use super::packet::by_columns;
use crate::scene::SceneError;

const TEMPLATE: &str = include_str!("page.html");
/// Placeholders in the template, one per part.
const STYLE: &str = "/* page.css */";
const SHADERS: &str = "<!-- shaders -->";
const SCRIPT: &str = "/* scripts */";
const SCENE: &str = "<!-- scene -->";

/// Programs of the graphics processor, by the names that the scripts use.
const SHADER_FILES: [(&str, &str); 4] = [
    ("splat.vert", include_str!("shaders/splat.vert")),
    ("splat.frag", include_str!("shaders/splat.frag")),
    ("resolve.vert", include_str!("shaders/resolve.vert")),
    ("resolve.frag", include_str!("shaders/resolve.frag")),
];

/// The scripts, joined to one module in this order.
const SCRIPT_FILES: [&str; 8] = [
    include_str!("packet.js"),
    include_str!("store.js"),
    include_str!("motion.js"),
    include_str!("camera.js"),
    include_str!("sort.js"),
    include_str!("draw.js"),
    include_str!("pick.js"),
    include_str!("page.js"),
];

/// The page without a scene, in two parts: a scene inside the page stands between them.
pub(super) fn halves() -> (String, String) {
    let shaders: Vec<String> = SHADER_FILES
        .iter()
        .map(|(name, text)| format!("<script type=\"text/plain\" id=\"{name}\">{text}</script>"))
        .collect();
    let page = TEMPLATE
        .replacen(STYLE, include_str!("page.css"), 1)
        .replacen(SHADERS, &shaders.join("\n"), 1)
        .replacen(SCRIPT, &SCRIPT_FILES.join("\n"), 1);
    let (before, after) = page.split_once(SCENE).unwrap_or((&page, ""));
    (before.to_owned(), after.to_owned())
}

/// Why a page could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// An interval of the list is not to be had any more.
    #[error("interval {0}: expected all that the scene lists, found it gone")]
    Gone(usize),
    /// The description has no JSON form.
    #[error("scene: {0}")]
    Description(#[from] serde_json::Error),
    /// The page cannot be written.
    #[error("cannot write: {0}")]
    Write(#[from] io::Error),
}

/// Writes the page with the whole of `source` in it: one file that needs nothing else. Returns the number of its bytes.
///
/// The description goes into it as JSON, each interval's packet by bytes of equal weight ([`by_columns`]), deflated, as base64.
///
/// # Errors
/// A source that cannot be read, and what `out` says.
pub fn write_page(source: &dyn Source, out: &mut dyn Write) -> Result<u64, PageError> {
    let mut written = 0;
    let mut put = |out: &mut dyn Write, text: &str| -> io::Result<()> {
        written += text.len() as u64;
        out.write_all(text.as_bytes())
    };
    let (before, after) = halves();
    put(out, &before)?;
    let description = source.describe(0);
    // No text inside can end the element.
    let json = serde_json::to_string(&description)?.replace('<', "\\u003c");
    put(out, &format!("<script type=\"application/json\" id=\"scene\">{json}</script>\n"))?;
    for i in description.from..description.from + description.intervals.len() {
        let packet = source.packet(i)?.ok_or(PageError::Gone(i))?;
        let mut deflated = DeflateEncoder::new(Vec::new(), Compression::best());
        deflated.write_all(&by_columns(&packet))?;
        let text = STANDARD.encode(deflated.finish()?);
        put(out, &format!("<script type=\"text/plain\" id=\"interval-{i}\">{text}</script>\n"))?;
    }
    put(out, &after)?;
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_has_its_place_and_ends_no_element_early() {
        for mark in [STYLE, SHADERS, SCRIPT, SCENE] {
            assert_eq!(TEMPLATE.matches(mark).count(), 1, "{mark}");
        }
        let shaders = SHADER_FILES.iter().map(|(_, text)| *text);
        for part in shaders.chain(SCRIPT_FILES).chain([include_str!("page.css")]) {
            assert!(!part.contains("</script") && !part.contains("</style"));
            assert!([STYLE, SHADERS, SCRIPT, SCENE].iter().all(|mark| !part.contains(mark)));
        }
    }

    #[test]
    fn the_page_names_no_other_place() {
        let (before, after) = halves();
        let page = before + &after;
        // Names of namespaces are no addresses.
        let page = page.replace("http://www.w3.org/2000/svg", "");
        for address in ["http:", "https:", "src=", "@import", "url(", "import("] {
            assert!(!page.contains(address), "{address}");
        }
        assert!(page.contains("default-src 'none'") && page.contains("connect-src 'self'"));
    }
}
