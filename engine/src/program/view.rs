//! `view`: a page that shows a scene in a browser, served or written as one file.

use std::io::{BufWriter, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use streamsplat::import::open_moving;
use streamsplat::output::Partial;
use streamsplat::view::{PageError, Recorded, Server, write_page};

use super::cli::{Console, ViewArgs};
use super::failure::Failure;
use super::{say, stop};

/// The port that is tried where none is given.
pub const PORT: u16 = 8707;
/// How often it is looked whether the user asked to stop.
const LOOK: Duration = Duration::from_millis(50);

/// Serves until Ctrl-C, or writes the file.
pub fn command(args: &ViewArgs, console: &Console) -> Result<(), Failure> {
    let workers = args.machine.workers()?;
    let scene = open_moving(&args.scene, &args.limit.limits())?;
    let source = Recorded::new(title(&args.scene), scene, workers);
    if let Some(file) = &args.html {
        let bytes = write_file(&source, file)?;
        if !console.quiet {
            say(format!("{}: {bytes} bytes", file.display()))?;
        }
        return Ok(());
    }
    stop::listen();
    let server =
        Server::start(SocketAddr::new(args.host, args.port.unwrap_or(PORT)), &args.allow_host, Arc::new(source))?;
    if !console.quiet {
        say(format!("http://{}/ (Ctrl-C ends it)", server.address()))?;
    }
    while !stop::asked() {
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Writes the page with the scene in it: whole or not at all.
fn write_file(source: &Recorded, file: &Path) -> Result<u64, Failure> {
    let partial = Partial::create(file)?;
    let failed = |e: std::io::Error| Failure::work(format!("{}: cannot write: {e}", file.display()));
    let mut out = BufWriter::new(std::fs::File::create(partial.path()).map_err(failed)?);
    let bytes = write_page(source, &mut out).map_err(|e| match e {
        PageError::Write(e) => failed(e),
        other => other.into(),
    })?;
    out.flush().map_err(failed)?;
    drop(out);
    partial.keep()?;
    Ok(bytes)
}

/// What the page calls what is at `path`: the last name of it that says something.
pub fn title(path: &Path) -> String {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let generic = ["scene", "scene.json"];
    let names = path.iter().rev().map(|name| name.to_string_lossy().into_owned());
    names
        .clone()
        .find(|name| !generic.contains(&name.as_str()) && name != "/")
        .or(names.clone().next())
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_title_is_the_name_that_says_something() {
        for (path, expected) in [
            ("/a/b/out", "out"),
            ("/a/out/scene", "out"),
            ("/a/out/scene/scene.json", "out"),
            ("/a/clip.mp4", "clip.mp4"),
        ] {
            assert_eq!(title(Path::new(path)), expected);
        }
    }
}
