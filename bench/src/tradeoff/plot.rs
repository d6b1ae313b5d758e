//! The plots. Configurations have two of quality over time: against the true frames, with the Pareto front, and against
//! f32 without reuse. Stages have one of error over time.
//!
//! Colours are precisions and shapes are gaps; a shape is the more open the more is reused. Members of the front have a
//! number, which a list below explains. In the plot of stages, shapes are stages.

use anyhow::{Context, Result, anyhow};
use plotters::chart::MeshStyle;
use plotters::coord::ranged1d::{KeyPointHint, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::grid::GridPoint;
use super::{Clock, Results, stages, table};

const WIDTH: u32 = 1120;
const HEAD: u32 = 64;
const PANELS: u32 = 420;
pub(super) const INK: RGBColor = RGBColor(34, 34, 34);
pub(super) const FRONT: RGBColor = RGBColor(120, 120, 120);
const COLOURS: [RGBColor; 5] = [
    RGBColor(27, 94, 160),
    RGBColor(230, 126, 34),
    RGBColor(46, 139, 87),
    RGBColor(142, 68, 173),
    RGBColor(196, 55, 72),
];

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
/// Colour, kind of shape, and how full it is.
pub(super) type Mark = (RGBColor, usize, f64);

/// Ratio of an axis's ends from which on only powers of ten are marked.
const WIDE: f64 = 1000.0;

/// A logarithmic axis whose marks are 1, 2 and 5 times powers of ten.
#[derive(Clone)]
pub(super) struct Logarithmic {
    inner: RangedCoordf64,
    range: (f64, f64),
}

impl Logarithmic {
    pub(super) fn new(from: f64, to: f64) -> Logarithmic {
        Logarithmic { inner: (from.ln()..to.ln()).into(), range: (from, to) }
    }
}

impl Ranged for Logarithmic {
    type FormatOption = plotters::coord::ranged1d::NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.inner.map(&value.ln(), limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        let steps: &[f64] = if self.range.1 / self.range.0 < WIDE { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let steps = (-12..9).flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)));
        steps.filter(|step| (self.range.0..=self.range.1).contains(step)).collect()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.range.0..self.range.1
    }
}

impl ValueFormatter<f64> for Logarithmic {
    fn format(value: &f64) -> String {
        format!("{value}")
    }
}

/// The names in a column, in the order they come.
fn names<R>(rows: &[R], name: impl Fn(&R) -> &str) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for row in rows {
        if !names.iter().any(|known| known == name(row)) {
            names.push(name(row).to_owned());
        }
    }
    names
}

/// Marks and colours of configurations.
struct Key {
    precisions: Vec<String>,
    gaps: Vec<String>,
    reuse: Vec<String>,
}

impl Key {
    fn mark(&self, row: &GridPoint) -> Mark {
        let place = |names: &[String], name: &str| names.iter().position(|n| n == name).unwrap_or(0);
        let colour = colour(place(&self.precisions, row.precision));
        (colour, place(&self.gaps, &row.gap), self.fill(place(&self.reuse, &row.reuse)))
    }

    /// From full to empty.
    fn fill(&self, place: usize) -> f64 {
        1.0 - place as f64 / (self.reuse.len() as f64 - 1.0).max(1.0)
    }
}

pub(super) fn fail(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("drawing the plot: {error}")
}

/// A shape of radius 6 with its middle at `at`.
pub(super) fn shape(area: &Area<'_>, at: (i32, i32), (colour, kind, fill): Mark) -> Result<()> {
    let (x, y) = at;
    let corners: &[(i32, i32)] = match kind % 4 {
        0 => &[],
        1 => &[(-6, -6), (6, -6), (6, 6), (-6, 6)],
        2 => &[(0, -7), (7, 6), (-7, 6)],
        _ => &[(0, -8), (8, 0), (0, 8), (-8, 0)],
    };
    let inside = colour.mix(fill).filled();
    let line = colour.stroke_width(2);
    if corners.is_empty() {
        area.draw(&Circle::new(at, 6, inside)).map_err(fail)?;
        return area.draw(&Circle::new(at, 6, line)).map_err(fail);
    }
    let mut points: Vec<(i32, i32)> = corners.iter().map(|(dx, dy)| (x + dx, y + dy)).collect();
    area.draw(&Polygon::new(points.clone(), inside)).map_err(fail)?;
    points.extend_from_within(..2);
    area.draw(&PathElement::new(points, line)).map_err(fail)
}

