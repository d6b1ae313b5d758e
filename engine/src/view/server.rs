//! The page and its scene over HTTP.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tiny_http::{Header, Method, Request, Response};

use super::{Source, page};

/// Requests answered at the same time.
const THREADS: usize = 3;
/// How long a thread waits for a request before it looks whether it should end.
const WAIT: Duration = Duration::from_millis(100);

/// Why nothing is served.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The address is taken, or not ours.
    #[error("cannot serve on {address}: {cause}")]
    Address {
        /// The address.
        address: SocketAddr,
        /// The system's answer.
        cause: String,
    },
    /// Threads cannot be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

/// Serves a page until it is dropped; an answer under way may take longer.
///
/// | path | answer |
/// |---|---|
/// | `/` | the page |
/// | `/scene.json?from=N` | the [`Description`](super::Description), its intervals from number N on |
/// | `/interval/N` | a [`packet`](mod@super::packet) |
///
/// Anything else is not found; other methods than GET and HEAD are refused. On a loopback address requests that name another
/// host than this machine are refused too, so that no web page can reach the scene under a name of its own.
pub struct Server {
    address: SocketAddr,
    ending: Arc<AtomicBool>,
    asked: Arc<AtomicBool>,
}

/// What answers requests.
struct Answers {
    source: Arc<dyn Source>,
    page: String,
    local: bool,
}

impl Server {
    /// Serves `source` on `address`; port 0 takes any free port.
    ///
    /// # Errors
    /// An address that cannot be listened on.
    pub fn start(address: SocketAddr, source: Arc<dyn Source>) -> Result<Server, ServeError> {
        let failed = |cause: &dyn std::fmt::Display| ServeError::Address { address, cause: cause.to_string() };
        let http = Arc::new(tiny_http::Server::http(address).map_err(|e| failed(&e))?);
        let address = http.server_addr().to_ip().ok_or_else(|| failed(&"no network address"))?;
        let (before, after) = page::halves();
        let answers = Arc::new(Answers { source, page: before + &after, local: address.ip().is_loopback() });
        let server = Server { address, ending: Arc::default(), asked: Arc::default() };
        for _ in 0..THREADS {
            let (http, answers) = (http.clone(), answers.clone());
            let (ending, asked) = (server.ending.clone(), server.asked.clone());
            let work = move || {
                while !ending.load(Ordering::SeqCst) {
                    if let Ok(Some(request)) = http.recv_timeout(WAIT) {
                        asked.store(true, Ordering::SeqCst);
                        answers.answer(request);
                    }
                }
            };
            std::thread::Builder::new().spawn(work).map_err(ServeError::Thread)?;
        }
        Ok(server)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether anything was asked for since this was last called.
    pub fn was_asked(&self) -> bool {
        self.asked.swap(false, Ordering::SeqCst)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // The threads are not waited for: one may be writing to a browser that has stopped reading.
        self.ending.store(true, Ordering::SeqCst);
    }
}

impl Answers {
    /// Answers; a reader that has gone away is nobody's failure.
    fn answer(&self, request: Request) {
        let (path, query) = request.url().split_once('?').unwrap_or((request.url(), ""));
        let known = [Method::Get, Method::Head].contains(request.method());
        let (status, kind, body): (u16, &str, Arc<[u8]>) = if !(known && self.is_for_us(&request)) {
            (403, TEXT, b"refused\n"[..].into())
        } else {
            match path {
                "/" => (200, "text/html; charset=utf-8", self.page.as_bytes().into()),
                "/scene.json" => self.description(query),
                _ => self.interval(path),
            }
        };
        let length = body.len();
        let headers = [
            ("Content-Type", kind),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
        ];
        let headers = headers.iter().filter_map(|(name, value)| Header::from_bytes(*name, *value).ok()).collect();
        let body = std::io::Cursor::new(body);
        // With its length, never in chunks.
        let _ = request.respond(
            Response::new(status.into(), headers, body, Some(length), None).with_chunked_threshold(usize::MAX),
        );
    }

    /// Whether the request names this machine, where only it should.
    fn is_for_us(&self, request: &Request) -> bool {
        let host = request.headers().iter().find(|h| h.field.equiv("Host"));
        !self.local || host.is_none_or(|host| is_local(host.value.as_str()))
    }

