//! One connection: a request is read and answered, each within its time limit.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use super::{ANSWER_RATE, ANSWER_TIME, Answer, HEAD_TIME, Hosts, MAX_HEAD, Refusal, Request};

/// Bytes written at once.
const PIECE: usize = 64 << 10;
/// Time and bytes for which a client's data are still read after its answer.
const LINGER: (Duration, usize) = (Duration::from_millis(500), 256 << 10);

/// Reads one request and answers it. A client that has disconnected is not an error.
pub(super) fn serve(mut stream: TcpStream, hosts: &Hosts, answer: &impl Fn(&Request) -> Answer) {
    let Ok(request) = read(&mut stream) else { return };
    let refused = |refusal: Refusal| Answer::text(refusal.status(), &format!("{refusal}\n"));
    let (answer, wanted) = match request {
        Ok(request) if !hosts.contain(&request.host) => (refused(Refusal::Name), request.body),
        Ok(request) => {
            let made = catch_unwind(AssertUnwindSafe(|| answer(&request)));
            (made.unwrap_or_else(|_| Answer::text(500, "the answer could not be made\n")), request.body)
        }
        Err(refusal) => (refused(refusal), true),
    };
    let body: &[u8] = if wanted { &answer.body } else { &[] };
    if write(&mut stream, &answer, body).is_ok() {
        linger(&mut stream);
    }
}

/// Returns the time left until `end`; an error if there is none.
fn left(end: Instant) -> io::Result<Duration> {
    let left = end.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(io::ErrorKind::TimedOut.into()) } else { Ok(left) }
}

/// Returns true if a read or write timed out; the error kind differs between systems.
fn is_late(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock)
}

/// Reads the request, or returns why there is none; an error where the client has disconnected.
fn read(stream: &mut TcpStream) -> io::Result<Result<Request, Refusal>> {
    let end = Instant::now() + HEAD_TIME;
    let mut head = [0; MAX_HEAD];
    let mut length = 0;
    while length < MAX_HEAD {
        let bytes = left(end).and_then(|left| {
            stream.set_read_timeout(Some(left))?;
            stream.read(&mut head[length..])
        });
        match bytes {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(bytes) => length += bytes,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            Err(e) if is_late(&e) => return Ok(Err(Refusal::Late)),
            Err(e) => return Err(e),
        }
        if let Some(request) = Request::parse(&head[..length]).transpose() {
            return Ok(request);
        }
    }
    Ok(Err(Refusal::Long))
}

fn write(stream: &mut TcpStream, answer: &Answer, body: &[u8]) -> io::Result<()> {
    let reason = match answer.status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        408 => "Request Timeout",
        431 => "Request Header Fields Too Large",
        _ => "Internal Server Error",
    };
    let allow = if answer.status == 405 { "Allow: GET, HEAD\r\n" } else { "" };
    let head = format!(
        "HTTP/1.1 {} {reason}\r\nContent-Type: {}\r\nContent-Length: {}\r\nConnection: close\r\n{allow}Cache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\
         Content-Security-Policy: frame-ancestors 'none'\r\n\r\n",
        answer.status,
        answer.media_type,
        answer.body.len(),
    );
    let end = Instant::now() + ANSWER_TIME + Duration::from_secs(body.len() as u64 / ANSWER_RATE);
    for piece in std::iter::once(head.as_bytes()).chain(body.chunks(PIECE)) {
        write_piece(stream, piece, end)?;
    }
    stream.shutdown(Shutdown::Write)
}

fn write_piece(stream: &mut TcpStream, mut piece: &[u8], end: Instant) -> io::Result<()> {
    while !piece.is_empty() {
        stream.set_write_timeout(Some(left(end)?))?;
        match stream.write(piece) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(bytes) => piece = &piece[bytes..],
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// Waits until the client has read the answer and closes. Closing with unread bytes of a client resets the connection,
/// and the answer may be lost with it.
fn linger(stream: &mut TcpStream) {
    let (time, mut bytes) = LINGER;
    let end = Instant::now() + time;
    let mut unread = [0; 4096];
    while bytes > 0 {
        let read = left(end).and_then(|left| {
            stream.set_read_timeout(Some(left))?;
            stream.read(&mut unread)
        });
        match read {
            Ok(0) | Err(_) => return,
            Ok(read) => bytes = bytes.saturating_sub(read),
        }
    }
}
