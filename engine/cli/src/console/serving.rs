//! `run --serve`: the stream in a browser while it is processed.

use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use streamsplat::stream::Interval;
use streamsplat::view::{Live, Server};

use crate::console::Console;
use crate::console::failure::Failure;

/// Bytes of packets kept for browsers, so that memory does not grow with the stream.
const KEPT: usize = 512 << 20;
/// Interval at which stop requests are polled.
const LOOK: Duration = Duration::from_millis(50);

/// A page that is being served.
pub struct Serving {
    live: Arc<Live>,
    server: Server,
}

impl Serving {
    /// Starts a server on the loopback address.
    pub fn start(port: u16, input: &Path, fps: f64, console: &Console) -> Result<Serving, Failure> {
        let live = Arc::new(Live::new(title(input), fps, KEPT));
        let server = Server::start(SocketAddr::from((Ipv4Addr::LOCALHOST, port)), &[], live.clone())?;
        if !console.quiet {
            // Standard output may carry the video.
            let _ = writeln!(std::io::stderr(), "http://{}/", server.address());
        }
        Ok(Serving { live, server })
    }

    /// Adds an interval to the page.
    pub fn push(&self, interval: &Interval) {
        self.live.push(interval);
    }

    /// Marks the end of the stream.
    pub fn complete(&self) {
        self.live.complete();
    }

    /// Keeps the page until the user asks to stop.
    pub fn linger(self, console: &Console) {
        console.note(&[format!("http://{}/ shows it until Ctrl-C", self.server.address())]);
        while !console.stop.asked() {
            std::thread::sleep(LOOK);
        }
    }
}

/// Returns the title of the page for a scene at `path`: the last component other than `scene` and `scene.json`.
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
