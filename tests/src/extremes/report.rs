//! The report as Markdown.

use std::fmt::Write;

use streamsplat_kernels::Level;

use super::{Case, Collapse, Held, Judged, THREADS, Unit, collapse};

const HEAD: &str = "# What happens at the extremes

Every case runs on every instruction-set level and thread count below, and the bits of all of them are compared. The worst error is against binary64; beside
it stand the value that has it and what that should be. A case that breaks a promise (a value that is not finite, a step that is not monotone, a draw outside its
bounds, a record that is not dropped, other bits) or whose error grows beyond `record.json` fails `cargo test -p streamsplat-tests --test contracts extremes::`.

Written by

    cargo run --release -p streamsplat-tests --bin extremes -- --write

";

const COLLAPSE: &str = "
## Where the published sampling formula collapses

`m + σ√2·erf⁻¹(2u′ − 1)` with `u′ = u·Δ + Φ(a)` in binary32: for u over the whole of [0, 1] and without guards (*formula*), and as published, with u in [ε, 1−ε], the
mean where s ≤ −5 and the lower bound where Δ ≤ ε (*published*). *sampled* is what the engine draws; it keeps those three choices, because checkpoints were trained
with them. *quantile* has none of them and is exact to a rounding. Each cell: the largest error, different values, values outside the bounds, of 1,001 u.

| m | σ | formula | published | sampled | quantile |
|---|---|---|---|---|---|
";

const TAIL: &str = "
## Long streams

10,000 key frames in a row (identities unique and ascending, as many Gaussians at the end as after a hundred, the pairwise image of key frame 10,000 equal to that of
a stream started two frames earlier) are `cargo test --release -p streamsplat-tests --test contracts stream_long::`.
";

/// A number in few characters.
fn short(x: f64) -> String {
    match x.abs() {
        _ if x.is_nan() => "–".into(),
        0.0 => "0".into(),
        a if (1e-3..1e6).contains(&a) => format!("{x:.7}").trim_end_matches('0').trim_end_matches('.').to_owned(),
        _ => format!("{x:.4e}"),
    }
}

fn error(judged: &Judged) -> String {
    match judged.unit {
        _ if judged.error == 0.0 => "0".into(),
        Unit::KolmogorovSmirnov | Unit::Ulp => format!("{:.3} {}", judged.error, judged.unit.name()),
        unit => format!("{:.2e} {}", judged.error, unit.name()),
    }
}

/// The report of all cases.
pub fn markdown(rows: &[(Case, Judged)]) -> String {
    let mut text = HEAD.to_owned();
    let levels: Vec<_> = Level::available().iter().map(|level| level.name()).collect();
    let threads = THREADS.map(|n| n.to_string()).join(", ");
    let broken = rows.iter().filter(|(_, judged)| !judged.broken.is_empty()).count();
    let _ = writeln!(
        text,
        "Levels: {}. Threads: {threads}. {} cases, {broken} with a broken promise. Truncated normals: 10,000,000 draws each here, 50,000 in tests.",
        levels.join(", "),
        rows.len()
    );
    let mut group = "";
    for (case, judged) in rows {
        if case.group != group {
            group = case.group;
            let _ = writeln!(
                text,
                "\n## {group}\n\n| case | ours | binary64 | worst error | bits |\n|---|---|---|---|---|"
            );
        }
        let bits = if judged.broken.is_empty() { "agree".to_owned() } else { judged.broken.join("; ") };
        let (ours, exact) = (short(judged.ours), short(judged.exact));
        let _ = writeln!(text, "| {} | {ours} | {exact} | {} | {bits} |", case.name, error(judged));
    }
    text.push_str(COLLAPSE);
    let cell = |h: Held| format!("{:.1e}, {}, {}", h.error, h.different, h.outside);
    for Collapse { mean, log_scale, formula, published, sampled, quantile } in collapse() {
        let [a, b, c, d] = [formula, published, sampled, quantile].map(cell);
        let _ = writeln!(text, "| {mean} | e^{log_scale} | {a} | {b} | {c} | {d} |");
    }
    text.push_str(TAIL);
    text
}
