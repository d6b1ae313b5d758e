//! Comparison of scenes, number by number.

use std::path::Path;

use serde_json::{Value, json};
use streamsplat::formats::Limits;
use streamsplat::open::{self, Opened, StillFile};
use streamsplat::scene::Scene;
use streamsplat::still::Still;
use streamsplat::stream::{Column, Interval, Numbers, Workers};

use crate::command::compare::Outcome;
use crate::console;
use crate::console::failure::Failure;
use streamsplat::run::digest;

/// Difference of two columns.
#[derive(Debug, PartialEq)]
struct Apart {
    /// Number of Gaussians that differ.
    count: usize,
    /// Largest difference; a NaN counts as infinitely far from a number.
    largest: f64,
    /// The first Gaussian with it.
    place: usize,
}

/// Compares bits; `None` if all are equal.
fn apart(a: &Numbers<'_>, b: &Numbers<'_>, width: usize) -> Option<Apart> {
    fn whole<T: Copy + Into<u64>>(a: &[T], b: &[T]) -> Vec<(usize, f64)> {
        let pairs = a.iter().zip(b).map(|(a, b)| ((*a).into(), (*b).into())).enumerate();
        pairs.filter(|(_, (a, b))| a != b).map(|(i, (a, b))| (i, a.abs_diff(b) as f64)).collect()
    }
    let pairs: Vec<(usize, f64)> = match (a, b) {
        (Numbers::Floats(a), Numbers::Floats(b)) => {
            let differ = a.iter().zip(*b).enumerate().filter(|(_, (a, b))| a.to_bits() != b.to_bits());
            let far = |a: f32, b: f32| {
                let d = (f64::from(a) - f64::from(b)).abs();
                if d.is_nan() { f64::INFINITY } else { d }
            };
            differ.map(|(i, (a, b))| (i, far(*a, *b))).collect()
        }
        (Numbers::Words(a), Numbers::Words(b)) => whole(a, b),
        (Numbers::Codes(a), Numbers::Codes(b)) => whole(a, b),
        _ => return None,
    };
    let &(first, _) = pairs.first()?;
    let (mut largest, mut place, mut count, mut last) = (-1.0, first, 0, None);
    for (i, far) in pairs {
        if far > largest {
            (largest, place) = (far, i);
        }
        if last != Some(i / width) {
            (count, last) = (count + 1, Some(i / width));
        }
    }
    Some(Apart { count, largest, place: place / width })
}

fn of_still(still: &Still) -> Vec<Column<'_>> {
    let column = |name, width, values| Column { name, width, numbers: Numbers::Floats(values), default: None };
    vec![
        column("position", 3, still.mean.as_flattened()),
        column("log scale", 3, still.log_scale.as_flattened()),
        column("rotation", 4, still.rotation.as_flattened()),
        column("logit of opacity", 1, &still.logit),
        column("colour", 3, still.base.as_flattened()),
        column("harmonics", (3 * still.rest()).max(1), &still.higher),
    ]
}

fn of_interval(interval: &Interval) -> Vec<Column<'_>> {
    let mut columns = interval.gaussians.columns();
    for column in &mut columns {
        column.name = match column.name {
            "mean" => "position",
            "rgb" => "colour",
            "rgb_rate" => "rate of colour",
            name => name,
        };
    }
    columns
}

/// Returns lines and JSON of the columns that differ; `part` names the interval.
fn columns(part: &str, a: &[Column<'_>], b: &[Column<'_>], lines: &mut Vec<String>, found: &mut Vec<Value>) {
    for (a, b) in a.iter().zip(b) {
        let Some(Apart { count, largest, place }) = apart(&a.numbers, &b.numbers, a.width) else { continue };
        let name = a.name;
        lines.push(format!("{part}{name}: {count} Gaussians differ, by at most {largest:e} (Gaussian {place})"));
        let largest = if largest.is_finite() { json!(largest) } else { json!("not finite") };
        found.push(json!({ "part": part.trim_end_matches(": "), "property": name, "gaussians": count, "largest": largest, "gaussian": place }));
    }
}

/// Compares two scenes.
pub fn compare(a: &Path, b: &Path, limits: &Limits, workers: &Workers) -> Result<Outcome, Failure> {
    let read = |path| workers.install(|| open::scene(path, limits));
    match (read(a)?, read(b)?) {
        (Opened::Still(a), Opened::Still(b)) => Ok(still(&a, &b)),
        (Opened::Moving(a), Opened::Moving(b)) => moving(&a, &b),
        _ => Err(Failure::usage(format!(
            "{} and {}: expected two of a kind, found a still scene and a scene in time",
            a.display(),
            b.display()
        ))),
    }
}

fn outcome(equal: bool, summary: String, lines: Vec<String>, found: Vec<Value>) -> Outcome {
    let json = json!({ "kind": "scenes", "equal": equal, "differences": found });
    Outcome { passed: equal, summary, lines, mean: None, json, worst: None }
}