/// The grid and lettering of every panel.
pub(super) fn plain<'m, 'a, 'b, 's, X: Ranged, Y: Ranged>(
    mesh: &'m mut MeshStyle<'a, 'b, X, Y, SVGBackend<'s>>,
) -> &'m mut MeshStyle<'a, 'b, X, Y, SVGBackend<'s>> {
    mesh.light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225))
        .label_style(("sans-serif", 14).into_font().color(&INK))
        .axis_desc_style(("sans-serif", 15).into_font().color(&INK))
}

pub(super) fn text(area: &Area<'_>, words: &str, at: (i32, i32), size: i32) -> Result<()> {
    area.draw(&Text::new(words.to_owned(), at, ("sans-serif", size).into_font().color(&INK))).map_err(fail)
}

/// The smallest and largest value with a margin.
pub(super) fn around(values: impl Iterator<Item = f64>, margin: f64) -> (f64, f64) {
    let (least, most) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    let space = ((most - least) * margin).max(0.05);
    (least - space, most + space)
}

/// Positions for the numbers of points, away from all points and from one another where possible.
fn clear(points: &[(i32, i32)], all: &[(i32, i32)]) -> Vec<(i32, i32)> {
    let offsets =
        [(0, -20), (14, -16), (-14, -16), (18, 0), (-18, 0), (0, 20), (24, -24), (-24, -24), (0, -36), (30, 0)];
    let mut placed: Vec<(i32, i32)> = Vec::new();
    for &(x, y) in points {
        let far = |at: (i32, i32), other: &(i32, i32)| (at.0 - other.0).pow(2) + (at.1 - other.1).pow(2) >= 15 * 15;
        let free = offsets.iter().map(|(dx, dy)| (x + dx, y + dy));
        let mut free = free.filter(|&at| all.iter().chain(&placed).all(|other| far(at, other)));
        placed.push(free.next().unwrap_or((x, y - 48)));
    }
    placed
}

/// One panel, with the front's members in the order of time.
fn panel(
    area: &Area<'_>,
    rows: &[GridPoint],
    key: &Key,
    (title, unit): (&str, &str),
    time: &str,
    value: &dyn Fn(&GridPoint) -> f64,
    front: &[&GridPoint],
) -> Result<()> {
    let milliseconds = |row: &GridPoint| row.seconds_per_frame * 1e3;
    let least = rows.iter().map(milliseconds).fold(f64::INFINITY, f64::min);
    let most = rows.iter().map(milliseconds).fold(0.0, f64::max);
    let (low, high) = around(rows.iter().map(value), 0.12);
    let digits = if high - low < 1.0 { 2 } else { usize::from(high - low < 20.0) };
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .caption(title, ("sans-serif", 17).into_font().color(&INK))
        .x_label_area_size(46)
        .y_label_area_size(58)
        .build_cartesian_2d(Logarithmic::new(least / 1.15, most * 1.15), low..high)
        .map_err(fail)?;
    plain(&mut chart.configure_mesh())
        .x_desc(format!("{time} per input frame, ms (logarithmic)"))
        .y_desc(unit)
        .y_label_formatter(&|y| format!("{y:.digits$}"))
        .draw()
        .map_err(fail)?;
    let steps: Vec<(f64, f64)> = front
        .windows(2)
        .flat_map(|pair| {
            let (a, b) = (pair[0], pair[1]);
            [(milliseconds(a), value(a)), (milliseconds(b), value(a)), (milliseconds(b), value(b))]
        })
        .collect();
    chart.draw_series(std::iter::once(PathElement::new(steps, FRONT.stroke_width(2)))).map_err(fail)?;
    // The chart uses pixels of the whole picture.
    let (left, top) = area.get_base_pixel();
    let at = |row: &GridPoint| {
        let (x, y) = chart.backend_coord(&(milliseconds(row), value(row)));
        (x - left, y - top)
    };
    let all: Vec<(i32, i32)> = rows.iter().map(at).collect();
    // Open shapes are drawn after filled ones, which would hide them.
    for row in rows {
        shape(area, at(row), key.mark(row))?;
    }
    let members: Vec<(i32, i32)> = front.iter().map(|row| at(row)).collect();
    for (number, (member, (x, y))) in members.iter().zip(clear(&members, &all)).enumerate() {
        area.draw(&Circle::new(*member, 10, INK.stroke_width(1))).map_err(fail)?;
        let number = (number + 1).to_string();
        text(area, &number, (x - 4 * number.len() as i32, y - 8), 16)?;
    }
    Ok(())
}

