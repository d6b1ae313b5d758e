//! Assembly of the page from its parts.

use std::io::{self, Write};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::Source;
use super::text::text;
use crate::output::picture_png;
use crate::picture::Picture;
use crate::render::RenderError;
use crate::scene::{SceneError, coarseness};

const TEMPLATE: &str = include_str!("page.html");
/// Placeholders in the template, one per part.
const STYLE: &str = "/* page.css */";
const WORKER: &str = "/* worker */";
const SCRIPT: &str = "/* scripts */";
const SCENE: &str = "<!-- scene -->";
const LINK: &str = "<!-- link -->";
const INTERVALS: &str = "<!-- intervals -->";

/// A script of the player (`engine/player`), which other pages import as a module.
macro_rules! player {
    ($name:literal) => {
        include_str!(concat!("../../player/src/", $name))
    };
}

/// The scripts, joined into one module in this order.
const SCRIPT_FILES: [&str; 21] = [
    player!("errors.js"),
    player!("packet.js"),
    player!("camera.js"),
    player!("motion.js"),
    player!("shaders.js"),
    player!("draw.js"),
    player!("store.js"),
    player!("blob.js"),
    player!("helper.js"),
    player!("pace.js"),
    player!("pointers.js"),
    player!("headset.js"),
    include_str!("text.js"),
    include_str!("still.js"),
    include_str!("sources.js"),
    include_str!("pick.js"),
    include_str!("sway.js"),
    include_str!("address.js"),
    include_str!("opening.js"),
    include_str!("actions.js"),
    include_str!("page.js"),
];

/// The scripts of the worker, joined likewise.
const WORKER_FILES: [&str; 25] = [
    player!("errors.js"),
    player!("packet.js"),
    player!("camera.js"),
    player!("motion.js"),
    player!("rans.js"),
    player!("chunk.js"),
    player!("blob.js"),
    player!("container.js"),
    player!("sort.js"),
    player!("work.js"),
    include_str!("text.js"),
    include_str!("still.js"),
    include_str!("dropped/file.js"),
    include_str!("dropped/writer.js"),
    include_str!("dropped/ply.js"),
    include_str!("dropped/packed.js"),
    include_str!("dropped/splat.js"),
    include_str!("dropped/zstd.js"),
    include_str!("dropped/spz.js"),
    include_str!("dropped/zip.js"),
    include_str!("dropped/pixels.js"),
    include_str!("dropped/sog.js"),
    include_str!("dropped/glb.js"),
    include_str!("dropped/formats.js"),
    include_str!("worker.js"),
];

/// Joins modules into one script: without imports, which refer to modules among them, and without exports.
fn joined(files: &[&str]) -> String {
    let lines = files.iter().flat_map(|file| file.lines()).filter(|line| !line.starts_with("import "));
    lines.map(|line| line.strip_prefix("export ").unwrap_or(line)).flat_map(|line| [line, "\n"]).collect()
}

/// The page without a scene.
pub(super) fn bare() -> String {
    filled().replacen(SCENE, "", 1).replacen(LINK, "", 1).replacen(INTERVALS, "", 1)
}

/// The page with placeholders for a scene.
fn filled() -> String {
    let page = TEMPLATE.replacen(STYLE, include_str!("page.css"), 1);
    page.replacen(WORKER, &joined(&WORKER_FILES), 1).replacen(SCRIPT, &joined(&SCRIPT_FILES), 1)
}

