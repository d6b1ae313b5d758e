//! Networks with all inputs of a new key frame, and their stages one by one.

use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result};
use streamsplat::stream::{EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG};
use streamsplat_bench::timing::{Spent, Stopwatch};
use streamsplat_fixtures::seeded::{self, Sizes, uniform};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Gaussians, Projection, Request, render};
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::{Deformation, Dino, FrameInput, LoadOptions, Network, Sampling, Side, StaticGaussians, motion};
use tempfile::{NamedTempFile, TempPath};

/// The model.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Which<'a> {
    /// The checkpoint inside the library.
    Small,
    /// The published model's sizes with weights from a seed, through a temporary file.
    Paper,
    /// A small network with weights from a seed.
    Seeded,
    /// A checkpoint, with DINOv2's weights where it is conditioned on DINOv2.
    File { checkpoint: &'a Path, dinov2: Option<&'a Path> },
}

impl Which<'_> {
    /// Calls `work` with the network's checkpoint.
    pub(crate) fn with_checkpoint<R>(self, work: impl FnOnce(&Checkpoint) -> R) -> Result<R> {
        Ok(match self {
            Which::Small => work(&Checkpoint::from_storage(EMBEDDED_CHECKPOINT, "the embedded model")?),
            Which::Paper => {
                let file = temporary(|out| Sizes::paper().write(31, "model.", out))?;
                work(&Checkpoint::open(&file)?)
            }
            Which::Seeded => work(&Checkpoint::from_storage(seeded_network()?, "seeded weights")?),
            Which::File { checkpoint, .. } => work(&Checkpoint::open(checkpoint)?),
        })
    }
}

/// Sizes of [`Which::Seeded`].
fn seeded_sizes() -> Sizes {
    Sizes::small([16, 32], 32)
}

fn seeded_network() -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    seeded_sizes().write(31, "model.", &mut bytes).context("seeded weights")?;
    Ok(bytes)
}

/// `repeat` times from a model's files, in the system's cache, to the tokens of a first frame. Empty for models in
/// memory.
pub(crate) fn loading(which: Which<'_>, load: &LoadOptions, repeat: usize) -> Result<Vec<Spent>> {
    let time = |checkpoint: &Path, dinov2: Option<&Path>| -> Result<Vec<Spent>> {
        let mut spent = Vec::new();
        for _ in 0..repeat.max(1) {
            let watch = Stopwatch::start();
            let network = Network::open(checkpoint, load)?;
            let dino = dinov2.map(|file| Dino::open(file, load)).transpose()?;
            let [rgb, _] = noise(network.config().resolution)?;
            let tokens = network.session(None).tokenize(&FrameInput { rgb: &rgb, depth: None })?;
            std::hint::black_box((tokens, dino));
            spent.push(watch.stop());
        }
        Ok(spent)
    };
    match which {
        Which::Small | Which::Seeded => Ok(Vec::new()),
        Which::Paper => {
            let network = temporary(|out| Sizes::paper().write(31, "model.", out))?;
            let dino = temporary(|out| seeded::write(&seeded::dino_shapes(768, 12), 32, "", out))?;
            time(&network, Some(&dino))
        }
        Which::File { checkpoint, dinov2 } => time(checkpoint, dinov2),
    }
}

/// Two frames of noise.
pub(crate) fn noise([height, width]: [usize; 2]) -> Result<[Vec<f32>; 2]> {
    let image = |seed: u64| -> Vec<f32> {
        let mut state = seed;
        (0..3 * height * width).map(|_| uniform(&mut state)).collect()
    };
    Ok([image(1), image(2)])
}

/// A network with all inputs of a new key frame.
pub(crate) struct Model {
    pub(crate) network: Network,
    pub(crate) dino: Option<Dino>,
    pub(crate) level: Level,
    pub(crate) rgb: [Vec<f32>; 2],
    tokens: Vec<f32>,
    h: [Vec<f32>; 2],
    static_tokens: [Vec<f32>; 2],
    pub(crate) condition: [Option<Vec<f32>>; 2],
    still: [StaticGaussians; 2],
    moving: [Deformation; 2],
}

/// A seeded model as a file that is removed when dropped.
fn temporary(write: impl FnOnce(&mut BufWriter<NamedTempFile>) -> std::io::Result<()>) -> Result<TempPath> {
    let mut file = BufWriter::new(tempfile::Builder::new().suffix(".safetensors").tempfile()?);
    write(&mut file).context("writing seeded weights")?;
    Ok(file.into_inner().context("writing seeded weights")?.into_temp_path())
}

