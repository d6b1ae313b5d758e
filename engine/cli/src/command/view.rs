//! `view`: a page that shows a scene, in time or still, in a browser. The page is served or written as one file.

use std::io::{BufWriter, Write};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use streamsplat::open::Opened;
use streamsplat::output::{Partial, folder_of, write_whole};
use streamsplat::run::Stop;
use streamsplat::view::{Link, PageError, Recorded, Server, StillSource, Whole, poster, write_page};

use crate::command::export::camera_of;
use crate::console::failure::Failure;
use crate::console::opening::{open_along, say_of};
use crate::console::serving::title;
use crate::console::{Console, say};
use crate::options::args::ViewArgs;

/// The default port.
pub const PORT: u16 = 8707;
/// Interval at which stop requests are polled.
const LOOK: Duration = Duration::from_millis(50);

/// Shows a scene of any kind.
pub fn command(args: &ViewArgs, console: &Console) -> Result<(), Failure> {
    if let Some(url) = args.url.as_deref().filter(|url| !is_address(url)) {
        let found = url.escape_debug();
        return Err(Failure::usage(format!("--url {found}: expected an address that begins with https:// or http://")));
    }
    if let Some(file) = &args.html
        && !file
            .extension()
            .is_some_and(|ending| ["html", "htm"].iter().any(|known| ending.eq_ignore_ascii_case(known)))
    {
        return Err(Failure::usage(format!("--html {}: expected a name that ends in .html or .htm", file.display())));
    }
    let workers = args.machine.workers()?;
    let name = title(&args.scene);
    match open_along(&args.scene, &args.limit.limits(), args.reading.axes()?, Some(&workers), console)? {
        Opened::Moving(scene) => show(Recorded::new(name, scene, workers), args, console),
        Opened::Still(file) => {
            let mut source = StillSource::new(name, file, workers)?;
            see_as_exported(&mut source, &args.scene, console)?;
            show(source, args, console)
        }
    }
}

/// Shows a scene first from the camera that was exported with the file at `path`, if there is one.
fn see_as_exported(source: &mut StillSource, path: &Path, console: &Console) -> Result<(), Failure> {
    let Some(file) = camera_of(path) else { return Ok(()) };
    let wrong = |e: &dyn std::fmt::Display| Failure::work(format!("{}: {e}", file.display()));
    let text = std::fs::read_to_string(&file).map_err(|e| wrong(&e))?;
    let camera = streamsplat::camera::file::parse(&text).map_err(|e| wrong(&e))?.at(0.0);
    let seen = if source.seen_from(&camera) { "seen first from" } else { "the page has no view like" };
    say_of(path, &[format!("{seen} {}", file.display())], console);
    Ok(())
}

/// Returns true for an `http` or `https` address, which a browser opens as a page; false for other addresses, for
/// example of scripts.
fn is_address(url: &str) -> bool {
    let lower = url.to_ascii_lowercase();
    let rest = lower.strip_prefix("https://").or_else(|| lower.strip_prefix("http://"));
    rest.is_some_and(|rest| !rest.is_empty()) && !url.chars().any(|c| c.is_control() || c.is_whitespace())
}

/// Serves until Ctrl-C, or writes the file.
fn show(source: impl Whole + 'static, args: &ViewArgs, console: &Console) -> Result<(), Failure> {
    if let Some(file) = &args.html {
        let image = file.with_extension("png");
        if image.exists() && !file.exists() {
            let found = image.display();
            return Err(Failure::usage(format!(
                "--html {}: expected no {found}, where the page's poster goes, found one without its page, which is left: name the page otherwise",
                file.display()
            )));
        }
        let folder = folder_of(file);
        std::fs::create_dir_all(folder)
            .map_err(|e| Failure::work(format!("{}: cannot create: {e}", folder.display())))?;
        let link = link(title(&args.scene), args.url.as_deref(), file, &image);
        console.listen();
        let bytes = write_file(&source, &link, file, &console.stop)?;
        write_whole(&image, &poster(&source)?.0)?;
        if !console.quiet {
            let (page, image) = (file.display(), image.display());
            say(format!("{page}: {:.1} MB; {image}: what a link to it shows, in the same folder", bytes as f64 / 1e6))?;
            if args.url.is_none() {
                say("Most programs that show links need the address: --url https://…/PAGE.html")?;
            }
        }
        return Ok(());
    }
    console.listen();
    let server =
        Server::start(SocketAddr::new(args.host, args.port.unwrap_or(PORT)), &args.allow_host, Arc::new(source))?;
    if !console.quiet {
        let address = server.address();
        say(format!("http://{}/ (Ctrl-C ends it)", reached(address)))?;
        if let Some(line) = tunnel(address, std::env::var("SSH_CONNECTION").ok().as_deref()) {
            say(line)?;
        }
    }
    while !console.stop.asked() {
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Returns an address at which a server that listens on `address` can be reached. If it listens on all addresses, this
/// is the machine's own address in its network or, without one, the loopback address.
fn reached(address: SocketAddr) -> SocketAddr {
    if !address.ip().is_unspecified() {
        return address;
    }
    // Nothing is sent: the system only looks up the source address. The target address is reserved for documentation.
    let own = || {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
        socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9)).ok()?;
        Some(socket.local_addr().ok()?.ip()).filter(|ip| !ip.is_unspecified())
    };
    SocketAddr::new(own().unwrap_or(Ipv4Addr::LOCALHOST.into()), address.port())
}

