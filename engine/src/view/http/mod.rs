//! A small HTTP/1.1 server: one request per connection, only GET and HEAD, and only the head of a request in memory.
//!
//! Clients are not trusted. Whatever a client sends or omits:
//!
//! | it takes at most | |
//! |---|---|
//! | memory | [`MAX_HEAD`] bytes for a request's head; bodies are not read |
//! | threads | one for each of [`MAX_CONNECTIONS`] connections; more are closed at once |
//! | time | [`HEAD_TIME`] to send the head, [`ANSWER_TIME`] and a second for each [`ANSWER_RATE`] bytes to take the answer |
//!
//! A panic while a request is answered ends only its connection. If no thread can be started, the connection is closed
//! and the next one accepted. [`Hosts`] lists the server names that requests may use.

mod connection;
mod hosts;
mod request;

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

pub use hosts::Hosts;
pub use request::{Refusal, Request};

/// Longest head of a request, in bytes.
pub const MAX_HEAD: usize = 8 << 10;
/// Most headers of a request.
pub const MAX_HEADERS: usize = 64;
/// Connections at the same time.
pub const MAX_CONNECTIONS: usize = 32;
/// Time for a client to send its request's head.
pub const HEAD_TIME: Duration = Duration::from_secs(5);
/// Time for a client to take its answer, in addition to the time for its length.
pub const ANSWER_TIME: Duration = Duration::from_secs(10);
/// The lowest rate at which a client can receive a long answer, in bytes per second.
pub const ANSWER_RATE: u64 = 64 << 10;
/// Pause after the system refused to accept a connection, as it does when file descriptors are short.
const REST: Duration = Duration::from_millis(50);
/// Longest wait for the acceptor when the listener ends.
const LAST_CALL: Duration = Duration::from_millis(200);

/// Response to a request.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Its status code.
    pub status: u16,
    /// The media type of the body.
    pub media_type: &'static str,
    /// The body, which is not sent for HEAD.
    pub body: Arc<[u8]>,
}

impl Answer {
    /// A line of text.
    pub fn text(status: u16, text: &str) -> Answer {
        Answer { status, media_type: "text/plain; charset=utf-8", body: text.as_bytes().into() }
    }
}

/// Listens and answers until it is dropped; answers in progress are completed.
#[derive(Debug)]
pub struct Listener {
    address: SocketAddr,
    ending: Arc<AtomicBool>,
    acceptor: Option<JoinHandle<()>>,
}

impl Listener {
    /// Answers requests to `address` whose `Host` is a name of `hosts`; port 0 takes any free one.
    ///
    /// # Errors
    /// Errors of the system: an address that cannot be listened on, no thread.
    pub fn start(
        address: SocketAddr,
        hosts: Hosts,
        answer: impl Fn(&Request) -> Answer + Send + Sync + 'static,
    ) -> io::Result<Listener> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let ending = Arc::new(AtomicBool::new(false));
        let ended = ending.clone();
        let serve = Arc::new(move |stream: TcpStream| connection::serve(stream, &hosts, &answer));
        let acceptor =
            std::thread::Builder::new().name("http".into()).spawn(move || accept(&listener, &ended, &serve))?;
        Ok(Listener { address, ending, acceptor: Some(acceptor) })
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::SeqCst);
        // A connection to itself wakes the acceptor. If that fails, the acceptor ends with the next connection.
        let mut own = self.address;
        match own.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => own.set_ip(Ipv4Addr::LOCALHOST.into()),
            IpAddr::V6(ip) if ip.is_unspecified() => own.set_ip(Ipv6Addr::LOCALHOST.into()),
            _ => {}
        }
        let woken = TcpStream::connect_timeout(&own, LAST_CALL).is_ok();
        if let Some(acceptor) = self.acceptor.take().filter(|_| woken) {
            let _ = acceptor.join();
        }
    }
}

/// Counts a connection for as long as it lives.
struct Counted(Arc<AtomicUsize>);

impl Counted {
    fn take(count: &Arc<AtomicUsize>) -> Option<Counted> {
        let room = |n: usize| (n < MAX_CONNECTIONS).then_some(n + 1);
        count.fetch_update(Ordering::SeqCst, Ordering::SeqCst, room).ok().map(|_| Counted(count.clone()))
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

fn accept(listener: &TcpListener, ending: &AtomicBool, serve: &Arc<impl Fn(TcpStream) + Send + Sync + 'static>) {
    let count = Arc::new(AtomicUsize::new(0));
    loop {
        let accepted = listener.accept();
        if ending.load(Ordering::SeqCst) {
            return;
        }
        let Ok((stream, _)) = accepted else {
            std::thread::sleep(REST);
            continue;
        };
        let Some(counted) = Counted::take(&count) else { continue };
        let serve = serve.clone();
        // Without a thread the closure is dropped, and the connection and its count with it.
        let _ = std::thread::Builder::new().name("http connection".into()).spawn(move || {
            let _counted = counted;
            serve(stream);
        });
    }
}

#[cfg(test)]
mod tests;
