//! Closeness over time: rows with the frames between key frames as input, and rows without.

use anyhow::Result;
use plotters::prelude::*;

use super::super::plot::{Area, FRONT, INK, Logarithmic, Mark, around, colour, fail, legend, plain, shape, text};
use super::{Configuration, Reason, Record};

const SIZE: (u32, u32) = (1120, 540);
const HEAD: u32 = 64;
const BELOW: u32 = 56;

/// The mark of a row's gap among `gaps`; a quality has its own shape.
fn mark(row: &Configuration, gaps: &[String]) -> Mark {
    let place = gap(row).and_then(|gap| gaps.iter().position(|known| *known == gap)).unwrap_or(gaps.len());
    match row.kind {
        Reason::Quality => (INK, 3, 1.0),
        Reason::Step | Reason::Part => (colour(place), 1, 0.0),
        Reason::Grid => (colour(place), 0, 0.6),
    }
}

fn gap(row: &Configuration) -> Option<String> {
    let at = row.arguments.iter().position(|word| word == "--gap")?;
    row.arguments.get(at + 1).cloned()
}

fn panel(area: &Area<'_>, rows: &[&Configuration], gaps: &[String], title: &str) -> Result<()> {
    let milliseconds = |row: &Configuration| 1e3 * row.seconds_per_frame;
    let least = rows.iter().map(|row| milliseconds(row)).fold(f64::INFINITY, f64::min);
    let most = rows.iter().map(|row| milliseconds(row)).fold(0.0, f64::max);
    let (low, high) = around(rows.iter().map(|row| row.all), 0.12);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .caption(title, ("sans-serif", 17).into_font().color(&INK))
        .x_label_area_size(46)
        .y_label_area_size(58)
        .build_cartesian_2d(Logarithmic::new(least / 1.15, most * 1.15), low..high)
        .map_err(fail)?;
    plain(&mut chart.configure_mesh())
        .x_desc("engine's time per input frame, ms (logarithmic)")
        .y_desc("PSNR of all frames, dB")
        .y_label_formatter(&|y| format!("{y:.0}"))
        .draw()
        .map_err(fail)?;
    let mut front: Vec<&&Configuration> = rows.iter().filter(|row| row.pareto).collect();
    front.sort_by(|a, b| a.seconds_per_frame.total_cmp(&b.seconds_per_frame));
    let steps = front.windows(2).flat_map(|pair| {
        let (a, b) = (pair[0], pair[1]);
        [(milliseconds(a), a.all), (milliseconds(b), a.all), (milliseconds(b), b.all)]
    });
    chart
        .draw_series(std::iter::once(PathElement::new(steps.collect::<Vec<_>>(), FRONT.stroke_width(2))))
        .map_err(fail)?;
    // The chart uses pixels of the whole picture.
    let (left, top) = area.get_base_pixel();
    for row in rows {
        let (x, y) = chart.backend_coord(&(milliseconds(row), row.all));
        let at = (x - left, y - top);
        shape(area, at, mark(row, gaps))?;
        if row.kind == Reason::Quality {
            let name = row.arguments.last().map_or("", String::as_str);
            text(area, name, (at.0 - 24, at.1 - 28), 15)?;
        }
    }
    Ok(())
}

/// The plot as SVG.
pub(super) fn svg(record: &Record) -> Result<String> {
    let mut gaps: Vec<String> = record.rows.iter().filter_map(gap).collect();
    gaps.sort_by_key(|gap| gap.parse::<usize>().unwrap_or(usize::MAX));
    gaps.dedup();
    let mut picture = String::new();
    {
        let root = SVGBackend::with_string(&mut picture, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(fail)?;
        let title = format!("Error against run time: the embedded model on {} clips of 512×288", record.clips);
        text(&root, &title, (24, 12), 20)?;
        let machine =
            format!("{}, {}, {} threads; line: nothing is faster and as close", record.cpu, record.isa, record.threads);
        text(&root, &machine, (24, 38), 15)?;
        let (_, rest) = root.split_vertically(HEAD);
        let (panels, below) = rest.split_vertically(SIZE.1 - HEAD - BELOW);
        let (left, right) = panels.split_horizontally(SIZE.0 / 2);
        let rows = |seen: bool| record.rows.iter().filter(|row| row.seen == seen).collect::<Vec<_>>();
        panel(&left, &rows(true), &gaps, "the frames between key frames are seen")?;
        panel(&right, &rows(false), &gaps, "they are not")?;
        let names: Vec<String> = gaps.iter().map(|gap| format!("gap {gap}")).collect();
        let mut marks: Vec<(Mark, &String)> =
            names.iter().enumerate().map(|(i, name)| ((colour(i), 0, 0.6), name)).collect();
        let others = ["--quality".to_owned(), "one option after the other, or one left out".to_owned()];
        marks.push(((INK, 3, 1.0), &others[0]));
        marks.push(((INK, 1, 0.0), &others[1]));
        legend(&below, &[("", marks)])?;
        root.present().map_err(fail)?;
    }
    Ok(picture)
}
