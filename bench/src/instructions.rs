//! `stages --instructions`: instructions of each stage, counted by valgrind's callgrind. They do not depend on the
//! machine's load.
//!
//! The program runs itself under valgrind, once per precision, with a small network of seeded weights on one thread.
//! Callgrind's counts are those of the functions in [`counted`], one per stage. Valgrind does not support AVX-512, so
//! x86-64 is counted at AVX2.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use streamsplat_bench::table::{Column, Table};
use streamsplat_kernels::Level;
use streamsplat_model::{LoadOptions, Precision};

use crate::model::{Model, Which, noise};

const TABLE: Table<'_> = Table(&[
    Column::Text("stage", 10),
    Column::Text("", 6),
    Column::Number("instructions", 14),
    Column::Number("recorded", 9),
]);
const PRECISIONS: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];
/// Largest allowed increase over the recorded count.
const LIMIT: f64 = 0.03;
/// Largest allowed increase where the compiler or its settings differ.
const LIMIT_OF_OTHERS: f64 = 0.10;

/// Counted instructions.
#[derive(Serialize, Deserialize)]
struct Counts {
    /// The compiler, and changed settings of the release profile.
    built: String,
    isa: String,
    stages: Vec<Count>,
}

#[derive(Serialize, Deserialize)]
struct Count {
    stage: String,
    precision: String,
    instructions: u64,
}

/// Defines a function per stage, which must not be merged, and the list of them.
macro_rules! counted {
    ($($stage:ident),+) => {
        /// The functions whose instructions are counted.
        mod counted {
            use anyhow::Result;

            use crate::model::Model;

            $(
                #[inline(never)]
                pub(super) fn $stage(model: &Model) -> Result<Vec<f32>> {
                    model.stage(std::hint::black_box(stringify!($stage)))
                }
            )+
        }

        const STAGES: &[(&str, fn(&Model) -> Result<Vec<f32>>)] = &[$((stringify!($stage), counted::$stage)),+];
    };
}

counted!(encoder, upsampler, decoder, heads, raster);

/// Runs every stage once, on one thread: the work counted by valgrind.
pub(crate) fn work(level: Level, precision: Precision) -> Result<()> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| {
        let model = Model::load(Which::Seeded, &LoadOptions { level, precision, ..LoadOptions::default() }, &noise)?;
        for (_, stage) in STAGES {
            std::hint::black_box(stage(&model)?);
        }
        Ok(())
    })
}

/// The highest level that valgrind supports.
fn level() -> Result<Level> {
    let known = ["avx2", "neon", "scalar"];
    let found = known.iter().find_map(|name| Level::named(name).ok());
    found.context("no instruction set that valgrind knows")
}

/// Counts; compares with the file `recorded`, if there is one; writes to `json`, if set.
pub(crate) fn run(recorded: Option<&Path>, json: Option<&Path>) -> Result<()> {
    let recorded = recorded.map(read).transpose()?;
    let counts = count()?;
    println!("{}", TABLE.heads());
    for count in &counts.stages {
        let before = recorded.as_ref().and_then(|recorded| find(recorded, count));
        let change = before.map_or_else(String::new, |before| {
            format!("{:+.2} %", 100.0 * (count.instructions as f64 / before as f64 - 1.0))
        });
        println!("{}", TABLE.line(&[&count.stage, &count.precision, &count.instructions.to_string(), &change]));
    }
    if let Some(path) = json {
        streamsplat_bench::write_json(path, &counts)?;
    }
    recorded.map_or(Ok(()), |recorded| compare(&recorded, &counts))
}

fn read(path: &Path) -> Result<Counts> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}: not recorded counts", path.display()))
}

fn find(counts: &Counts, wanted: &Count) -> Option<u64> {
    let same = |count: &&Count| count.stage == wanted.stage && count.precision == wanted.precision;
    counts.stages.iter().find(same).map(|count| count.instructions)
}

fn compare(recorded: &Counts, counts: &Counts) -> Result<()> {
    ensure!(
        recorded.isa == counts.isa,
        "recorded on {}, counted on {}: these cannot be compared",
        recorded.isa,
        counts.isa
    );
    let mut limit = LIMIT;
    if recorded.built != counts.built {
        limit = LIMIT_OF_OTHERS;
        println!(
            "recorded with {}, counted with {}: {:.0} % are allowed instead of {:.0} %",
            recorded.built,
            counts.built,
            100.0 * LIMIT_OF_OTHERS,
            100.0 * LIMIT
        );
    }
    let (mut worse, mut stale) = (Vec::new(), false);
    for count in &counts.stages {
        let Some(before) = find(recorded, count) else {
            bail!("{} {}: not in the record; --json writes another", count.stage, count.precision);
        };
        stale |= (count.instructions as f64) < before as f64 * (1.0 - limit);
        if count.instructions as f64 > before as f64 * (1.0 + limit) {
            worse.push(format!("{} {} from {before} to {}", count.stage, count.precision, count.instructions));
        }
    }
    if stale {
        println!(
            "more than {:.0} % fewer than recorded: --json writes another record, by which growth shows again",
            100.0 * limit
        );
    }
    ensure!(
        worse.is_empty(),
        "more than {:.0} % more instructions: {}. Where that is meant, --json writes another record",
        100.0 * limit,
        worse.join(", ")
    );
    Ok(())
}

/// A folder that is removed when dropped.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        // At worst the folder remains.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn count() -> Result<Counts> {
    let scratch = Scratch(std::env::temp_dir().join(format!("streamsplat-count-{}", std::process::id())));
    std::fs::create_dir(&scratch.0).with_context(|| format!("creating {}", scratch.0.display()))?;
    let level = level()?;
    let mut stages = Vec::new();
    for precision in PRECISIONS {
        let path = scratch.0.join(precision.name());
        let output = Command::new("valgrind")
            .args(["--tool=callgrind", "--quiet", "--compress-strings=no"])
            .arg(format!("--callgrind-out-file={}", path.display()))
            .arg(std::env::current_exe()?)
            .args(["stages", "--counted-work", "--isa", level.name(), "--precision", precision.name()])
            .output()
            .context("valgrind, which counts instructions, cannot be started; Debian's package is called valgrind")?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "valgrind: {}: {}", output.status, said.trim());
        let profile = std::fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        for (stage, _) in STAGES {
            let instructions = inclusive(&profile, &format!("counted::{stage}"))?;
            stages.push(Count { stage: (*stage).to_owned(), precision: precision.name().to_owned(), instructions });
        }
    }
    Ok(Counts { built: env!("BUILT_BY").to_owned(), isa: level.name().to_owned(), stages })
}

/// Instructions of a function that was called once, and of all that it called.
fn inclusive(profile: &str, function: &str) -> Result<u64> {
    let mut lines = profile.lines();
    let mut found = Vec::new();
    while let Some(line) = lines.next() {
        if line.starts_with("cfn=") && line.ends_with(function) {
            let calls = lines.next().and_then(|line| line.strip_prefix("calls=")).unwrap_or_default();
            let cost = lines.next().and_then(|line| line.split(' ').next_back()).and_then(|cost| cost.parse().ok());
            found.push((calls.starts_with("1 "), cost));
        }
    }
    match found[..] {
        [(true, Some(instructions))] => Ok(instructions),
        _ => bail!("callgrind does not tell one call of {function}: {found:?}"),
    }
}