/// Returns the ssh command by which another machine reaches the page. There is one if the server listens beyond
/// loopback, or if it was started through ssh; then `SSH_CONNECTION` holds the address and port of both sides, the
/// other side's first.
fn tunnel(address: SocketAddr, connection: Option<&str>) -> Option<String> {
    let here = connection.and_then(|connection| connection.split(' ').nth(2)).map(str::to_owned);
    if address.ip().is_loopback() && here.is_none() {
        return None;
    }
    let here = here.unwrap_or_else(|| reached(address).ip().to_string());
    let port = address.port();
    let end = if address.ip().is_unspecified() { SocketAddr::from((Ipv4Addr::LOCALHOST, port)) } else { address };
    Some(format!("from another machine: ssh -N -L {port}:{end} {here}, then http://localhost:{port}/"))
}

/// Returns the tags for the preview of a link to the page; the poster is next to the page.
fn link(title: String, url: Option<&str>, file: &Path, image: &Path) -> Link {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let folder = url.map(|url| url.strip_suffix(&name(file)).unwrap_or(url));
    let image =
        folder.map_or_else(|| name(image), |folder| format!("{}/{}", folder.trim_end_matches('/'), name(image)));
    Link { title, url: url.map(str::to_owned), image }
}

/// A file that takes nothing more once a stop is requested.
struct UntilStopped<'a>(std::fs::File, &'a Stop);

impl Write for UntilStopped<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.1.asked() { Err(std::io::Error::other("stopped")) } else { self.0.write(bytes) }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

/// Writes the page with the scene in it, completely or not at all.
fn write_file(source: &impl Whole, link: &Link, file: &Path, stop: &Stop) -> Result<u64, Failure> {
    let partial = Partial::create(file)?;
    let failed = |e: std::io::Error| Failure::work(format!("{}: cannot write: {e}", file.display()));
    let mut out = BufWriter::new(UntilStopped(std::fs::File::create(partial.path()).map_err(failed)?, stop));
    let written = write_page(source, link, &mut out).and_then(|bytes| Ok(out.flush().map(|()| bytes)?));
    let bytes = written.map_err(|e| match e {
        _ if stop.asked() => Failure::Stopped(format!("{}: stopped; nothing was written", file.display())),
        PageError::Write(e) => failed(e),
        other => other.into(),
    })?;
    drop(out);
    partial.keep()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_for_all_has_an_address_and_the_way_through_ssh() {
        let all: SocketAddr = "0.0.0.0:8707".parse().expect("an address");
        let found = reached(all);
        assert!(!found.ip().is_unspecified() && found.port() == 8707, "{found}");
        let expected = format!("ssh -N -L 8707:127.0.0.1:8707 {}, then http://localhost:8707/", found.ip());
        assert!(tunnel(all, None).is_some_and(|line| line.ends_with(&expected)));
        let own: SocketAddr = "127.0.0.1:9".parse().expect("an address");
        assert_eq!((reached(own), tunnel(own, None)), (own, None));
        let line = tunnel(own, Some("10.0.0.7 52000 10.0.0.1 22")).expect("a line");
        assert!(line.contains("ssh -N -L 9:127.0.0.1:9 10.0.0.1,"), "{line}");
        let six: SocketAddr = "[fd00::1]:9".parse().expect("an address");
        assert!(tunnel(six, None).is_some_and(|line| line.contains("-L 9:[fd00::1]:9 fd00::1,")));
    }

    #[test]
    fn a_page_takes_nothing_more_once_it_is_stopped() {
        let stop = Stop::default();
        let mut page = UntilStopped(tempfile::tempfile().expect("writable"), &stop);
        assert!(page.write_all(b"<").is_ok());
        stop.ask();
        assert!(page.write_all(b"<").is_err());
    }

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
