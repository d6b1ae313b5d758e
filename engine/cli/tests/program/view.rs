//! Scenes in a browser. tests/outside/page tests the drawing of the page.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use streamsplat_fixtures as fixtures;

use crate::support::{Scratch, command, fails, files, model, run_ok};

/// Returns the body of `path` at an address as the program prints it.
fn get(address: &str, path: &str) -> Vec<u8> {
    let host = address.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host).expect("listening");
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").expect("open");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("answered");
    assert!(answer.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&answer));
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").expect("headers") + 4;
    answer.split_off(end)
}

/// Returns the first word of the first line.
fn address(lines: impl Read) -> String {
    let mut line = String::new();
    BufReader::new(lines).read_line(&mut line).expect("text");
    line.split_whitespace().next().expect("an address").to_owned()
}

/// Ends the process when the test ends, in any case.
struct Ending(Child);

impl Drop for Ending {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_scene_is_served_until_terminated_and_the_file_holds_the_same() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    run_ok(&scratch.clip("clip", 3, 40, 24), &out, &["--quiet"]);
    let html = scratch.path("out.html");
    let output = command().arg("view").arg(&out).arg("--html").arg(&html).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(&html).expect("a page");
    assert_eq!(page.matches("id=\"interval-").count(), 3);
    // The page links to its publisher's address, which must not be a script.
    let mut linked = command();
    linked.arg("view").arg(&out).arg("--html").arg(scratch.path("linked.html")).args(["--url", "javascript:alert(1)"]);
    let said = fails(&linked.output().expect("the program starts"), 2);
    assert!(said.contains("--url") && !scratch.path("linked.html").exists(), "{said}");

    let mut view = command();
    view.arg("view").arg(&out).args(["--port", "0"]).stdout(Stdio::piped());
    let mut view = Ending(view.spawn().expect("the program starts"));
    let address = address(view.0.stdout.take().expect("piped"));
    let scene: serde_json::Value = serde_json::from_slice(&get(&address, "/scene.json")).expect("JSON");
    assert_eq!((scene["intervals"].as_array().map(Vec::len), scene["complete"].as_bool()), (Some(3), Some(true)));
    assert!(get(&address, "/").starts_with(b"<!doctype html>"));
    let packet = get(&address, "/interval/2");
    assert!(packet.starts_with(b"sspk") && packet.len() > 1000);
    if cfg!(unix) {
        let interrupt = Command::new("kill").args(["-TERM", &view.0.id().to_string()]).status();
        assert!(interrupt.expect("kill starts").success());
        assert_eq!(view.0.wait().expect("it ends").code(), Some(0));
    }
}

#[test]
fn a_page_for_all_of_a_network_has_an_address_that_answers_and_a_line_for_ssh() {
    let scratch = Scratch::new();
    let (scene, _) = crate::still::prepared(&scratch);
    let mut view = command();
    view.arg("view").arg(&scene).args(["--host", "0.0.0.0", "--port", "0"]).stdout(Stdio::piped());
    let mut view = Ending(view.env_remove("SSH_CONNECTION").spawn().expect("the program starts"));
    let mut lines = BufReader::new(view.0.stdout.take().expect("piped")).lines();
    let mut line = || lines.next().expect("a line").expect("text");
    let (first, second) = (line(), line());
    let address = first.split_whitespace().next().expect("an address");
    assert!(!address.contains("0.0.0.0:"), "{first}");
    assert!(get(address, "/").starts_with(b"<!doctype html>"));
    assert!(second.contains("ssh -N -L ") && second.contains("http://localhost:"), "{second}");
}

