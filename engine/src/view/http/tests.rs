use std::io::{Read, Write};
use std::time::Instant;

use super::*;

fn start(answer: impl Fn(&Request) -> Answer + Send + Sync + 'static) -> Listener {
    let address = SocketAddr::from(([127, 0, 0, 1], 0));
    Listener::start(address, Hosts::of(address.ip(), &[]), answer).expect("a free port")
}

fn hello(_: &Request) -> Answer {
    Answer::text(200, "hello\n")
}

fn connect(listener: &Listener) -> TcpStream {
    let stream = TcpStream::connect(listener.address()).expect("listening");
    stream.set_read_timeout(Some(Duration::from_secs(30))).expect("a socket");
    stream
}

/// Reads to the end; a reset ends it as well.
fn rest(mut stream: TcpStream) -> String {
    let (mut text, mut bytes) = (Vec::new(), [0; 4096]);
    while let Ok(read @ 1..) = stream.read(&mut bytes) {
        text.extend_from_slice(&bytes[..read]);
    }
    String::from_utf8_lossy(&text).into_owned()
}

fn ask(listener: &Listener, request: &[u8]) -> String {
    let mut stream = connect(listener);
    stream.write_all(request).expect("open");
    rest(stream)
}

const GET: &[u8] = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";

#[test]
fn no_other_site_may_frame_or_embed_an_answer() {
    let answer = ask(&start(hello), GET);
    for header in
        ["Cross-Origin-Resource-Policy: same-origin\r\n", "Content-Security-Policy: frame-ancestors 'none'\r\n"]
    {
        assert!(answer.contains(header), "{answer}");
    }
}

#[test]
fn bodies_are_neither_read_nor_allocated() {
    let listener = start(hello);
    for length in ["0", "1000000000000000", "18446744073709551615", "-1", "x"] {
        for method in ["GET", "POST"] {
            let request = format!("{method} / HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n\r\nabc");
            let expected = if method == "GET" { "HTTP/1.1 200 OK\r\n" } else { "HTTP/1.1 405 " };
            let answer = ask(&listener, request.as_bytes());
            assert!(answer.starts_with(expected), "{method} {length}: {answer}");
        }
    }
    let chunked = b"POST / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n";
    assert!(ask(&listener, chunked).starts_with("HTTP/1.1 405 "));
}

#[test]
fn heads_without_an_end_are_refused_in_length_and_in_time() {
    let listener = start(hello);
    let long = [b"GET /".as_slice(), &[b'a'; 2 * MAX_HEAD]].concat();
    assert!(ask(&listener, &long).starts_with("HTTP/1.1 431 "));
    // A byte now and then keeps a connection no longer than its time limit.
    let (start, mut slow) = (Instant::now(), connect(&listener));
    while start.elapsed() < HEAD_TIME {
        if slow.write_all(b"a").is_err() {
            break;
        }
        assert!(ask(&listener, GET).ends_with("hello\n"));
        std::thread::sleep(Duration::from_millis(400));
    }
    assert!(rest(slow).starts_with("HTTP/1.1 408 "));
    assert!(start.elapsed() < HEAD_TIME + Duration::from_secs(3));
}

#[test]
fn idle_connections_are_limited_and_let_go() {
    let listener = start(hello);
    let idle: Vec<TcpStream> = (0..MAX_CONNECTIONS).map(|_| connect(&listener)).collect();
    // They are accepted in the order in which they came, so this one is one too many.
    assert_eq!(rest(connect(&listener)), "");
    for stream in idle {
        assert!(rest(stream).starts_with("HTTP/1.1 408 "));
    }
    let end = Instant::now() + Duration::from_secs(20);
    while !ask(&listener, GET).ends_with("hello\n") {
        assert!(Instant::now() < end, "no connection is free");
    }
}

#[test]
fn a_client_that_does_not_read_loses_its_answer_alone() {
    let listener = start(|request| match request.path.as_str() {
        "/long" => Answer { status: 200, media_type: "text/plain", body: vec![b'a'; 64 << 20].into() },
        _ => hello(request),
    });
    let deaf: Vec<TcpStream> = (0..3)
        .map(|_| {
            let mut stream = connect(&listener);
            let pipelined = b"GET /long HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(100);
            stream.write_all(&pipelined).expect("open");
            stream
        })
        .collect();
    for _ in 0..10 {
        assert!(ask(&listener, GET).ends_with("hello\n"));
    }
    drop(deaf);
}

#[test]
fn a_panic_ends_one_connection() {
    let listener = start(|request| if request.path == "/" { hello(request) } else { panic!("a test's panic") });
    for _ in 0..2 * MAX_CONNECTIONS {
        let answer = ask(&listener, b"GET /panic HTTP/1.1\r\nHost: localhost\r\n\r\n");
        assert!(answer.starts_with("HTTP/1.1 500 "), "{answer}");
    }
    assert!(ask(&listener, GET).ends_with("hello\n"));
}

#[test]
fn names_of_others_are_refused() {
    let listener = start(hello);
    let answer = ask(&listener, b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 403 ") && !answer.contains("hello"), "{answer}");
    let head = ask(&listener, b"HEAD / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 403 ") && head.ends_with("\r\n\r\n"), "{head}");
}