fn still(a: &StillFile, b: &StillFile) -> Outcome {
    let (mut lines, mut found) = (Vec::new(), Vec::new());
    let shape = |file: &StillFile| (file.still.len(), file.still.degree);
    let (first, second) = (shape(a), shape(b));
    if first != second {
        let text = |(count, degree)| format!("{count} Gaussians with harmonics of degree {degree}");
        let summary = format!("{} and {}", text(first), text(second));
        return outcome(false, summary, lines, found);
    }
    let [one, other] = [a, b].map(|file| &file.still.about);
    for (name, differ) in [
        ("offset", one.offset != other.offset),
        ("mark of anti-aliased training", one.antialiased != other.antialiased),
    ] {
        if differ {
            lines.push(format!("the scenes differ in their {name}"));
            found.push(json!({ "part": "scene", "property": name }));
        }
    }
    columns("", &of_still(&a.still), &of_still(&b.still), &mut lines, &mut found);
    let count = first.0;
    let summary = match (lines.len(), a.blake3 == b.blake3) {
        (0, true) => format!("equal ({}, every byte)", console::count(count, "Gaussian")),
        (0, false) => format!("equal ({}; other bytes of the files differ)", console::count(count, "Gaussian")),
        (n, _) => format!("{n} properties of {count} Gaussians differ"),
    };
    outcome(lines.is_empty(), summary, lines, found)
}

fn moving(a: &Scene, b: &Scene) -> Result<Outcome, Failure> {
    let (mut lines, mut found) = (Vec::new(), Vec::new());
    let (first, second) = (a.index(), b.index());
    let count = first.intervals.len();
    let whole = digest::scene_index(a)? == digest::scene_index(b)?;
    if count != second.intervals.len() {
        let summary = format!("{count} and {} intervals", second.intervals.len());
        return Ok(outcome(false, summary, lines, found));
    }
    if (first.fps, a.placement()) != (second.fps, b.placement()) {
        lines.push("the scenes differ in frame rate or size".to_owned());
        found.push(json!({ "part": "scene", "property": "frame rate or size" }));
    }
    for i in 0..count {
        let (one, other) = (&first.intervals[i], &second.intervals[i]);
        let part = format!("interval {i}: ");
        if (one.start, one.end) != (other.start, other.end) {
            lines.push(format!("{part}{} to {} s and {} to {} s", one.start, one.end, other.start, other.end));
            found.push(json!({ "part": format!("interval {i}"), "property": "times" }));
        }
        if one.gaussians != other.gaussians {
            lines.push(format!("{part}{} and {} Gaussians", one.gaussians, other.gaussians));
            found.push(json!({ "part": format!("interval {i}"), "property": "count" }));
            continue;
        }
        // Every interval is read, even if the indices agree. An interval that does not match its index is an error.
        let (one, other) = (a.interval(i)?, b.interval(i)?);
        for (what, differ) in [
            ("merges", one.merges != other.merges),
            ("key frame", one.index != other.index),
            ("count of Gaussians left out", one.dropped != other.dropped),
        ] {
            if differ {
                lines.push(format!("{part}the {what} differ"));
                found.push(json!({ "part": format!("interval {i}"), "property": what }));
            }
        }
        columns(&part, &of_interval(&one), &of_interval(&other), &mut lines, &mut found);
    }
    let summary = match lines.len() {
        0 if whole => format!("equal ({}, every byte)", console::count(count, "interval")),
        0 => format!("equal ({}; other bytes of the files differ)", console::count(count, "interval")),
        n => format!("{} in {}", console::count(n, "difference"), console::count(count, "interval")),
    };
    Ok(outcome(lines.is_empty(), summary, lines, found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flipped_bit_is_found_with_its_gaussian() {
        let a = [0.5_f32, 1.0, 2.0, 3.0, 4.0, 5.0];
        let mut b = a;
        b[4] = f32::from_bits(b[4].to_bits() ^ 1);
        let found = apart(&Numbers::Floats(&a), &Numbers::Floats(&b), 3).expect("a difference");
        assert_eq!((found.count, found.place), (1, 1));
        assert_eq!(apart(&Numbers::Floats(&a), &Numbers::Floats(&a), 3), None);
        b[0] = f32::NAN;
        let found = apart(&Numbers::Floats(&a), &Numbers::Floats(&b), 3).expect("a difference");
        assert_eq!((found.count, found.largest, found.place), (2, f64::INFINITY, 0));
        // Zeros of either sign have different bits but are equal numbers.
        let found = apart(&Numbers::Floats(&[0.0]), &Numbers::Floats(&[-0.0]), 1).expect("a difference");
        assert_eq!((found.count, found.largest), (1, 0.0));
    }
}
