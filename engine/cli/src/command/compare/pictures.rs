//! Comparison of two images or two videos, part by part.

use std::path::Path;

use streamsplat::samples::{self, Kind, Parts};

use crate::command::compare::account::{Account, file_name};
use crate::command::compare::{Outcome, Tolerance};
use crate::console::failure::Failure;

/// Compares two images or two videos.
pub fn files(a: &Path, b: &Path, tolerance: Tolerance) -> Result<Outcome, Failure> {
    let mut account = Account::new(tolerance);
    let kinds = [samples::kind(a)?, samples::kind(b)?];
    let what = if kinds == [Kind::Image; 2] { "images" } else { "frames" };
    parts([a, b], "", &mut account)?;
    Ok(account.finish(what))
}

/// Compares every part of two files. `name` is the prefix of the parts' names; it is empty if only these files are
/// compared.
pub fn parts(paths: [&Path; 2], name: &str, account: &mut Account) -> Result<(), Failure> {
    let [mut a, mut b]: [Parts; 2] = samples::open_both(paths)?;
    for index in 0.. {
        let (one, other) = (a.next().transpose()?, b.next().transpose()?);
        for (path, part) in paths.iter().zip([&one, &other]) {
            part.iter()
                .flat_map(|part| &part.notes)
                .for_each(|note| account.note(format!("{}: {note}", file_name(path))));
        }
        let part = match one.as_ref().or(other.as_ref()) {
            None if index == 0 => {
                let [a, b] = paths.map(|path| path.display().to_string());
                return Err(Failure::work(format!("{a} and {b}: expected pictures, found none in either")));
            }
            None => return Ok(()),
            Some(part) => part.name.clone(),
        };
        let called = match (name, part.as_str()) {
            ("", "") => file_name(paths[0]),
            ("", part) => part.to_owned(),
            (name, "") => name.to_owned(),
            (name, part) => format!("{name}: {part}"),
        };
        match (one, other) {
            (Some(one), Some(other)) => account.add(&called, one, other),
            (one, _) => {
                let ended = if one.is_none() { paths[0] } else { paths[1] };
                account.odd(&called, &format!("{} has ended, the other has not", ended.display()));
                return Ok(());
            }
        }
    }
    Ok(())
}
