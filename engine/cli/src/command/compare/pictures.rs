//! Images, folders of images and videos.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;

use serde_json::{Value, json};
use streamsplat::difference::{CHANNELS, Difference};
use streamsplat::picture::Picture;
use streamsplat::source::{Options, Source, folder};

use crate::command::compare::{Outcome, Tolerance};
use crate::console::failure::Failure;
use crate::output::digest;

/// Lines that are said of pictures that differ.
const LINES: usize = 20;

/// Results of all pictures compared so far.
struct Account {
    tolerance: Tolerance,
    pictures: Vec<Value>,
    lines: Vec<String>,
    failed: usize,
    differing: usize,
    worst: Option<(f32, Picture, Picture)>,
}

impl Account {
    fn new(tolerance: Tolerance) -> Self {
        Self { tolerance, pictures: Vec::new(), lines: Vec::new(), failed: 0, differing: 0, worst: None }
    }

    fn line(&mut self, line: String) {
        if self.lines.len() < LINES {
            self.lines.push(line);
        }
    }

    /// A picture of which every byte is equal.
    fn equal(&mut self, name: &str) {
        self.pictures.push(json!({ "name": name, "equal": true, "passed": true }));
    }

    /// A picture that cannot be compared.
    fn odd(&mut self, name: &str, cause: &str) {
        self.failed += 1;
        self.differing += 1;
        self.line(format!("{name}: {cause}"));
        self.pictures.push(json!({ "name": name, "equal": false, "passed": false, "cause": cause }));
    }

    fn add(&mut self, name: &str, a: Picture, b: Picture) {
        let found = match Difference::between(&a, &b) {
            Ok(found) => found,
            Err(e) => return self.odd(name, &e.to_string()),
        };
        let Some([column, row, channel]) = found.place else { return self.equal(name) };
        let largest = f64::from(found.largest) * 255.0;
        let passed = self.tolerance.allows(largest, found.psnr);
        self.differing += 1;
        self.failed += usize::from(!passed);
        let plane = a.width * a.height;
        let samples = [&a, &b].map(|p| p.rgb[channel * plane + row * a.width + column]);
        let ssim = found.ssim.map_or_else(String::new, |ssim| format!(", SSIM {ssim:.6}"));
        self.line(format!(
            "{name}: largest difference {largest:.4}/255 at column {column}, row {row} ({}: {} and {}); PSNR {:.2} dB{ssim}; {:.4} % of pixels differ",
            CHANNELS[channel], samples[0], samples[1], found.psnr, 100.0 * found.share
        ));
        self.pictures.push(json!({
            "name": name,
            "equal": false,
            "passed": passed,
            "largest": largest,
            "column": column,
            "row": row,
            "channel": CHANNELS[channel],
            "samples": samples,
            "psnr": found.psnr,
            "ssim": found.ssim,
            "share": found.share,
        }));
        if self.worst.as_ref().is_none_or(|(worst, ..)| found.largest > *worst) {
            self.worst = Some((found.largest, a, b));
        }
    }

    fn finish(mut self, what: &str) -> Outcome {
        let Self { failed, differing, .. } = self;
        let count = self.pictures.len();
        if differing > self.lines.len() {
            self.lines.push(format!("and {} more that differ", differing - self.lines.len()));
        }
        let summary = match (differing, failed) {
            (0, _) => format!("equal ({count} {what})"),
            (n, 0) => format!("{n} of {count} {what} differ, within the limits"),
            (n, m) if n == m => format!("{n} of {count} {what} differ"),
            (n, m) => format!("{n} of {count} {what} differ, {m} beyond the limits"),
        };
        Outcome {
            passed: failed == 0,
            summary,
            lines: self.lines,
            json: json!({ "kind": what, "equal": differing == 0, "pictures": self.pictures }),
            worst: self.worst.map(|(_, a, b)| (a, b)),
        }
    }
}

/// Two images or two videos.
pub fn files(a: &Path, b: &Path, tolerance: Tolerance) -> Result<Outcome, Failure> {
    let mut account = Account::new(tolerance);
    let both = |test: fn(&Path) -> bool| test(a) && test(b);
    let what = if both(folder::is_image) { "images" } else { "frames" };
    let name = |path: &Path| path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    if digest::file(a)? == digest::file(b)? {
        account.equal(&name(a));
        return Ok(account.finish("files"));
    }
    let mut sources = [a, b].map(|path| Source::open(path, &Options::default()));
    let [Ok(first), Ok(second)] = &mut sources else {
        return Err(sources.into_iter().find_map(Result::err).map_or_else(|| Failure::work("no source"), Into::into));
    };
    for index in 0.. {
        let name = if what == "images" { name(a) } else { format!("frame {index}") };
        match (first.next_frame()?, second.next_frame()?) {
            (None, None) => break,
            (Some(a), Some(b)) => account.add(&name, a.picture, b.picture),
            (one, _) => {
                let ended = if one.is_none() { a } else { b };
                account.odd(&name, &format!("{} has ended, the other has not", ended.display()));
                break;
            }
        }
    }
    Ok(account.finish(what))
}

/// The images of two folders, by their names.
pub fn folders(a: &Path, b: &Path, tolerance: Tolerance) -> Result<Outcome, Failure> {
    let names = |folder: &Path| -> Result<BTreeSet<OsString>, Failure> {
        Ok(folder::images(folder)?.iter().filter_map(|path| path.file_name().map(ToOwned::to_owned)).collect())
    };
    let (first, second) = (names(a)?, names(b)?);
    let mut account = Account::new(tolerance);
    for name in first.union(&second) {
        let text = name.to_string_lossy();
        let missing = [(a, &first), (b, &second)].into_iter().find(|(_, names)| !names.contains(name));
        if let Some((folder, _)) = missing {
            account.odd(&text, &format!("missing in {}", folder.display()));
            continue;
        }
        let paths = [a.join(name), b.join(name)];
        if digest::file(&paths[0])? == digest::file(&paths[1])? {
            account.equal(&text);
            continue;
        }
        let [a, b] = paths.map(|path| streamsplat::source::decode::decode_file(&path));
        account.add(&text, a?, b?);
    }
    Ok(account.finish("images"))
}
