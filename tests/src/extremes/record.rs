//! The recorded errors, and the comparison with them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::{Case, Form, Judged};

/// Room for the reference's own rounding, which may differ from one standard library to another.
const ROOM: f64 = 1.01;

/// Errors of the short form by the case's [key](Case::key).
pub type Errors = BTreeMap<String, f64>;

/// The folder of the report and the record.
pub fn folder() -> PathBuf {
    concat!(env!("CARGO_MANIFEST_DIR"), "/extremes").into()
}

/// The record.
///
/// # Panics
/// When it cannot be read.
pub fn read() -> Errors {
    let path = folder().join("record.json");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Complaints about a case's short form: broken properties, and an error above the recorded one.
pub fn complaints(case: &Case, recorded: &Errors) -> Vec<String> {
    let Judged { error, unit, ours, exact, mut broken } = case.run(Form::Short);
    match recorded.get(&case.key()) {
        None => broken.push("not in the record".into()),
        Some(before) if error <= before * ROOM + 1e-15 => {}
        Some(before) => {
            broken.push(format!("the error is {error:e} {}, recorded {before:e}: {ours} for {exact}", unit.name()));
        }
    }
    broken.into_iter().map(|what| format!("{}: {what}", case.key())).collect()
}
