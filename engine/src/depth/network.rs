//! Depth maps from a network.
//!
//! Any network with one image input and one map output, such as Depth Anything:
//!
//! - Input: float `[1, 3, height, width]` or, colours last, `[1, height, width, 3]`. More leading axes of length 1 are
//!   allowed, and each side may be dynamic.
//! - Output: float `[1, height, width]` of any size, with any number of leading axes of length 1, or one trailing.
//!
//! The map is inverse depth, or depth with [`NetworkOptions::metric`]. [`crate::onnx`] describes which arithmetic is
//! done by ONNX Runtime and which by this crate.

use std::path::Path;

use super::{DepthError, NetworkOptions, NetworkSize, prepare};
use crate::onnx::{Layout, Model, OnnxError, Port};
use crate::picture::size_is_allowed;
use crate::stream::Workers;

/// A network that computes the inverse depth of a frame.
#[derive(Debug)]
pub struct DepthNetwork {
    model: Model,
    options: NetworkOptions,
    workers: Workers,
    /// The input's axes.
    layout: Layout,
    output: usize,
}

impl DepthNetwork {
    /// Loads the network in the ONNX file `path`; pictures are prepared on `workers`.
    ///
    /// # Errors
    /// A missing or unusable ONNX Runtime; a file that is not a network, or not one with an image input and a map
    /// output.
    pub fn open(path: &Path, options: NetworkOptions, workers: &Workers) -> Result<DepthNetwork, DepthError> {
        let model = Model::open(path)?;
        let form = |what: &str, expected: String, found: String| OnnxError::Form {
            path: path.to_owned(),
            what: what.to_owned(),
            expected,
            found,
        };
        let [input] = model.inputs() else {
            return Err(
                form("its inputs", "one image, float [1, 3, height, width]".to_owned(), names(model.inputs())).into()
            );
        };
        let layout = model.image(input)?;
        let axes = layout.sides;
        if let Some(side) = axes.iter().flatten().find(|side| !(1..=8192).contains(*side)) {
            return Err(form("its input", "sides from 1 to 8192".to_owned(), side.to_string()).into());
        }
        if let NetworkSize::Exact(asked) = options.size
            && axes.iter().zip(asked).any(|(axis, asked)| axis.is_some_and(|fixed| fixed != asked))
        {
            let side = |axis: Option<usize>| axis.map_or_else(|| "any".to_owned(), |side| side.to_string());
            let found = format!("{} by {}", side(axes[1]), side(axes[0]));
            return Err(form("its input", format!("the {}x{} asked for", asked[1], asked[0]), found).into());
        }
        let output = map_output(&model, options.output.as_deref())?;
        Ok(DepthNetwork { model, options, workers: workers.clone(), layout, output })
    }

    /// Returns the version of the ONNX Runtime in use.
    pub fn runtime_version(&self) -> &str {
        self.model.runtime().version()
    }

    /// Computes the inverse depth of a frame of `[3, height, width]` samples in [0, 1]: `height · width` values.
    ///
    /// # Errors
    /// An input above the size limit, the runtime's errors, a result that is not a map.
    ///
    /// # Panics
    /// If `rgb` does not hold three planes of that size, or a side is zero.
    pub fn map(&mut self, rgb: &[f32], width: usize, height: usize) -> Result<Vec<f32>, DepthError> {
        let frame = [height, width];
        let size = prepare::input_size(frame, self.layout.sides, &self.options);
        if !prepare::is_allowed(size) {
            return Err(DepthError::Input { path: self.model.path().to_owned(), frame, input: size });
        }
        let DepthNetwork { model, options, workers, layout, output } = self;
        let level = workers.level();
        let input = workers.install(|| prepare::image(level, rgb, frame, size, options));
        let mut shape = vec![1; layout.leading];
        let input = if layout.colours_last {
            shape.extend([size[0], size[1], 3]);
            let area = size[0] * size[1];
            (0..3 * area).map(|at| input[at % 3 * area + at / 3]).collect()
        } else {
            shape.extend([3, size[0], size[1]]);
            input
        };
        let (shape, answer) = model.run(&[(&shape, &input)], *output)?;
        let ones = |axes: &[usize]| axes.iter().all(|&n| n == 1);
        let from = match shape[..] {
            [ref leading @ .., h, w] if ones(leading) && size_is_allowed(w, h) => [h, w],
            [ref leading @ .., h, w, 1] if ones(leading) && size_is_allowed(w, h) => [h, w],
            _ => {
                return Err(OnnxError::Form {
                    path: model.path().to_owned(),
                    what: format!("its output {}", model.outputs()[*output].name),
                    expected: "one map [1, height, width]".to_owned(),
                    found: format!("{shape:?}"),
                }
                .into());
            }
        };
        Ok(workers.install(|| prepare::map(level, answer, from, frame, options.metric)))
    }
}

/// Returns the index of the output that is the map.
fn map_output(model: &Model, asked: Option<&str>) -> Result<usize, OnnxError> {
    let wrong = |what: String, expected: &str, found: String| OnnxError::Form {
        path: model.path().to_owned(),
        what,
        expected: expected.to_owned(),
        found,
    };
    let outputs = model.outputs();
    let number = match asked {
        Some(name) => outputs.iter().position(|output| output.name == name),
        None if outputs.len() == 1 => Some(0),
        None => {
            return Err(wrong("its outputs".to_owned(), "one map, or output=NAME to choose it", names(outputs)));
        }
    };
    let number = number.ok_or_else(|| wrong("its outputs".to_owned(), asked.unwrap_or("an output"), names(outputs)))?;
    let output = &outputs[number];
    // A shape that is unknown before the network runs has no axes.
    let is_map = output.axes.as_deref().is_some_and(|axes| {
        let ones = |axes: &[Option<usize>]| axes.iter().all(|n| matches!(n, Some(1) | None));
        let last = |behind: usize| axes.len() >= 2 + behind && ones(&axes[..axes.len() - 2 - behind]);
        axes.is_empty() || last(0) || (axes.last() == Some(&Some(1)) && last(1))
    });
    match is_map {
        true => Ok(number),
        false => {
            Err(wrong(format!("its output {}", output.name), "one map, float [1, height, width]", output.kind.clone()))
        }
    }
}

fn names(ports: &[Port]) -> String {
    let listed: Vec<String> = ports.iter().map(|port| format!("{} {}", port.name, port.kind)).collect();
    if listed.is_empty() { "none".to_owned() } else { listed.join(", ") }
}
