//! Stages of the network on request, for comparisons controlled by another program.
//!
//! Reads one JSON object per line on standard input, `{"stage": "encoder|upsampler|decoder|dinov2"}`. Runs that stage
//! once on its input and answers with `{"seconds": …, "processor": …}`, the latter of all threads. With `"write": FILE`
//! the output is written there as the tensor `out`. The model is either StreamSplat or a DINOv2 file, whose only stage
//! is `dinov2`: frame to patch tokens.

use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use safetensors::tensor::{Dtype, TensorView};
use serde::Deserialize;
use streamsplat_bench::timing::Stopwatch;
use streamsplat_model::{Dino, LoadOptions, Network, Precision, Side};

/// Options of `serve`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: streamsplat_bench::Common,
    /// The model, safetensors in the official layout.
    #[arg(long, required_unless_present = "dinov2", conflicts_with = "dinov2")]
    model: Option<PathBuf>,
    /// DINOv2's own file.
    #[arg(long)]
    dinov2: Option<PathBuf>,
    /// Inputs: `encoder [N,D]`, `upsampler [N,D]`, `decoder [2N,D]`, `condition [2,M,D]`; or `frame [3,H,W]` for
    /// DINOv2; f32.
    #[arg(long)]
    input: PathBuf,
    /// f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
}

#[derive(Deserialize)]
struct Request {
    stage: String,
    write: Option<PathBuf>,
}

/// Network to run, with its inputs.
enum Served {
    Network(Box<Network>, Inputs),
    Dino(Box<Dino>, Tensor),
}

struct Tensor {
    shape: Vec<usize>,
    values: Vec<f32>,
}

struct Inputs {
    encoder: Vec<f32>,
    upsampler: Vec<f32>,
    decoder: Vec<f32>,
    condition: Vec<f32>,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let pool = options.common.pool()?;
    let load = LoadOptions { level: options.common.isa, precision: options.precision, ..LoadOptions::default() };
    let served = pool.install(|| Served::load(options, &load))?;
    let mut answers = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let request: Request = serde_json::from_str(&line?).context("a request on standard input")?;
        let watch = Stopwatch::start();
        let out = pool.install(|| served.run(&request.stage))?;
        let spent = watch.stop();
        if let Some(path) = request.write {
            let columns = served.columns(&request.stage);
            let bytes: Vec<u8> = out.iter().flat_map(|x| x.to_le_bytes()).collect();
            let view = TensorView::new(Dtype::F32, vec![out.len() / columns, columns], &bytes)?;
            safetensors::serialize_to_file([("out", view)], None, &path)?;
        }
        writeln!(answers, "{}", serde_json::json!({ "seconds": spent.clock(), "processor": spent.processor() }))?;
        answers.flush()?;
    }
    Ok(())
}

impl Served {
    fn load(options: &Options, load: &LoadOptions) -> Result<Self> {
        let tensors = Tensors::read(&options.input)?;
        if let Some(path) = &options.dinov2 {
            let frame = tensors.get("frame")?;
            ensure!(matches!(frame.shape[..], [3, _, _]), "frame is {:?}, expected [3, H, W]", frame.shape);
            return Ok(Served::Dino(Box::new(Dino::open(path, load)?), frame));
        }
        let path = options.model.as_deref().context("expected --model or --dinov2")?;
        let values = |name| tensors.get(name).map(|tensor| tensor.values);
        let inputs = Inputs {
            encoder: values("encoder")?,
            upsampler: values("upsampler")?,
            decoder: values("decoder")?,
            condition: values("condition")?,
        };
        Ok(Served::Network(Box::new(Network::open(path, load)?), inputs))
    }

    fn run(&self, stage: &str) -> Result<Vec<f32>> {
        match self {
            Served::Network(network, inputs) => inputs.run(network, stage),
            Served::Dino(dino, frame) if stage == "dinov2" => {
                Ok(dino.features(&frame.values, [frame.shape[1], frame.shape[2]])?.patch_tokens)
            }
            Served::Dino(..) => bail!("unknown stage {stage:?}: expected dinov2"),
        }
    }

    /// Values in a row of a stage's output.
    fn columns(&self, stage: &str) -> usize {
        match self {
            Served::Network(network, _) if stage == "upsampler" => network.config().gaussian_dim(),
            Served::Network(network, _) => network.config().hidden_dim,
            Served::Dino(dino, _) => dino.config().embed_dim,
        }
    }
}

/// The tensors of a file.
struct Tensors {
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Tensors {
    fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
        Ok(Self { path: path.to_owned(), bytes })
    }

    fn get(&self, name: &str) -> Result<Tensor> {
        let file = safetensors::SafeTensors::deserialize(&self.bytes);
        let file = file.with_context(|| format!("{}", self.path.display()))?;
        let view = file.tensor(name).with_context(|| format!("{}", self.path.display()))?;
        let found = view.dtype();
        ensure!(found == Dtype::F32, "{}: {name} is {found:?}, expected F32", self.path.display());
        let values = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        Ok(Tensor { shape: view.shape().to_vec(), values })
    }
}

impl Inputs {
    fn run(&self, network: &Network, stage: &str) -> Result<Vec<f32>> {
        Ok(match stage {
            "encoder" => network.session(None).encode(&self.encoder)?.h,
            "upsampler" => network.session(None).upsample_static(&self.upsampler)?,
            "decoder" => {
                let (h_a, h_b) = self.decoder.split_at(self.decoder.len() / 2);
                let (c_a, c_b) = self.condition.split_at(self.condition.len() / 2);
                let side = |h, condition| Side { h, static_tokens: &[], condition: Some(condition) };
                network.session(None).decode(&side(h_a, c_a), &side(h_b, c_b))?.concat()
            }
            _ => bail!("unknown stage {stage:?}: expected encoder, upsampler or decoder"),
        })
    }
}