#[test]
fn a_still_scene_is_served_as_an_instant_without_time() {
    let scratch = Scratch::new();
    let (scene, _) = crate::still::prepared(&scratch);
    let mut view = command();
    view.arg("view").arg(&scene).args(["--port", "0"]).stdout(Stdio::piped());
    let mut view = Ending(view.spawn().expect("the program starts"));
    let address = address(view.0.stdout.take().expect("piped"));
    let found: serde_json::Value = serde_json::from_slice(&get(&address, "/scene.json")).expect("JSON");
    assert_eq!((&found["title"], &found["still"]["format"]), (&"scene.ply".into(), &"PLY".into()));
    assert_eq!((&found["still"]["degree"], &found["complete"]), (&3.into(), &true.into()));
    assert_eq!(found["intervals"], serde_json::json!([{ "start": 0.0, "end": 0.0, "gaussians": 500 }]));
    let box_of = |name: &str| found["still"][name].as_array().expect("a corner").len();
    assert_eq!((box_of("least"), box_of("greatest")), (3, 3));
    let packet = get(&address, "/interval/0");
    let count = u32::from_le_bytes(packet[8..12].try_into().expect("four bytes")) as usize;
    // No opacity is under 1/255.
    assert_eq!((&packet[..4], count, packet.len()), (&b"ssst"[..], 500, 16 + 500 * 84));
    if cfg!(unix) {
        let interrupt = Command::new("kill").args(["-INT", &view.0.id().to_string()]).status();
        assert!(interrupt.expect("kill starts").success());
        assert_eq!(view.0.wait().expect("it ends").code(), Some(0));
    }
}

#[test]
fn a_still_scene_without_a_place_to_look_at_is_no_page() {
    let scratch = Scratch::new();
    let (scene, page) = (scratch.path("nowhere.splat"), scratch.path("nowhere.html"));
    for bytes in [Vec::new(), f32::NAN.to_le_bytes().repeat(8)] {
        std::fs::write(&scene, &bytes).expect("writable");
        let output = command().arg("view").arg(&scene).arg("--html").arg(&page).output();
        let text = fails(&output.expect("the program starts"), 1);
        assert!(text.contains("nowhere.splat: expected Gaussians at finite places, found none"), "{text}");
        assert!(!page.exists());
    }
    let (scene, _) = crate::still::prepared(&scratch);
    let output = command().arg("view").arg(&scene).args(["--limit-gaussians", "9", "--html"]).arg(&page).output();
    assert!(fails(&output.expect("the program starts"), 1).contains("expected at most 9 Gaussians"));
    assert!(!page.exists());
}

