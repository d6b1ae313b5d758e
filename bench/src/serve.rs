//! Stages of the network on request, for comparisons that are driven from outside.
//!
//! Reads one JSON object per line on standard input, `{"stage": "encoder|upsampler|decoder"}`, runs that stage once on the
//! given input, and answers with `{"seconds": …}`. With `"write": FILE` the output goes there as the tensor `out`.

use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use safetensors::tensor::{Dtype, TensorView};
use serde::Deserialize;
use streamsplat_model::{LoadOptions, Network, Precision, Side};

/// Options of `serve`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: crate::Common,
    /// The model, safetensors in the official layout.
    #[arg(long)]
    model: PathBuf,
    /// Inputs: `encoder [N,D]`, `upsampler [N,D]`, `decoder [2N,D]`, `condition [2,M,D]`, f32.
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

struct Inputs {
    encoder: Vec<f32>,
    upsampler: Vec<f32>,
    decoder: Vec<f32>,
    condition: Vec<f32>,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let pool = options.common.pool()?;
    let load = LoadOptions { level: options.common.isa, precision: options.precision };
    let network = pool.install(|| Network::open(&options.model, &load))?;
    let inputs = Inputs::read(&options.input)?;
    let mut answers = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let request: Request = serde_json::from_str(&line?).context("a request on standard input")?;
        let start = Instant::now();
        let out = pool.install(|| inputs.run(&network, &request.stage))?;
        let seconds = start.elapsed().as_secs_f64();
        if let Some(path) = request.write {
            let columns = network.config().hidden_dim;
            let columns = if request.stage == "upsampler" { network.config().gaussian_dim() } else { columns };
            let bytes: Vec<u8> = out.iter().flat_map(|x| x.to_le_bytes()).collect();
            let view = TensorView::new(Dtype::F32, vec![out.len() / columns, columns], &bytes)?;
            safetensors::serialize_to_file([("out", view)], None, &path)?;
        }
        writeln!(answers, "{}", serde_json::json!({ "seconds": seconds }))?;
        answers.flush()?;
    }
    Ok(())
}

impl Inputs {
    fn read(path: &PathBuf) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
        let file = safetensors::SafeTensors::deserialize(&bytes).with_context(|| format!("{}", path.display()))?;
        let tensor = |name: &str| -> Result<Vec<f32>> {
            let view = file.tensor(name).with_context(|| format!("{}", path.display()))?;
            ensure!(view.dtype() == Dtype::F32, "{}: {name} is {:?}, expected F32", path.display(), view.dtype());
            Ok(view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        Ok(Self {
            encoder: tensor("encoder")?,
            upsampler: tensor("upsampler")?,
            decoder: tensor("decoder")?,
            condition: tensor("condition")?,
        })
    }

    fn run(&self, network: &Network, stage: &str) -> Result<Vec<f32>> {
        Ok(match stage {
            "encoder" => network.encode(&self.encoder)?.h,
            "upsampler" => network.upsample_static(&self.upsampler)?,
            "decoder" => {
                let (h_a, h_b) = self.decoder.split_at(self.decoder.len() / 2);
                let (c_a, c_b) = self.condition.split_at(self.condition.len() / 2);
                let side = |h, condition| Side { h, static_tokens: &[], condition: Some(condition) };
                network.decode(&side(h_a, c_a), &side(h_b, c_b))?.concat()
            }
            _ => bail!("unknown stage {stage:?}: expected encoder, upsampler or decoder"),
        })
    }
}
