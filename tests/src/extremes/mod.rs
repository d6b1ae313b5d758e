//! Extremes: every case on every instruction-set level of the machine and with 1, 2, 3 and 8 threads. Each reports its
//! error against binary64 and whether the bits agree.
//!
//! A [`Case`] computes values and judges them: the worst error, the value that has it, and properties that must hold
//! for any error. [`record`] keeps the errors: tests compare with `tests/extremes/record.json`;
//! `tests/extremes/REPORT.md` is for readers.

mod attention;
mod images;
mod motion;
mod norms;
mod opacity;
mod products;
pub mod record;
pub mod report;
mod sampling;
mod scenes;
mod splats;
mod values;
mod videos;

use rayon::ThreadPoolBuilder;
use streamsplat_kernels::Level;

use crate::reference::ulps;

/// Thread counts tried on every level.
pub const THREADS: [usize; 4] = [1, 2, 3, 8];

/// Result of a case's computation.
#[derive(Clone, Debug, Default)]
pub struct Computed {
    /// Values by which it is judged.
    pub values: Vec<f64>,
    /// Further results that must agree: counts, identities, messages.
    pub rest: Vec<u64>,
}

impl Computed {
    fn new(values: &[f32]) -> Self {
        Self { values: values.iter().map(|v| f64::from(*v)).collect(), rest: Vec::new() }
    }

    fn with(values: &[f32], rest: impl IntoIterator<Item = u64>) -> Self {
        Self { rest: rest.into_iter().collect(), ..Self::new(values) }
    }

    /// The bits, with one pattern for all NaN.
    fn digest(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        for value in &self.values {
            hasher.update(&(if value.is_nan() { f64::NAN.to_bits() } else { value.to_bits() }).to_le_bytes());
        }
        for word in &self.rest {
            hasher.update(&word.to_le_bytes());
        }
        hasher.finalize()
    }
}

/// Unit of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// |ours − exact|
    Absolute,
    /// |ours − exact| / |exact|
    Relative,
    /// |ours − exact| over the unit in the last place of binary32 at `exact`.
    Ulp,
    /// |ours − exact| over the sum of the magnitudes of the terms.
    OfTerms,
    /// ‖ours − exact‖ / ‖exact‖
    RelativeL2,
    /// √n times the largest distance between the empirical and the exact distribution.
    KolmogorovSmirnov,
}

impl Unit {
    /// Its name in the report.
    pub const fn name(self) -> &'static str {
        match self {
            Unit::Absolute => "absolute",
            Unit::Relative => "relative",
            Unit::Ulp => "ulp",
            Unit::OfTerms => "of the sum of magnitudes",
            Unit::RelativeL2 => "relative L2",
            Unit::KolmogorovSmirnov => "√n·D",
        }
    }
}

/// Judgement of a case's result.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The worst error.
    pub error: f64,
    /// Its unit.
    pub unit: Unit,
    /// Our value.
    pub ours: f64,
    /// The exact value.
    pub exact: f64,
    /// Properties that do not hold.
    pub broken: Vec<String>,
}

impl Judged {
    /// A judgement without errors.
    fn new(unit: Unit) -> Self {
        Self { error: 0.0, unit, ours: f64::NAN, exact: f64::NAN, broken: Vec::new() }
    }

    /// The error of values against exact ones. A NaN must be NaN, an infinity the same infinity.
    fn of(unit: Unit, ours: &[f64], exact: impl IntoIterator<Item = f64>) -> Self {
        let mut judged = Self::new(unit);
        let mut count = 0;
        for (i, (&ours, exact)) in ours.iter().zip(exact).enumerate() {
            let error =
                if ours == exact || ours.is_nan() && exact.is_nan() { 0.0 } else { distance(unit, ours, exact) };
            judged.demand(!error.is_nan(), || format!("value {i} is {ours}, expected {exact}"));
            judged.take(error, ours, exact);
            count += 1;
        }
        judged.demand(count == ours.len(), || format!("{} values, expected {count}", ours.len()));
        judged
    }

    /// Keeps the worse error.
    fn take(&mut self, error: f64, ours: f64, exact: f64) {
        if error > self.error || self.ours.is_nan() {
            (self.error, self.ours, self.exact) = (error.max(self.error), ours, exact);
        }
    }

    /// Notes a broken property unless it `holds`.
    fn demand(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds && self.broken.len() < 8 {
            self.broken.push(what());
        }
    }

    /// Adds a property that must hold.
    fn and(mut self, holds: bool, what: impl FnOnce() -> String) -> Self {
        self.demand(holds, what);
        self
    }
}

fn distance(unit: Unit, ours: f64, exact: f64) -> f64 {
    let apart = (ours - exact).abs();
    match unit {
        Unit::Relative => apart / exact.abs(),
        Unit::Ulp => ulps(ours, exact),
        _ => apart,
    }
}

/// Size of the cases whose size is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Sizes of every test run.
    Short,
    /// Sizes of the report.
    Long,
}

/// Level, threads and size of a case's run.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// The instruction-set level.
    pub level: Level,
    /// Threads of the current pool, for code that starts its own.
    pub threads: usize,
    /// Size of the case.
    pub form: Form,
}

/// One extreme.
pub struct Case {
    /// Its group.
    pub group: &'static str,
    /// Its name, unique in its group.
    pub name: String,
    /// True if the long form differs from the short one.
    pub long: bool,
    compute: Box<dyn Fn(Place) -> Computed + Send + Sync>,
    judge: Box<dyn Fn(&Computed) -> Judged + Send + Sync>,
}

impl Case {
    fn new(
        group: &'static str,
        name: impl Into<String>,
        compute: impl Fn(Place) -> Computed + Send + Sync + 'static,
        judge: impl Fn(&Computed) -> Judged + Send + Sync + 'static,
    ) -> Self {
        Self { group, name: name.into(), long: false, compute: Box::new(compute), judge: Box::new(judge) }
    }

    /// Its name in the record.
    pub fn key(&self) -> String {
        format!("{}: {}", self.group, self.name)
    }

    /// Computes the case on every level and thread count and judges the first result. Runs whose bits differ from the
    /// first are noted as broken. The long form runs only on the highest level, as the short one compares bits.
    ///
    /// # Panics
    /// When threads cannot be started.
    pub fn run(&self, form: Form) -> Judged {
        let mut first: Option<(Computed, blake3::Hash)> = None;
        let mut different = Vec::new();
        let levels = if form == Form::Long && self.long { vec![Level::detect()] } else { Level::available() };
        for level in levels {
            for threads in if form == Form::Long && self.long { &[2][..] } else { &THREADS } {
                let pool = ThreadPoolBuilder::new().num_threads(*threads).build().expect("threads start");
                let computed = pool.install(|| (self.compute)(Place { level, threads: *threads, form }));
                let digest = computed.digest();
                match &first {
                    None => first = Some((computed, digest)),
                    Some((_, expected)) if *expected == digest => {}
                    Some(_) => different.push(format!("other bits on {level} with {threads} threads")),
                }
            }
        }
        let (computed, _) = first.expect("every machine has a level");
        let mut judged = (self.judge)(&computed);
        judged.broken.extend(different);
        judged
    }
}

/// All cases, in the order of the report.
pub fn cases() -> Vec<Case> {
    let groups = [
        attention::cases,
        norms::cases,
        products::cases,
        sampling::cases,
        opacity::cases,
        motion::cases,
        splats::cases,
        values::cases,
        images::cases,
        videos::cases,
    ];
    groups.into_iter().flat_map(|cases| cases()).collect()
}

pub use sampling::{Collapse, Held, TRIED, collapse};