#[test]
fn a_run_that_is_watched_writes_the_same_bytes() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 4, 40, 24);
    let (alone, watched) = (scratch.path("alone"), scratch.path("watched"));
    run_ok(&clip, &alone, &["--quiet", "--gap", "2"]);
    let mut run = command();
    run.arg("run").arg(&clip).arg("--out").arg(&watched).arg("--model").arg(model()).args(["--gap", "2", "--serve=0"]);
    let mut run = Ending(run.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"));
    let address = address(run.0.stderr.take().expect("piped"));
    // Clients receive the end of the stream, and the page stays until Ctrl-C.
    let end = std::time::Instant::now() + Duration::from_secs(60);
    loop {
        let scene: serde_json::Value = serde_json::from_slice(&get(&address, "/scene.json")).expect("JSON");
        assert_eq!(scene["live"].as_bool(), Some(true));
        if scene["complete"] == true {
            assert_eq!(scene["intervals"].as_array().map(Vec::len), Some(3));
            break;
        }
        assert!(std::time::Instant::now() < end, "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    }
    ends_when_interrupted(&mut run, &watched);
    assert!(files(&watched) == files(&alone));
}

/// Sends Ctrl-C after everything is written, to a process that is still running, which must exit successfully.
fn ends_when_interrupted(run: &mut Ending, out: &std::path::Path) {
    let end = std::time::Instant::now() + Duration::from_secs(120);
    while !out.join("run.json").is_file() {
        assert!(std::time::Instant::now() < end, "it does not end");
        assert!(run.0.try_wait().expect("a process").is_none(), "it serves on");
        std::thread::sleep(Duration::from_millis(20));
    }
    let interrupt = Command::new("kill").args(["-INT", &run.0.id().to_string()]).status();
    assert!(interrupt.expect("kill starts").success());
    assert_eq!(run.0.wait().expect("it ends").code(), Some(0));
}

/// Connects and misbehaves until it is stopped; `kind` selects how. Every connection is counted.
fn attack(host: &str, kind: usize, attempts: &AtomicUsize, stop: &AtomicBool) {
    let mut kept = Vec::new();
    while !stop.load(Ordering::SeqCst) {
        let Ok(mut stream) = TcpStream::connect(host) else { continue };
        attempts.fetch_add(1, Ordering::SeqCst);
        let timeout = Some(Duration::from_millis(50));
        stream.set_read_timeout(timeout).and_then(|()| stream.set_write_timeout(timeout)).expect("a socket");
        let head = format!("Host: {host}\r\n");
        let sent = match kind {
            // Bodies that are announced and never sent.
            0 => format!("POST / HTTP/1.1\r\n{head}Content-Length: 1000000000000000\r\n\r\n").into_bytes(),
            1 => format!("GET / HTTP/1.1\r\n{head}Content-Length: 18446744073709551615\r\n\r\n").into_bytes(),
            // Many requests at once, whose answers are never read.
            2 => format!("GET / HTTP/1.1\r\n{head}\r\n").repeat(1000).into_bytes(),
            // A line without an end.
            3 => vec![b'a'; 4 << 20],
            // Nothing at all.
            4 => Vec::new(),
            // A foreign host name, twice.
            _ => b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n".to_vec(),
        };
        // The server may have closed the connection.
        let _ = stream.write_all(&sent);
        if kind == 5 {
            let mut answer = [0; 12];
            if stream.read_exact(&mut answer).is_ok() {
                assert_eq!(&answer, b"HTTP/1.1 400");
            }
        } else {
            kept.push(stream);
            // Enough to take every connection of the server.
            if kept.len() == 64 {
                kept.clear();
            }
        }
    }
}

#[test]
fn a_run_under_attack_writes_the_same_bytes() {
    let scratch = Scratch::new();
    let stream = std::fs::read(fixtures::path("clips/moving.y4m")).expect("readable");
    let (alone, attacked) = (scratch.path("alone"), scratch.path("attacked"));
    let piped = |out: &std::path::Path, more: &[&str]| {
        let mut run = command();
        run.args(["run", "-", "--out"]).arg(out).arg("--model").arg(model()).args(["--gap", "2"]).args(more);
        Ending(
            run.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"),
        )
    };
    let mut run = piped(&alone, &["--quiet"]);
    run.0.stdin.take().expect("piped").write_all(&stream).expect("read to its end");
    assert_eq!(run.0.wait().expect("it ends").code(), Some(0));

    let mut run = piped(&attacked, &["--serve=0"]);
    // The second half of the clip is held back until every kind of attack has run several times.
    let mut input = run.0.stdin.take().expect("piped");
    let (first, second) = stream.split_at(stream.len() / 2);
    input.write_all(first).expect("it reads");
    let address = address(run.0.stderr.take().expect("piped"));
    let host = address.trim_start_matches("http://").trim_end_matches('/').to_owned();
    let stop = AtomicBool::new(false);
    let attempts: [AtomicUsize; 6] = std::array::from_fn(|_| AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for (kind, attempts) in attempts.iter().enumerate() {
            scope.spawn({
                let (host, stop) = (&host, &stop);
                move || attack(host, kind, attempts, stop)
            });
        }
        let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let end = std::time::Instant::now() + Duration::from_secs(120);
            while attempts.iter().any(|n| n.load(Ordering::SeqCst) < 5) {
                assert!(std::time::Instant::now() < end, "connections by kind of attack: {attempts:?}");
                std::thread::sleep(Duration::from_millis(20));
            }
            input.write_all(second).expect("it reads");
            drop(input);
            ends_when_interrupted(&mut run, &attacked);
        }));
        stop.store(true, Ordering::SeqCst);
        if let Err(panic) = ended {
            std::panic::resume_unwind(panic);
        }
    });
    assert!(files(&attacked) == files(&alone));
}

