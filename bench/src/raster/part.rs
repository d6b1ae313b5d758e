//! Images of a part of a scene: Gaussians left out before projection, the time saved, and the time of preparation.

use anyhow::{Context, Result, ensure};
use rayon::current_num_threads;
use serde::Serialize;
use streamsplat::camera::Pose;
use streamsplat::fit::{Fit, Placement};
use streamsplat::render::Renderer;
use streamsplat::space::{Bounds, Tree};
use streamsplat::still::{Drawable, Still};
use streamsplat::stream::{DynamicGaussians, Record, Snapshot, Workers};
use streamsplat::{Camera, Image, Interval, RenderOptions, Size};
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::Stopwatch;
use streamsplat_kernels::Level;

use super::scenes::Random;

/// Gaussians of each scene.
const COUNT: usize = 500_000;
/// Width and height of the images.
const SIZE: [usize; 2] = [512, 288];
/// Cameras of each scene.
const CAMERAS: usize = 8;

const TABLE: Table<'_> = Table(&[
    Column::Text("part of a scene", 20),
    Column::Number("Gaussians", 9),
    Column::Number("left out", 9),
    Column::Number("whole ms", 9),
    Column::Number("without", 9),
    Column::Number("groups ms", 9),
    Column::Number("hierarchy ms", 12),
]);

/// Milliseconds of processor time per image, from the fastest run of each camera.
#[derive(Serialize)]
pub(super) struct PartTiming {
    name: String,
    gaussians: usize,
    /// Gaussians left out per image, before projection.
    left_out: f64,
    whole: f64,
    /// Time of an image in which Gaussians are left out.
    part: Option<f64>,
    /// Time per scene to build its groups.
    prepare: f64,
    /// Time per scene to build a hierarchy over the Gaussians.
    hierarchy: f64,
}

/// Measures both kinds of scenes; an image without the Gaussians left out is compared with that of the whole scene.
pub(super) fn run(level: Level, repeat: usize) -> Result<Vec<PartTiming>> {
    let workers = Workers::new(level, current_num_threads())?;
    println!("\n{}", TABLE.heads());
    Ok(vec![still(&workers, repeat)?, interval(&workers, repeat)?])
}

/// Over all cameras: milliseconds for the whole scene and for a part of it, and the number of Gaussians left out.
struct Sums {
    whole: f64,
    part: Option<f64>,
    left_out: u64,
}

/// Draws every camera's image both ways.
fn draw(
    cameras: &[Camera],
    repeat: usize,
    mut whole: impl FnMut(&Camera) -> Result<Image>,
    mut part: impl FnMut(&Camera) -> Result<(Image, u64)>,
) -> Result<Sums> {
    let mut least = vec![[f64::INFINITY; 2]; cameras.len()];
    let mut left_out = 0;
    for run in 0..repeat {
        for (camera, least) in cameras.iter().zip(&mut least) {
            let watch = Stopwatch::start();
            let expected = whole(camera)?;
            least[0] = least[0].min(watch.stop().seconds());
            let watch = Stopwatch::start();
            let (found, some) = part(camera)?;
            least[1] = least[1].min(watch.stop().seconds());
            ensure!(expected.rgb == found.rgb && expected.dropped == found.dropped, "the images differ");
            left_out += if run == 0 { some } else { 0 };
        }
    }
    let sum = |way: usize| least.iter().map(|least| least[way] * 1e3).sum();
    Ok(Sums { whole: sum(0), part: Some(sum(1)), left_out })
}

impl PartTiming {
    /// The row, printed.
    fn new(name: &str, sums: &Sums, prepare: f64, hierarchy: f64) -> Self {
        let images = CAMERAS as f64;
        let row = PartTiming {
            name: name.to_owned(),
            gaussians: COUNT,
            left_out: sums.left_out as f64 / images,
            whole: sums.whole / images,
            part: sums.part.map(|part| part / images),
            prepare,
            hierarchy,
        };
        let cells = [
            row.name.clone(),
            row.gaussians.to_string(),
            format!("{:.0}", row.left_out),
            format!("{:.2}", row.whole),
            row.part.map_or_else(|| "–".to_owned(), |part| format!("{part:.2}")),
            format!("{:.1}", row.prepare),
            format!("{:.1}", row.hierarchy),
        ];
        println!("{}", TABLE.line(&cells));
        row
    }
}

fn options() -> RenderOptions {
    RenderOptions { size: Size::Exact { width: SIZE[0], height: SIZE[1] }, ..RenderOptions::default() }
}

/// A view of `degrees` from `eye`.
fn pinhole(eye: [f64; 3], target: [f64; 3], degrees: f64) -> Result<Camera> {
    let pose = Pose::look_at(eye, target, [0.0, -1.0, 0.0]).context("a pose")?;
    Camera::pinhole(pose, degrees, SIZE[0] as f64 / SIZE[1] as f64).context("a lens")
}

