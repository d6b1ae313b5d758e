//! `track`: the identity under a pixel and its path through time.

use std::fmt::Write as _;

use serde::Serialize;
use streamsplat::open::scene_in_time;
use streamsplat::output::write_file;
use streamsplat::scene::Scene;
use streamsplat::track::{Track, TrackPoint};

use crate::console::failure::Failure;
use crate::console::{Console, print, say};
use crate::options::args::TrackArgs;
use crate::options::times;
use streamsplat::run::options::Times;

/// Result, written as JSON.
#[derive(Serialize)]
struct Found {
    /// The requested time, in seconds.
    at: f64,
    /// The requested pixel; centres are at integers.
    point: [f64; 2],
    /// Size of the source's frames, width first.
    size: [usize; 2],
    /// The identity under the point.
    identity: u64,
    /// Its share of the pixel's colour.
    weight: f64,
    /// Number of requested times at which it is not in the scene.
    missing: usize,
    /// Its positions, ascending in time.
    path: Vec<PathPoint>,
}

/// One point of the path.
#[derive(Serialize)]
struct PathPoint {
    time: f64,
    identity: u64,
    pixel: [f64; 2],
    world: [f32; 3],
    opacity: f32,
}

impl From<TrackPoint> for PathPoint {
    fn from(p: TrackPoint) -> PathPoint {
        PathPoint { time: p.time, identity: p.identity, pixel: p.pixel, world: p.position, opacity: p.opacity }
    }
}

/// Picks the identity, follows it, and prints its path.
pub fn command(args: &TrackArgs, console: &Console) -> Result<(), Failure> {
    let point = point(&args.point)?;
    let asked = args.times.as_ref().map(Times::list);
    times::check_rate(args.fps)?;
    let workers = args.machine.workers()?;
    let scene = scene_in_time(&args.scene, &args.limit.limits())?;
    let place = times::find(&scene, "--at", args.at)?;
    let [height, width] = scene.placement().source;
    let inside = |x: f64, side: usize| (-0.5..=side as f64 - 0.5).contains(&x);
    if !(inside(point[0], width) && inside(point[1], height)) {
        let message = format!("--point {}: expected a pixel of a frame of {width}×{height}", args.point);
        return Err(Failure::usage(message));
    }
    let mut due = times::of_scene(&scene, asked.as_deref(), args.fps)?;
    if asked.is_none() && due.iter().all(|(time, _)| *time != args.at) {
        let next = due.partition_point(|(time, _)| *time < args.at);
        due.insert(next, (args.at, place));
    }

    let picked = scene.interval(place)?.pick(args.at, point, &workers)?.ok_or_else(|| {
        Failure::work(format!("{}: nothing is drawn at {} at {} s", args.scene.display(), args.point, args.at))
    })?;
    let track = Track::new(&picked, args.at);
    let (before, after): (Vec<_>, Vec<_>) = due.iter().copied().partition(|(time, _)| *time < args.at);
    let mut path = follow(&scene, track, place, &before, Direction::Backward)?;
    path.extend(follow(&scene, track, place, &after, Direction::Forward)?);
    let found = Found {
        at: args.at,
        point,
        size: [width, height],
        identity: picked.identity,
        weight: picked.weight,
        missing: due.len() - path.len(),
        path,
    };
    if let Some(file) = &args.json {
        let text = serde_json::to_string_pretty(&found).map_err(Failure::work)?;
        write_file(file, (text + "\n").as_bytes())?;
    }
    let table = csv(&found.path);
    match &args.out {
        Some(file) => {
            write_file(file, table.as_bytes())?;
            if !console.quiet {
                let (identity, rows, of) = (found.identity, found.path.len(), due.len());
                say(format!("{}: identity {identity}, at {rows} of {of} times", file.display()))?;
            }
        }
        None => print(table.as_bytes())?,
    }
    Ok(())
}

/// Parses `X,Y` in pixels.
fn point(text: &str) -> Result<[f64; 2], Failure> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|x| x.is_finite());
    let parts = text.split_once(',').and_then(|(x, y)| number(x).zip(number(y)));
    parts.map(|(x, y)| [x, y]).ok_or_else(|| Failure::usage(format!("--point {text}: expected X,Y in pixels")))
}

/// Direction in time.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    Forward,
    Backward,
}

/// Returns the track's positions at the times `due` (ascending, each with its interval), all on one side of the track's
/// own time, which interval `from` shows. The result ends with the track or with the last requested time; no interval
/// beyond is read.
fn follow(
    scene: &Scene,
    mut track: Track,
    from: usize,
    due: &[(f64, usize)],
    direction: Direction,
) -> Result<Vec<PathPoint>, Failure> {
    let intervals: Vec<usize> = match direction {
        Direction::Forward => due.last().map(|last| (from..=last.1).collect()).unwrap_or_default(),
        Direction::Backward => due.first().map(|first| (first.1..=from).rev().collect()).unwrap_or_default(),
    };
    let mut parts: Vec<Vec<PathPoint>> = Vec::new();
    for i in intervals {
        let interval = scene.interval(i)?;
        let times: Vec<f64> = due.iter().filter(|(_, place)| *place == i).map(|(time, _)| *time).collect();
        let step = match direction {
            Direction::Forward => track.forward(&interval, &times),
            Direction::Backward => track.backward(&interval, &times),
        };
        let Some((points, next)) = step else { break };
        parts.push(points.into_iter().map(PathPoint::from).collect());
        track = next;
    }
    if direction == Direction::Backward {
        parts.reverse();
    }
    Ok(parts.into_iter().flatten().collect())
}

/// Formats a line per point, with the units in the names of the columns. Numbers have the fewest digits that read back
/// as the same bits.
fn csv(path: &[PathPoint]) -> String {
    let mut text = String::from("time_s,identity,x_px,y_px,x_half_widths,inverse_depth,z_half_heights,opacity\n");
    for PathPoint { time, identity, pixel: [x, y], world: [wx, wy, wz], opacity } in path {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{time},{identity},{x},{y},{wx},{wy},{wz},{opacity}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_two_finite_numbers() {
        assert_eq!(point("3,-0.25").ok(), Some([3.0, -0.25]));
        assert_eq!(point(" 3 , 4 ").ok(), Some([3.0, 4.0]));
        for wrong in ["", "3", "3,", "3,4,5", "a,b", "nan,1", "inf,1", "3;4"] {
            assert!(matches!(point(wrong), Err(Failure::Usage(_))), "{wrong}");
        }
    }
}