#[test]
fn what_cannot_be_served_is_said() {
    let scratch = Scratch::new();
    let scene = scratch.path("scene");
    run_ok(&scratch.clip("clip", 2, 40, 24), &scene, &["--quiet"]);
    let view = |more: &[&str]| command().arg("view").arg(&scene).args(more).output().expect("the program starts");
    assert!(fails(&view(&["--port", "70000"]), 2).contains("--port"));
    assert!(fails(&view(&["--host", "here"]), 2).contains("--host"));
    assert!(fails(&view(&["--html", "a.html", "--port", "1"]), 2).contains("--html"));
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("bound").port().to_string();
    assert!(fails(&view(&["--port", &port]), 1).contains(&format!("cannot serve on 127.0.0.1:{port}")));
    // The page replaces neither its own poster nor another kind of file.
    for name in ["page.png", "page.PNG", "scene.ply"] {
        let page = scratch.path(name);
        let said = fails(&view(&["--html", &page.display().to_string()]), 2);
        assert!(said.contains("expected a name that ends in .html") && !page.exists(), "{said}");
    }
    // A missing folder is created; one that cannot be created is an error.
    let html = scratch.path("new/folder/page.html");
    let output = view(&["--html", &html.display().to_string()]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && html.exists() && text.contains("--url https://"), "{text}");
    std::fs::write(scratch.path("file"), b"").expect("writable");
    let text = fails(&view(&["--html", &scratch.path("file/page.html").display().to_string()]), 1);
    assert!(text.contains("file: cannot create"), "{text}");
    // A foreign picture is not replaced by a poster; the page's own is.
    std::fs::write(scratch.path("new/folder/other.png"), b"mine").expect("writable");
    let text = fails(&view(&["--html", &scratch.path("new/folder/other.html").display().to_string()]), 2);
    assert!(text.contains("other.png") && text.contains("found one without its page"), "{text}");
    assert_eq!(std::fs::read(scratch.path("new/folder/other.png")).expect("there"), b"mine");
    assert!(view(&["--html", &html.display().to_string()]).status.success());
    // A broken interval leaves no page behind.
    let interval = scene.join("scene/interval-000001.safetensors");
    std::fs::write(&interval, b"broken").expect("writable");
    let html = scratch.path("broken.html");
    assert!(fails(&view(&["--html", &html.display().to_string()]), 1).contains("interval-000001"));
    assert!(!html.exists());
}

#[test]
fn an_exported_file_is_seen_first_from_the_camera_next_to_it() {
    let scratch = Scratch::new();
    let (out, file) = (scratch.path("out"), scratch.path("still.splat"));
    run_ok(&scratch.clip("clip", 2, 40, 24), &out, &["--quiet"]);
    let mut export = command();
    export.arg("export").arg(&out).args(["--times", "0", "--quiet", "--out"]).arg(&file);
    assert!(export.status().expect("the program starts").success());
    let page = |name: &str| {
        let html = scratch.path(name);
        let output = command().arg("view").arg(&file).arg("--html").arg(&html).output().expect("the program starts");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (said, output.status.code(), std::fs::read_to_string(html).unwrap_or_default())
    };
    let camera = scratch.path("still.splat.camera.json");
    let (said, code, html) = page("seen.html");
    assert!(code == Some(0) && said.contains("seen first from") && html.contains("\"view\":[["), "{said}");
    let pinhole = r#"{"type": "pinhole", "position": [0, 0, -3], "fov_y_degrees": 60, "aspect": 1}"#;
    std::fs::write(&camera, pinhole).expect("writable");
    let (said, code, html) = page("other.html");
    assert!(code == Some(0) && said.contains("the page has no view like") && !html.contains("\"view\":[["), "{said}");
    std::fs::write(&camera, "{}").expect("writable");
    let (said, code, html) = page("broken.html");
    assert!(code == Some(1) && said.contains("still.splat.camera.json") && html.is_empty(), "{said}");
}
