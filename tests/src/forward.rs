//! One pair of frames through the whole network, from named tensors to named tensors: for comparisons with other
//! implementations. The binary `forward` does it with files.
//!
//! | input | output |
//! |---|---|
//! | `in.frames [2,3,H,W]`, `in.depths [2,1,H,W]` (zeros when absent), `in.condition [2,M,C]` where the model needs it | `out.tokens_conv`, `out.h`, `out.d` `[2,N,D]`; `out.static_tokens`, `out.dynamic_tokens` `[2,16N,d]`; `out.static.{xyz_static,scale,opacity,rgb}`, `out.dynamic.{velocity,gamma}` `[2,16N,_]` |
//! | `in.frame [1,3,h,w]` (for a DINOv2 file) | `out.resized`, `out.patch_tokens`, `out.cls_token` |
//!
//! `out.static.xyz_static` is the world position (x, y, z), not the offset.

use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::{Dino, DinoLayout, FrameInput, LoadOptions, ModelError, Network, Sampling, Side};

/// A named tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Its name, `out.…`.
    pub name: String,
    /// Its shape; the first axis is the frame.
    pub shape: Vec<usize>,
    /// Its values.
    pub values: Vec<f32>,
}

/// Runs the model at `model` on the tensors of the file `input`.
///
/// # Errors
/// When a file cannot be read, or the model cannot be loaded, or the inputs do not fit it.
pub fn forward_file(model: &Path, input: &Path, options: &LoadOptions) -> Result<Vec<Tensor>, ModelError> {
    let input = Checkpoint::open(input)?;
    match DinoLayout::of(&Checkpoint::open(model)?) {
        Some(_) => forward_dino(&Dino::open(model, options)?, &input),
        None => forward(&Network::open(model, options)?, &input),
    }
}

/// Writes named f32 tensors as a safetensors file.
///
/// # Errors
/// When it cannot be written, or a shape does not have as many elements as its values.
pub fn write(path: &Path, tensors: &[(String, Vec<usize>, &[f32])]) -> Result<(), safetensors::SafeTensorError> {
    let bytes: Vec<Vec<u8>> =
        tensors.iter().map(|(.., values)| values.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let mut views = Vec::new();
    for ((name, shape, _), bytes) in tensors.iter().zip(&bytes) {
        views.push((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?));
    }
    safetensors::serialize_to_file(views, None, path)
}

/// Every output of the network for a pair of frames.
///
/// # Errors
/// When an input is missing or does not fit the network.
pub fn forward(network: &Network, input: &Checkpoint) -> Result<Vec<Tensor>, ModelError> {
    let config = network.config();
    let [height, width] = config.resolution;
    let area = height * width;
    let frames = read(input, "in.frames", &[Some(2), Some(3), Some(height), Some(width)])?;
    let depths = match input.shape("in.depths") {
        Some(_) => Some(read(input, "in.depths", &[Some(2), Some(1), Some(height), Some(width)])?),
        None => None,
    };
    let condition = match config.use_dino {
        true => Some(read(input, "in.condition", &[Some(2), None, Some(config.condition_dim)])?),
        false => None,
    };

    let (n, d) = (config.tokens(), config.hidden_dim);
    let (gaussians, gaussian_dim) = (config.gaussians(), config.gaussian_dim());
    let mut session = network.session(None);
    let mut out = Outputs::default();
    let (mut embeddings, mut statics) = (Vec::new(), Vec::new());
    for frame in 0..2 {
        let rgb = &frames[3 * area * frame..][..3 * area];
        let depth = depths.as_ref().map(|depths| &depths[area * frame..][..area]);
        let tokens = session.tokenize(&FrameInput { rgb, depth })?;
        let embedding = session.encode(&tokens)?;
        let still = session.static_gaussians(&embedding, &Sampling::Mean)?;
        out.push("out.tokens_conv", &[n, d], &tokens);
        out.push("out.h", &[n, d], &embedding.h);
        out.push("out.static_tokens", &[gaussians, gaussian_dim], &still.tokens);
        out.push("out.static.xyz_static", &[gaussians, 3], still.gaussians.position.as_flattened());
        out.push("out.static.scale", &[gaussians, 2], still.gaussians.scale.as_flattened());
        out.push("out.static.opacity", &[gaussians, 1], &still.gaussians.opacity);
        out.push("out.static.rgb", &[gaussians, 3], still.gaussians.rgb.as_flattened());
        embeddings.push(embedding);
        statics.push(still);
    }
    let side = |frame: usize| Side {
        h: &embeddings[frame].h,
        static_tokens: &statics[frame].tokens,
        condition: condition.as_ref().map(|c| &c[c.len() / 2 * frame..][..c.len() / 2]),
    };
    for motion in session.deform(side(0), side(1))? {
        out.push("out.d", &[n, d], &motion.d);
        out.push("out.dynamic_tokens", &[gaussians, gaussian_dim], &motion.tokens);
        out.push("out.dynamic.velocity", &[gaussians, 3], motion.velocity.as_flattened());
        out.push("out.dynamic.gamma", &[gaussians, 2], motion.gamma.as_flattened());
    }
    Ok(out.0)
}

/// Every output of DINOv2 for the frames of `in.frame [B, 3, h, w]`.
///
/// # Errors
/// When the input is missing or malformed.
pub fn forward_dino(dino: &Dino, input: &Checkpoint) -> Result<Vec<Tensor>, ModelError> {
    let frames = read(input, "in.frame", &[None, Some(3), None, None])?;
    let [_, _, height, width] = input.shape("in.frame").and_then(|s| s.try_into().ok()).unwrap_or([0; 4]);
    let config = dino.config();
    let [to_height, to_width] = config.resized_to;
    let mut out = Outputs::default();
    for frame in frames.chunks_exact(3 * height * width) {
        let features = dino.features(frame, [height, width])?;
        out.push("out.resized", &[3, to_height, to_width], &features.resized);
        out.push("out.patch_tokens", &[config.patches(), config.embed_dim], &features.patch_tokens);
        out.push("out.cls_token", &[config.embed_dim], &features.cls_token);
    }
    Ok(out.0)
}

/// An input tensor of this shape (`None`: any size above 0).
fn read(input: &Checkpoint, name: &str, shape: &[Option<usize>]) -> Result<Vec<f32>, ModelError> {
    let sides: Vec<String> = shape.iter().map(|s| s.map_or("_".to_owned(), |s| s.to_string())).collect();
    let expected = format!("[{}]", sides.join(", "));
    let (file, tensor) = (input.file().to_owned(), name.to_owned());
    let Some(found) = input.shape(name) else {
        return Err(ModelError::Missing { file, tensor, expected });
    };
    let fits = |(found, side): (&usize, &Option<usize>)| side.map_or(*found > 0, |side| side == *found);
    if found.len() != shape.len() || !found.iter().zip(shape).all(fits) {
        return Err(ModelError::Shape { file, tensor, expected, found: found.to_vec() });
    }
    Ok(input.read(name)?.into_owned())
}

/// Tensors in the order of their first frame, frames appended.
#[derive(Default)]
struct Outputs(Vec<Tensor>);

impl Outputs {
    /// One frame of the tensor `name`, of this shape.
    fn push(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        match self.0.iter_mut().find(|t| t.name == name) {
            Some(tensor) => {
                tensor.shape[0] += 1;
                tensor.values.extend_from_slice(values);
            }
            None => {
                let shape = std::iter::once(1).chain(shape.iter().copied()).collect();
                self.0.push(Tensor { name: name.to_owned(), shape, values: values.to_vec() });
            }
        }
    }
}
