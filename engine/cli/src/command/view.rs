//! `view`: a page that shows a scene, in time or still, in a browser, served or written as one file.

use std::io::{BufWriter, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use streamsplat::import::Opened;
use streamsplat::output::{Partial, write_whole};
use streamsplat::view::{Link, PageError, Recorded, Server, StillSource, Whole, poster, write_page};

use crate::console::failure::Failure;
use crate::console::opening::open_along;
use crate::console::serving::title;
use crate::console::{Console, say};
use crate::options::args::ViewArgs;

/// The port that is tried where none is given.
pub const PORT: u16 = 8707;
/// How often it is looked whether the user asked to stop.
const LOOK: Duration = Duration::from_millis(50);

/// Shows a scene of any kind.
pub fn command(args: &ViewArgs, console: &Console) -> Result<(), Failure> {
    if let Some(url) = args.url.as_deref().filter(|url| !is_address(url)) {
        let found = url.escape_debug();
        return Err(Failure::usage(format!("--url {found}: expected an address that begins with https:// or http://")));
    }
    let workers = args.machine.workers()?;
    let name = title(&args.scene);
    match open_along(&args.scene, &args.limit.limits(), args.reading.axes()?, Some(&workers), console)? {
        Opened::Moving(scene) => show(Recorded::new(name, scene, workers), args, console),
        Opened::Still(file) => show(StillSource::new(name, file, workers)?, args, console),
    }
}

/// Returns true for an `http` or `https` address, which a browser opens as a page, and false for others, such as a script's.
fn is_address(url: &str) -> bool {
    let lower = url.to_ascii_lowercase();
    let rest = lower.strip_prefix("https://").or_else(|| lower.strip_prefix("http://"));
    rest.is_some_and(|rest| !rest.is_empty()) && !url.chars().any(|c| c.is_control() || c.is_whitespace())
}

/// Serves until Ctrl-C, or writes the file.
fn show(source: impl Whole + 'static, args: &ViewArgs, console: &Console) -> Result<(), Failure> {
    if let Some(file) = &args.html {
        let image = file.with_extension("png");
        let link = link(title(&args.scene), args.url.as_deref(), file, &image);
        let bytes = write_file(&source, &link, file)?;
        write_whole(&image, &poster(&source)?.0)?;
        if !console.quiet {
            let (page, image) = (file.display(), image.display());
            say(format!("{page}: {:.1} MB; {image}: what a link to it shows", bytes as f64 / 1e6))?;
        }
        return Ok(());
    }
    console.listen();
    let server =
        Server::start(SocketAddr::new(args.host, args.port.unwrap_or(PORT)), &args.allow_host, Arc::new(source))?;
    if !console.quiet {
        say(format!("http://{}/ (Ctrl-C ends it)", server.address()))?;
    }
    while !console.stop.asked() {
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Tags by which a link to the page shows something: the poster lies beside the page.
fn link(title: String, url: Option<&str>, file: &Path, image: &Path) -> Link {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let folder = url.map(|url| url.strip_suffix(&name(file)).unwrap_or(url));
    let image =
        folder.map_or_else(|| name(image), |folder| format!("{}/{}", folder.trim_end_matches('/'), name(image)));
    Link { title, url: url.map(str::to_owned), image }
}

/// Writes the page with the scene in it: whole or not at all.
fn write_file(source: &impl Whole, link: &Link, file: &Path) -> Result<u64, Failure> {
    let partial = Partial::create(file)?;
    let failed = |e: std::io::Error| Failure::work(format!("{}: cannot write: {e}", file.display()));
    let mut out = BufWriter::new(std::fs::File::create(partial.path()).map_err(failed)?);
    let bytes = write_page(source, link, &mut out).map_err(|e| match e {
        PageError::Write(e) => failed(e),
        other => other.into(),
    })?;
    out.flush().map_err(failed)?;
    drop(out);
    partial.keep()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_pages_are_taken() {
        for url in ["https://example.org/a.html", "http://localhost:1/", "HTTPS://example.org"] {
            assert!(is_address(url), "{url}");
        }
        for url in
            ["javascript:alert(1)", "data:text/html,x", "https://", "//example.org", "https://a b", "https://a\n"]
        {
            assert!(!is_address(url), "{url}");
        }
    }
}
