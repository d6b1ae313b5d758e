//! The page and its scene over HTTP.

use std::net::SocketAddr;
use std::sync::Arc;

use super::http::{Answer, Hosts, Listener, Request};
use super::{Source, page};

/// The server cannot start: the address is in use or not available, or there is no thread.
#[derive(Debug, thiserror::Error)]
#[error("cannot serve on {address}: {cause}")]
pub struct ServeError {
    address: SocketAddr,
    cause: std::io::Error,
}

/// Serves a page until it is dropped; an answer in progress may take longer.
///
/// | path | answer |
/// |---|---|
/// | `/` | the page |
/// | `/scene.json?from=N` | the [`Description`](super::Description) with its intervals from number N on |
/// | `/interval/N` | a [`packet`](mod@super::packet) |
///
/// Anything else is not found. [`mod@super::http`] lists what is refused, and the limits for clients.
pub struct Server {
    listener: Listener,
}

impl Server {
    /// Serves `source` on `address`; port 0 takes any free port. Requests may use these `names` for the server, and
    /// those of [`Hosts::of`].
    ///
    /// # Errors
    /// An address that cannot be listened on.
    pub fn start(address: SocketAddr, names: &[String], source: Arc<dyn Source>) -> Result<Server, ServeError> {
        let page: Arc<[u8]> = page::bare().into_bytes().into();
        let answer = move |request: &Request| match request.path.as_str() {
            "/" => Answer { status: 200, media_type: "text/html; charset=utf-8", body: page.clone() },
            "/scene.json" => description(&*source, &request.query),
            path => interval(&*source, path),
        };
        let listener = Listener::start(address, Hosts::of(address.ip(), names), answer)
            .map_err(|cause| ServeError { address, cause })?;
        Ok(Server { listener })
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.listener.address()
    }
}

fn description(source: &dyn Source, query: &str) -> Answer {
    let from = query.split('&').find_map(|pair| pair.strip_prefix("from="));
    let Ok(from) = from.map_or(Ok(0), str::parse) else {
        return Answer::text(400, "from: expected a number of an interval\n");
    };
    match serde_json::to_vec(&source.describe(from)) {
        Ok(json) => Answer { status: 200, media_type: "application/json", body: json.into() },
        Err(e) => Answer::text(500, &format!("{e}\n")),
    }
}

fn interval(source: &dyn Source, path: &str) -> Answer {
    let number = path.strip_prefix("/interval/").and_then(|n| n.parse().ok());
    match number.map(|i| source.packet(i)) {
        Some(Ok(Some(body))) => Answer { status: 200, media_type: "application/octet-stream", body },
        Some(Err(e)) => Answer::text(500, &format!("{e}\n")),
        Some(Ok(None)) | None => Answer::text(404, "not found\n"),
    }
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
        Server::start(SocketAddr::from(([127, 0, 0, 1], 0)), &["box.example".into()], Arc::new(live))
            .expect("a free port")
    }

    #[test]
    fn the_page_the_scene_and_nothing_else_is_served() {
        let server = server();
        let (status, page) = get(&server, "/", "localhost");
        assert!(status == 200 && page.contains("<!doctype html>") && page.contains("nosniff"));
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
        let (status, text) = ask(&server, post);
        assert!(status == 405 && text.contains("Allow: GET, HEAD"), "{text}");
        let (status, head) = ask(&server, "HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n");
        let body = page.split_once("\r\n\r\n").expect("a head").1;
        let length = format!("Content-Length: {}\r\n", body.len());
        assert!(status == 200 && head.ends_with("\r\n\r\n") && head.contains(&length), "{head}");
    }

    #[test]
    fn other_names_than_this_machines_are_refused() {
        let server = server();
        for host in ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "10.0.0.1"] {
            assert_eq!(get(&server, "/", host).0, 403, "{host}");
        }
        for host in ["LOCALHOST:1", "127.0.0.1", "127.8.9.1:5", "[::1]", "box.example:8707"] {
            assert_eq!(get(&server, "/", host).0, 200, "{host}");
        }
    }

    #[test]
    fn a_taken_port_is_an_error_and_a_stopped_server_frees_it() {
        let first = server();
        let address = first.address();
        let source = || Arc::new(Live::new("b", 1.0, 0));
        let error = Server::start(address, &[], source()).err().expect("taken").to_string();
        assert!(error.contains(&address.to_string()), "{error}");
        drop(first);
        Server::start(address, &[], source()).expect("free again");
    }
}