/// The legend: lines of marks with their meaning.
pub(super) fn legend(area: &Area<'_>, lines: &[(&str, Vec<(Mark, &String)>)]) -> Result<()> {
    let mut y = 14;
    for (name, marks) in lines {
        text(area, name, (24, y - 8), 15)?;
        let mut x = 110;
        for (mark, label) in marks {
            shape(area, (x, y), *mark)?;
            text(area, label, (x + 14, y - 8), 15)?;
            x += 40 + 9 * label.chars().count() as i32;
        }
        y += 26;
    }
    Ok(())
}

/// Names with the mark of each one's place.
fn marked(names: &[String], mark: impl Fn(usize) -> Mark) -> Vec<(Mark, &String)> {
    names.iter().enumerate().map(|(i, name)| (mark(i), name)).collect()
}

pub(super) fn colour(place: usize) -> RGBColor {
    COLOURS[place % COLOURS.len()]
}

/// Machine of the measurement.
fn machine(results: &Results, rounds: usize) -> String {
    let about = &results.about;
    let threads = if about.threads == 1 { "1 thread".to_owned() } else { format!("{} threads", about.threads) };
    format!("{}, {}, {threads}; medians of {rounds} rounds", about.cpu, about.isa)
}

/// The configurations as SVG.
pub(super) fn svg(results: &Results) -> Result<String> {
    let rows = &results.rows;
    let about = &results.about;
    let key = Key {
        precisions: names(rows, |row| row.precision),
        gaps: names(rows, |row| &row.gap),
        reuse: names(rows, |row| &row.reuse),
    };
    let mut front: Vec<&GridPoint> = rows.iter().filter(|row| row.pareto).collect();
    front.sort_by(|a, b| a.seconds_per_frame.total_cmp(&b.seconds_per_frame));
    let lines = front.len().div_ceil(2) as u32;
    let size = (WIDTH, HEAD + PANELS + (44 + 22 * lines).max(96));
    let mut picture = String::new();
    {
        let root = SVGBackend::with_string(&mut picture, size).into_drawing_area();
        root.fill(&WHITE).map_err(fail)?;
        let title = format!(
            "Error against run time: {} at {}, {} ({} frames)",
            about.model, about.resolution, about.clip, about.frames
        );
        text(&root, &title, (24, 12), 20)?;
        text(&root, &machine(results, about.rounds), (24, 38), 15)?;
        let (_, rest) = root.split_vertically(HEAD);
        let (panels, below) = rest.split_vertically(PANELS);
        let (left, right) = panels.split_horizontally(size.0 / 2);
        let time = about.clock.name();
        panel(&left, rows, &key, ("against the true frames", "PSNR, dB"), time, &|row| row.psnr_vs_truth, &front)?;
        let same = ("against f32 without reuse at the same gap (100: equal)", "PSNR, dB");
        panel(&right, rows, &key, same, time, &|row| row.psnr_vs_f32, &[])?;
        let (left, right) = below.split_horizontally(400);
        let explained = [
            ("precision", marked(&key.precisions, |i| (colour(i), 0, 1.0))),
            ("gap", marked(&key.gaps, |i| (INK, i, 1.0))),
            ("reuse", marked(&key.reuse, |i| (INK, 0, key.fill(i)))),
        ];
        legend(&left, &explained)?;
        text(&right, "Pareto front (line; nothing is faster and at least as close to the true frames)", (24, 6), 15)?;
        for (i, row) in front.iter().enumerate() {
            let words = format!(
                "{}  {}, gap {}, reuse {}: {:.0} ms, {:.2} dB",
                i + 1,
                row.precision,
                row.gap,
                row.reuse,
                row.seconds_per_frame * 1e3,
                row.psnr_vs_truth
            );
            let (column, line) = (i as i32 / lines as i32, i as i32 % lines as i32);
            text(&right, &words, (24 + 350 * column, 30 + 22 * line), 15)?;
        }
        root.present().map_err(fail)?;
    }
    Ok(picture)
}