    fn description(&self, query: &str) -> (u16, &'static str, Arc<[u8]>) {
        let from = query.split('&').find_map(|pair| pair.strip_prefix("from="));
        match (from.map_or(Ok(0), str::parse), "from: expected a number of an interval\n") {
            (Ok(from), _) => match serde_json::to_vec(&self.source.describe(from)) {
                Ok(json) => (200, "application/json", json.into()),
                Err(e) => (500, TEXT, format!("{e}\n").into_bytes().into()),
            },
            (Err(_), message) => (400, TEXT, message.as_bytes().into()),
        }
    }

    fn interval(&self, path: &str) -> (u16, &'static str, Arc<[u8]>) {
        let number = path.strip_prefix("/interval/").and_then(|n| n.parse().ok());
        match number.map(|i| self.source.packet(i)) {
            Some(Ok(Some(packet))) => (200, "application/octet-stream", packet),
            Some(Err(e)) => (500, TEXT, format!("{e}\n").into_bytes().into()),
            Some(Ok(None)) | None => (404, TEXT, b"not found\n"[..].into()),
        }
    }
}

const TEXT: &str = "text/plain; charset=utf-8";

/// Whether a `Host` header names this machine as it names itself.
fn is_local(host: &str) -> bool {
    if let Ok(address) = host.parse::<SocketAddr>() {
        return address.ip().is_loopback();
    }
    let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
    if let Ok(address) = bare.parse::<IpAddr>() {
        return address.is_loopback();
    }
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    name.eq_ignore_ascii_case("localhost")
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;

    use super::*;
    use crate::view::Live;

    /// Status line, headers and body of an answer.
    fn ask(server: &Server, request: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(server.address()).expect("listening");
        stream.write_all(request.as_bytes()).expect("open");
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).expect("answered");
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let status = text.split(' ').nth(1).and_then(|s| s.parse().ok()).expect("a status");
        (status, text)
    }

    fn get(server: &Server, path: &str, host: &str) -> (u16, String) {
        ask(server, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"))
    }

    fn server() -> Server {
        let live = Live::new("a \"stream\"", 24.0, 1 << 20);
        Server::start(SocketAddr::from(([127, 0, 0, 1], 0)), Arc::new(live)).expect("a free port")
    }

    #[test]
    fn the_page_the_scene_and_nothing_else_is_served() {
        let server = server();
        assert!(!server.was_asked());
        let (status, page) = get(&server, "/", "localhost");
        assert!(status == 200 && page.contains("<!doctype html>") && page.contains("nosniff"));
        assert!(server.was_asked() && !server.was_asked());
        let (status, json) = get(&server, "/scene.json?from=3", "127.0.0.1:80");
        assert!(status == 200 && json.contains(r#""title":"a \"stream\"""#) && json.contains(r#""from":3"#), "{json}");
        for (path, expected) in [
            ("/scene.json?from=x", 400),
            ("/interval/0", 404),
            ("/interval/-1", 404),
            ("/interval/99999999999999999999999", 404),
            ("/../etc/passwd", 404),
            ("/favicon.ico", 404),
        ] {
            assert_eq!(get(&server, path, "[::1]:3").0, expected, "{path}");
        }
        let post = "POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        assert_eq!(ask(&server, post).0, 403);
    }

    #[test]
    fn other_names_than_this_machines_are_refused() {
        let server = server();
        for host in ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "10.0.0.1"] {
            assert_eq!(get(&server, "/", host).0, 403, "{host}");
        }
        for host in ["LOCALHOST:1", "127.0.0.1", "127.8.9.1:5", "[::1]"] {
            assert_eq!(get(&server, "/", host).0, 200, "{host}");
        }
    }

    #[test]
    fn a_taken_port_is_an_error_and_a_stopped_server_frees_it() {
        let first = server();
        let address = first.address();
        let source = || Arc::new(Live::new("b", 1.0, 0));
        let error = Server::start(address, source()).err().expect("taken").to_string();
        assert!(error.contains(&address.to_string()), "{error}");
        drop(first);
        // The listener closes a moment after its last user.
        let again = (0..50).find_map(|_| {
            std::thread::sleep(Duration::from_millis(20));
            Server::start(address, source()).ok()
        });
        assert!(again.is_some());
    }
}