/// The time to build a hierarchy over boxes.
fn hierarchy(boxes: impl Iterator<Item = Option<Bounds>>) -> f64 {
    let boxes: Vec<(u32, Bounds)> = (0..).zip(boxes).filter_map(|(i, bounds)| Some((i, bounds?))).collect();
    let watch = Stopwatch::start();
    std::hint::black_box(Tree::new(boxes).len());
    watch.stop().seconds() * 1e3
}

/// The scene, grouped, and the time that takes.
fn grouped(scene: Drawable, workers: &Workers) -> (Drawable, f64) {
    let watch = Stopwatch::start();
    let scene = scene.grouped(workers);
    (scene, watch.stop().seconds() * 1e3)
}

/// A still scene all around the camera, which turns: 40 degrees, harmonics of degree 3.
fn still(workers: &Workers, repeat: usize) -> Result<PartTiming> {
    let mut random = Random::new(6);
    let mut still = Still { degree: 3, ..Still::default() };
    for _ in 0..COUNT {
        let away = random.log_range(0.5, 20.0);
        let direction: [f32; 3] = std::array::from_fn(|_| random.range(-1.0, 1.0));
        still.mean.push(direction.map(|d| d * away));
        still.log_scale.push(std::array::from_fn(|_| random.range(-6.5, -4.0) + away.ln()));
        still.rotation.push(std::array::from_fn(|_| random.range(-1.0, 1.0)));
        still.logit.push(random.range(-3.0, 3.0));
        still.base.push(std::array::from_fn(|_| random.range(-1.0, 1.0)));
        still.higher.extend((0..3 * still.rest()).map(|_| random.range(-0.3, 0.3)));
    }
    let scene = Drawable::new(still, workers)?;
    let hierarchy =
        hierarchy((0..COUNT).map(|i| Bounds::of_gaussian(scene.still().mean[i], scene.scale()[i], scene.opacity()[i])));
    let plain = scene.clone();
    let (scene, prepare) = grouped(scene, workers);
    let cameras: Vec<Camera> = (0..CAMERAS)
        .map(|i| {
            let angle = i as f64 / CAMERAS as f64 * std::f64::consts::TAU;
            pinhole([0.0; 3], [angle.sin(), 0.1, angle.cos()], 40.0)
        })
        .collect::<Result<_>>()?;
    let (mut whole, mut part) = (Renderer::new(workers), Renderer::new(workers));
    let sums = draw(
        &cameras,
        repeat,
        |camera| Ok(whole.render_still(&plain, camera, &options())?.clone()),
        |camera| {
            let image = part.render_still(&scene, camera, &options())?.clone();
            Ok((image, part.left_out()))
        },
    )?;
    Ok(PartTiming::new("part-of-still", &sums, prepare, hierarchy))
}

/// An interval in view of the canonical camera, for cameras of 5 degrees that see parts. It is drawn whole; the cost of
/// grouping is measured on its snapshot at one time.
fn interval(workers: &Workers, repeat: usize) -> Result<PartTiming> {
    let mut random = Random::new(7);
    let gaussians: DynamicGaussians = (0..COUNT as u64)
        .map(|identity| Record {
            mean: [random.range(-1.0, 1.0), random.range(0.1, 0.9), random.range(-1.0, 1.0)],
            velocity: [random.range(-0.05, 0.05), 0.0, random.range(-0.05, 0.05)],
            opacity: random.range(0.1, 1.0),
            scale: [random.range(0.001, 0.004), random.range(0.001, 0.004)],
            rgb: [0.5; 3],
            identity,
            ..Record::default()
        })
        .collect();
    let placement = Placement::new(Fit::Stretch, [SIZE[1], SIZE[0]], [SIZE[1], SIZE[0]]).context("a placement")?;
    let interval = Interval { index: 1, start: 0.0, end: 1.0, gaussians, placement, merges: Vec::new(), dropped: 0 };
    let middle = Snapshot::of(&interval, 0.5, workers)?;
    let count = middle.mean.len();
    let hierarchy =
        hierarchy((0..count).map(|i| Bounds::of_gaussian(middle.mean[i], middle.scale[i], middle.opacity[i])));
    let still = Drawable::new(Still::of(&middle), workers)?;
    let prepare = grouped(still, workers).1;
    let mut renderer = Renderer::new(workers);
    let mut least = [f64::INFINITY; CAMERAS];
    for _ in 0..repeat {
        for (i, least) in least.iter_mut().enumerate() {
            let x = 0.2 * i as f64 - 0.7;
            let camera = pinhole([x, 0.1, -1.0], [x, 0.1, 0.5], 5.0)?;
            let watch = Stopwatch::start();
            std::hint::black_box(renderer.render(&interval, 0.5, &camera, &options())?);
            *least = least.min(watch.stop().seconds());
            let work = renderer.work();
            ensure!(work.culled * 10 > work.gaussians * 9, "not a narrow camera: {work:?}");
        }
    }
    let whole = least.iter().sum::<f64>() * 1e3;
    Ok(PartTiming::new("part-of-interval", &Sums { whole, part: None, left_out: 0 }, prepare, hierarchy))
}