impl Model {
    /// Loads a model that has processed two frames: `frames` of its resolution, `[3, H, W]` each.
    pub(crate) fn load(
        which: Which<'_>,
        load: &LoadOptions,
        frames: &dyn Fn([usize; 2]) -> Result<[Vec<f32>; 2]>,
    ) -> Result<Model> {
        let (network, dino) = match which {
            Which::Small => (Network::from_parts(EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG, load)?, None),
            Which::Seeded => (Network::from_parts(seeded_network()?, &seeded_sizes().json().to_string(), load)?, None),
            Which::Paper => {
                let file = temporary(|out| Sizes::paper().write(31, "model.", out))?;
                let network = Network::open(&file, load)?;
                let file = temporary(|out| seeded::write(&seeded::dino_shapes(768, 12), 32, "", out))?;
                (network, Some(Dino::open(&file, load)?))
            }
            Which::File { checkpoint, dinov2 } => {
                let network = Network::open(checkpoint, load)?;
                let dino = match dinov2 {
                    Some(file) if network.config().use_dino => Some(Dino::open(file, load)?),
                    _ => None,
                };
                (network, dino)
            }
        };
        let [height, width] = network.config().resolution;
        let rgb = frames([height, width])?;
        let mut session = network.session(None);
        let tokens = session.tokenize(&FrameInput { rgb: &rgb[1], depth: None })?;
        let features = |rgb: &[f32]| -> Result<Option<Vec<f32>>> {
            Ok(match &dino {
                Some(dino) => Some(dino.features(rgb, [height, width])?.patch_tokens),
                None => None,
            })
        };
        let condition = [features(&rgb[0])?, features(&rgb[1])?];
        let mut embed = |rgb: &[f32]| -> Result<_> {
            let embedding = session.embed(&FrameInput { rgb, depth: None })?;
            let still = session.static_gaussians(&embedding, &Sampling::Mean)?;
            Ok((embedding.h, still))
        };
        let (h_a, a) = embed(&rgb[0])?;
        let (h_b, b) = embed(&rgb[1])?;
        let (h, static_tokens) = ([h_a, h_b], [a.tokens, b.tokens]);
        let side = |i: usize| Side { h: &h[i], static_tokens: &static_tokens[i], condition: condition[i].as_deref() };
        let moving = session.deform(side(0), side(1))?;
        let (level, still) = (load.level, [a.gaussians, b.gaussians]);
        Ok(Model { network, dino, level, rgb, tokens, h, static_tokens, condition, still, moving })
    }

    fn side(&self, i: usize) -> Side<'_> {
        Side { h: &self.h[i], static_tokens: &self.static_tokens[i], condition: self.condition[i].as_deref() }
    }

    pub(crate) fn features(&self, i: usize) -> Result<Vec<f32>> {
        Ok(match &self.dino {
            Some(dino) => dino.features(&self.rgb[i], self.network.config().resolution)?.patch_tokens,
            None => Vec::new(),
        })
    }

    /// Runs a stage once and returns its output. Its input is the output of the previous stages at the same precision.
    pub(crate) fn stage(&self, name: &str) -> Result<Vec<f32>> {
        let mut session = self.network.session(None);
        Ok(match name {
            "encoder" => session.encode(&self.tokens)?.h,
            "upsampler" => session.upsample_static(&self.h[1])?,
            "decoder" => session.decode(&self.side(0), &self.side(1))?.concat(),
            "dinov2" => self.features(1)?,
            "heads" => {
                let still = session.static_head(&self.static_tokens[1], &Sampling::Mean)?;
                let mut out = still.position.into_flattened();
                for (place, (moving, tokens)) in self.moving.iter().zip(&self.static_tokens).enumerate() {
                    out.extend(session.deformation_head(place, tokens, &moving.tokens)?.0.into_flattened());
                }
                out
            }
            "raster" => self.draw(),
            // All work of one more key frame.
            _ => {
                let features = self.features(1)?;
                let embedding = session.embed(&FrameInput { rgb: &self.rgb[1], depth: None })?;
                let still = session.static_gaussians(&embedding, &Sampling::Mean)?;
                let condition = self.dino.is_some().then_some(features.as_slice());
                let new = Side { h: &embedding.h, static_tokens: &still.tokens, condition };
                let [a, b] = session.deform(self.side(0), new)?;
                [a.velocity, b.velocity].concat().into_flattened()
            }
        })
    }

    /// Both frames' Gaussians in the middle of their interval, from the canonical camera.
    fn draw(&self) -> Vec<f32> {
        let [height, width] = self.network.config().resolution;
        let (mut mean, mut scale, mut opacity, mut rgb) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for ((still, moving), tau) in self.still.iter().zip(&self.moving).zip([0.5, -0.5]) {
            let mut position = vec![[0.0; 3]; still.position.len()];
            motion::position_at(&still.position, &moving.velocity, tau, &mut position);
            mean.extend(position.iter().map(|[x, y, z]| [*x, -z, 1.0 / (9.8 * y + 0.2 + 1e-6)]));
            scale.extend(still.scale.iter().map(|[x, z]| [*x, *z, 0.5 * (x + z)]));
            let mut faded = vec![0.0; position.len()];
            motion::opacity_at(self.level, &still.opacity, &moving.gamma, tau, &mut faded);
            opacity.extend(faded);
            rgb.extend_from_slice(&still.rgb);
        }
        let gaussians = Gaussians { mean: &mean, scale: &scale, rotation: None, opacity: &opacity, rgb: &rgb };
        let projection = Projection::Orthographic { focal: [width as f32 / 2.0, height as f32 / 2.0] };
        let request = Request::colour(width, height, [0.5; 3]);
        render(self.level, &gaussians, &projection, &request).rgb
    }
}