/// The stages as SVG. Points without a difference are on the lower edge.
pub(super) fn stages_svg(results: &Results) -> Result<String> {
    let (rows, about) = (&results.stages, &results.about);
    let milliseconds = |row: &stages::StageError| {
        let seconds = match about.clock {
            Clock::Wall => Some(row.wall),
            Clock::Processor => row.processor,
        };
        seconds
            .map(|seconds| seconds.median * 1e3)
            .context("this system does not tell processor time; use --clock wall")
    };
    let times: Vec<f64> = rows.iter().map(milliseconds).collect::<Result<_>>()?;
    let (least, most) = times.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), &x| (a.min(x), b.max(x)));
    let errors = || rows.iter().map(|row| row.relative_l2).filter(|&error| error > 0.0);
    let high = 3.0 * errors().fold(1e-7, f64::max);
    let low = errors().fold(high / 10.0, f64::min) / 3.0;
    let (precisions, stages) = (names(rows, |row| row.precision), names(rows, |row| row.stage));
    let place = |names: &[String], name: &str| names.iter().position(|n| n == name).unwrap_or(0);

    let mut picture = String::new();
    {
        let root = SVGBackend::with_string(&mut picture, (WIDTH / 4 * 3, HEAD + PANELS + 70)).into_drawing_area();
        root.fill(&WHITE).map_err(fail)?;
        let title = format!("Error of stages against run time: {} at {}", about.model, about.resolution);
        text(&root, &title, (24, 12), 20)?;
        text(&root, &machine(results, about.repeat), (24, 38), 15)?;
        let (_, rest) = root.split_vertically(HEAD);
        let (area, below) = rest.split_vertically(PANELS);
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(70)
            .build_cartesian_2d(Logarithmic::new(least / 1.3, most * 1.3), Logarithmic::new(low, high))
            .map_err(fail)?;
        let equal = if rows.iter().any(|row| row.relative_l2 == 0.0) { "; lower edge: equal" } else { "" };
        plain(&mut chart.configure_mesh())
            .x_desc(format!("{} of a call, ms (logarithmic)", about.clock.name()))
            .y_desc(format!("relative L2 error against {}{equal}", table::name(about.against)))
            .y_label_formatter(&|y| format!("{y:.0e}"))
            .draw()
            .map_err(fail)?;
        let points: Vec<(f64, f64)> = rows.iter().zip(&times).map(|(row, &x)| (x, row.relative_l2.max(low))).collect();
        for stage in &stages {
            let line = rows.iter().zip(&points).filter(|(row, _)| row.stage == stage).map(|(_, point)| *point);
            chart
                .draw_series(std::iter::once(PathElement::new(line.collect::<Vec<_>>(), FRONT.stroke_width(1))))
                .map_err(fail)?;
        }
        let (left, top) = area.get_base_pixel();
        for (row, point) in rows.iter().zip(&points) {
            let (x, y) = chart.backend_coord(point);
            let mark = (colour(place(&precisions, row.precision)), place(&stages, row.stage), 1.0);
            shape(&area, (x - left, y - top), mark)?;
        }
        let explained = [
            ("precision", marked(&precisions, |i| (colour(i), 0, 1.0))),
            ("stage", marked(&stages, |i| (INK, i, 1.0))),
        ];
        legend(&below, &explained)?;
        root.present().map_err(fail)?;
    }
    Ok(picture)
}
