//! A request's head.

use super::MAX_HEADERS;

/// Parsed head of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// True if the response has a body: GET, not HEAD.
    pub body: bool,
    /// The path of the target, as it was sent.
    pub path: String,
    /// Query string: the part of the target after `?`.
    pub query: String,
    /// The `Host` header.
    pub host: String,
}

/// Why a request is not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// It is not HTTP/1.
    #[error("expected a request of HTTP/1.1")]
    Malformed,
    /// It has no host, or several.
    #[error("expected one Host header")]
    Host,
    /// Its host is not a name of this server.
    #[error("this server does not answer to that name")]
    Name,
    /// It is neither GET nor HEAD.
    #[error("expected GET or HEAD")]
    Method,
    /// Its head is too long.
    #[error("the request's head is too long")]
    Long,
    /// Its head did not come in time.
    #[error("the request did not come in time")]
    Late,
}

impl Refusal {
    /// The status code of this refusal.
    pub fn status(self) -> u16 {
        match self {
            Refusal::Malformed | Refusal::Host => 400,
            Refusal::Name => 403,
            Refusal::Method => 405,
            Refusal::Late => 408,
            Refusal::Long => 431,
        }
    }
}

impl Request {
    /// Parses the request whose head `bytes` begin with; `None` if the head is incomplete.
    ///
    /// # Errors
    /// Anything other than one well-formed GET or HEAD with one `Host`.
    pub fn parse(bytes: &[u8]) -> Result<Option<Request>, Refusal> {
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut head = httparse::Request::new(&mut headers);
        match head.parse(bytes) {
            Ok(httparse::Status::Complete(_)) => {}
            Ok(httparse::Status::Partial) => return Ok(None),
            Err(httparse::Error::TooManyHeaders) => return Err(Refusal::Long),
            Err(_) => return Err(Refusal::Malformed),
        }
        let (Some(method), Some(target)) = (head.method, head.path) else { return Err(Refusal::Malformed) };
        let mut hosts = head.headers.iter().filter(|header| header.name.eq_ignore_ascii_case("host"));
        let (Some(host), None) = (hosts.next(), hosts.next()) else { return Err(Refusal::Host) };
        let host = std::str::from_utf8(host.value).map_err(|_| Refusal::Host)?.trim().to_owned();
        let body = match method {
            "GET" => true,
            "HEAD" => false,
            _ => return Err(Refusal::Method),
        };
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        Ok(Some(Request { body, path: path.to_owned(), query: query.to_owned(), host }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_is_read_once_it_is_whole() {
        let text = b"GET /a?from=3 HTTP/1.1\r\nAccept: x\r\nhOST:  here:80 \r\n\r\nmore";
        let end = text.len() - 4;
        for cut in 0..end {
            assert_eq!(Request::parse(&text[..cut]), Ok(None), "{cut}");
        }
        let expected = Request { body: true, path: "/a".into(), query: "from=3".into(), host: "here:80".into() };
        assert_eq!(Request::parse(&text[..end]), Ok(Some(expected.clone())));
        assert_eq!(Request::parse(text), Ok(Some(expected)));
        let head = Request::parse(b"HEAD / HTTP/1.1\r\nHost: h\r\n\r\n").expect("well-formed").expect("whole");
        assert!(!head.body && head.path == "/" && head.query.is_empty());
    }

    #[test]
    fn other_heads_are_refused() {
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(MAX_HEADERS + 1));
        for (text, refusal) in [
            (&b"\x16\x03\x01\x02\x00\x01"[..], Refusal::Malformed),
            (b"GET / SPDY/3\r\n\r\n", Refusal::Malformed),
            (b"GET / HTTP/1.1\r\nbroken\r\n\r\n", Refusal::Malformed),
            (b"GET / HTTP/1.1\r\nHost : h\r\n\r\n", Refusal::Malformed),
            (b"GET / HTTP/1.1\r\n\r\n", Refusal::Host),
            (b"GET / HTTP/1.1\r\nHost: a\r\nHost: a\r\n\r\n", Refusal::Host),
            (b"GET / HTTP/1.1\r\nHost: \xff\r\n\r\n", Refusal::Host),
            (b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 1000000000000000\r\n\r\n", Refusal::Method),
            (many.as_bytes(), Refusal::Long),
        ] {
            assert_eq!(Request::parse(text), Err(refusal), "{}", String::from_utf8_lossy(text));
        }
    }
}