/// Why a page could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A listed interval is no longer available.
    #[error("interval {0}: expected all that the scene lists, found it gone")]
    Gone(usize),
    /// A part has more characters than a browser's string can have.
    #[error(
        "--html: expected at most {LONGEST} characters of one part, found {0}: \
         a scene as large is shown without --html, where the program serves it"
    )]
    TooLong(usize),
    /// The poster cannot be drawn.
    #[error(transparent)]
    Poster(#[from] RenderError),
    /// The description has no JSON form.
    #[error("scene: {0}")]
    Description(#[from] serde_json::Error),
    /// The page cannot be written.
    #[error("cannot write: {0}")]
    Write(#[from] io::Error),
}

/// Most characters of a string in a browser: 2²⁹ − 24 in Chromium, the lowest limit.
const LONGEST: usize = (1 << 29) - 24;

/// A source whose whole content is written into one file.
pub trait Whole: Source {
    /// Description for programs that show links.
    const ABOUT: &str;

    /// Draws the first image of the scene.
    ///
    /// # Errors
    /// A scene that cannot be read or drawn.
    fn poster(&self) -> Result<Picture, PageError>;

    /// Passes its intervals to `put` one after another, in the format of the file's scripts.
    ///
    /// # Errors
    /// A scene that cannot be read, and the errors of `put`.
    fn parts(&self, put: &mut dyn FnMut(&[u8]) -> Result<(), PageError>) -> Result<(), PageError>;
}

/// Description of a page for programs that show links.
#[derive(Clone, Debug)]
pub struct Link {
    /// The page's title.
    pub title: String,
    /// Address of the page, if known.
    pub url: Option<String>,
    /// Address of the poster, absolute or relative to the page.
    pub image: String,
}

impl Link {
    /// The page's title, and the Open Graph tags, which programs that show links read.
    fn tags(&self, about: &str, [width, height]: [usize; 2]) -> String {
        let url = self.url.as_ref().map(|url| ("og:url", url.clone()));
        let properties = [
            ("og:type", "website".to_owned()),
            ("og:title", self.title.clone()),
            ("og:description", about.to_owned()),
            ("og:image", self.image.clone()),
            ("og:image:width", width.to_string()),
            ("og:image:height", height.to_string()),
        ];
        let tags = properties.into_iter().chain(url);
        let tags = tags.map(|(name, value)| format!("<meta property=\"{name}\" content=\"{}\">\n", escaped(&value)));
        tags.chain(["<meta name=\"twitter:card\" content=\"summary_large_image\">".to_owned()]).collect()
    }
}

/// Text as the value of an attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// The scene's first image as PNG, and its width and height.
///
/// # Errors
/// A scene that cannot be read or drawn.
pub fn poster(source: &impl Whole) -> Result<(Vec<u8>, [usize; 2]), PageError> {
    let picture = source.poster()?;
    Ok((picture_png(&picture), [picture.width, picture.height]))
}

/// Writes the page with all of `source` in it: one file without dependencies. Returns its length in bytes.
///
/// Everything that makes the page work comes first, then the intervals in order, so that the first ones can be shown
/// while others are still loading. Each is a container's chunk with only the columns that images require
/// (`docs/container.md`, "Inside a page"). A still scene is its compressed packet. Both are printable text.
///
/// # Errors
/// A source that cannot be read, one that is too large for a browser's text, and the errors of `out`.
pub fn write_page<S: Whole>(source: &S, link: &Link, out: &mut dyn Write) -> Result<u64, PageError> {
    let mut written = 0;
    let mut put = |out: &mut dyn Write, text: &str| -> io::Result<()> {
        written += text.len() as u64;
        out.write_all(text.as_bytes())
    };
    let (poster, size) = poster(source)?;
    let mut json = serde_json::to_value(source.describe(0))?;
    json["coarseness"] = coarseness().into();
    // Text inside must not end the element.
    let json = serde_json::to_string(&json)?.replace('<', "\\u003c");
    let image = format!("<img id=\"poster\" alt=\"\" src=\"data:image/png;base64,{}\">\n", STANDARD.encode(poster));
    let scene = format!("{image}<script type=\"application/json\" id=\"scene\">{json}</script>");
    // The scene's own text is inserted last, so that it is not taken for a placeholder.
    let page = filled();
    let (head, rest) = page.split_once(LINK).unwrap_or((&page, ""));
    let (body, rest) = rest.split_once(SCENE).unwrap_or((rest, ""));
    let (scripts, after) = rest.split_once(INTERVALS).unwrap_or((rest, ""));
    for part in [head, &link.tags(S::ABOUT, size), body, &scene, scripts] {
        put(out, part)?;
    }
    let mut count = 0;
    source.parts(&mut |bytes| {
        let text = text(bytes);
        if text.len() > LONGEST {
            return Err(PageError::TooLong(text.len()));
        }
        put(out, &format!("<script type=\"text/plain\" id=\"interval-{count}\">"))?;
        put(out, &text)?;
        put(out, "</script>\n")?;
        count += 1;
        Ok(())
    })?;
    put(out, after)?;
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MARKS: [&str; 6] = [STYLE, WORKER, SCRIPT, SCENE, LINK, INTERVALS];

    #[test]
    fn every_part_has_its_place_and_ends_no_element_early() {
        for mark in MARKS {
            assert_eq!(TEMPLATE.matches(mark).count(), 1, "{mark}");
        }
        for part in SCRIPT_FILES.into_iter().chain(WORKER_FILES).chain([include_str!("page.css")]) {
            assert!(!part.contains("</script") && !part.contains("</style"));
            assert!(MARKS.iter().all(|mark| !part.contains(mark)));
        }
    }

    #[test]
    fn the_player_is_joined_without_imports_and_exports() {
        for script in [joined(&SCRIPT_FILES), joined(&WORKER_FILES)] {
            assert!(!script.lines().any(|line| line.starts_with("import ") || line.starts_with("export ")));
        }
    }

    /// Names that a line declares at a script's top level, as the modules are written: one statement a line.
    fn declared(line: &str) -> Vec<String> {
        let Some((word, rest)) = line.split_once(' ') else { return Vec::new() };
        // Shaders are text in the modules, and declare types.
        if ["float", "int", "uint", "vec"].iter().any(|kind| rest.starts_with(kind)) {
            return Vec::new();
        }
        let names = match (word, rest.strip_prefix("function")) {
            ("const" | "let", _) => rest.split('=').next().unwrap_or_default(),
            ("class" | "function", _) => rest.split(['(', ' ']).next().unwrap_or_default(),
            ("async", Some(rest)) => rest.split('(').next().unwrap_or_default(),
            _ => return Vec::new(),
        };
        let parts = names.split(|c: char| !c.is_alphanumeric() && c != '_' && c != '$');
        parts.filter(|name| !name.is_empty()).map(str::to_owned).collect()
    }

    #[test]
    fn no_name_is_declared_twice_in_a_joined_script() {
        for script in [joined(&SCRIPT_FILES), joined(&WORKER_FILES)] {
            let mut seen = std::collections::BTreeSet::new();
            let again: Vec<String> =
                script.lines().flat_map(declared).filter(|name| !seen.insert(name.clone())).collect();
            assert!(again.is_empty() && seen.len() > 100, "{again:?} of {} names", seen.len());
        }
    }

    #[test]
    fn the_page_names_no_other_place() {
        let page = bare();
        // Names of namespaces are not addresses.
        let page = page.replace("http://www.w3.org/2000/svg", "");
        for address in ["http:", "https:", "src=", "@import", "url(", "import("] {
            assert!(!page.contains(address), "{address}");
        }
        assert!(page.contains("default-src 'none'") && page.contains("connect-src 'self'"));
    }

    #[test]
    fn a_link_is_described_whatever_the_title() {
        let link =
            Link { title: "a \"b\" <c>".into(), url: Some("https://d.example/?e&f".into()), image: "g.png".into() };
        let tags = link.tags("h", [512, 288]);
        for expected in [
            r#""og:title" content="a &quot;b&quot; &lt;c>""#,
            r#""og:url" content="https://d.example/?e&amp;f""#,
            r#""og:image" content="g.png""#,
            r#""og:image:width" content="512""#,
            r#""og:description" content="h""#,
        ] {
            assert!(tags.contains(expected), "{expected}: {tags}");
        }
    }
}
