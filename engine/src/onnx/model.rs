//! A network, its inputs and outputs.

use std::path::{Path, PathBuf};

use ort::session::builder::GraphOptimizationLevel;
use ort::session::{Session, SessionInputValue};
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};

use super::{OnnxError, Runtime};

/// An input or an output of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Its name.
    pub name: String,
    /// Its axes, `None` where the length is left open. The whole is `None` unless the port is a tensor of 32-bit
    /// floats.
    pub axes: Option<Vec<Option<usize>>>,
    /// Type and shape for messages.
    pub kind: String,
}

impl Port {
    fn new(outlet: &Outlet) -> Port {
        let kind = outlet.dtype();
        let axes = match kind {
            ValueType::Tensor { ty: TensorElementType::Float32, shape, .. } => {
                Some(shape.iter().map(|&length| usize::try_from(length).ok()).collect())
            }
            _ => None,
        };
        Port { name: outlet.name().to_owned(), axes, kind: kind.to_string() }
    }
}

/// Axes of an image input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Number of leading axes of length 1, before the three of the image.
    pub leading: usize,
    /// True for height, width, colours; false for colours, height, width.
    pub colours_last: bool,
    /// Height and width, if they are fixed.
    pub sides: [Option<usize>; 2],
}

impl Layout {
    fn of(axes: &[Option<usize>]) -> Option<Layout> {
        let [ones @ .., first, second, third] = axes else { return None };
        let (colours_last, sides) = match (first, third) {
            (Some(3), _) => (false, [*second, *third]),
            (_, Some(3)) => (true, [*first, *second]),
            (None, _) => (false, [*second, *third]),
            _ => return None,
        };
        let leading = ones.len();
        ones.iter().all(|n| matches!(n, Some(1) | None)).then_some(Layout { leading, colours_last, sides })
    }
}

/// A network in memory, ready to run.
#[derive(Debug)]
pub struct Model {
    path: PathBuf,
    runtime: Runtime,
    session: Session,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
}

impl Model {
    /// Loads ONNX Runtime, then the network.
    ///
    /// # Errors
    /// No usable runtime; a file that is missing or is not a network that it can run.
    pub fn open(path: &Path) -> Result<Model, OnnxError> {
        let wrong = |cause: String| OnnxError::Model { path: path.to_owned(), cause };
        // Checked before the search for the runtime: a missing file is reported with the system's message.
        match std::fs::metadata(path) {
            Err(e) => return Err(wrong(e.to_string())),
            Ok(found) if !found.is_file() => return Err(wrong("it is no file".to_owned())),
            Ok(found) if found.len() == 0 => return Err(wrong("it is empty (0 bytes)".to_owned())),
            Ok(_) => {}
        }
        let runtime = Runtime::load()?;
        let session = commit(&runtime, path).map_err(|e| wrong(e.to_string()))?;
        let inputs = session.inputs().iter().map(Port::new).collect();
        let outputs = session.outputs().iter().map(Port::new).collect();
        Ok(Model { path: path.to_owned(), runtime, session, inputs, outputs })
    }

    /// Returns the network's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the runtime that runs it.
    pub fn runtime(&self) -> &Runtime {
        &self.runtime
    }

    /// Returns its inputs, in its own order.
    pub fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    /// Returns its outputs, in its own order.
    pub fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    /// Returns the axes of an image port. If the last axis is 3 and the colour axis is not, colours are last.
    ///
    /// # Errors
    /// A port that is not one image, float `[1, 3, height, width]` or `[1, height, width, 3]` with any axes of length 1
    /// in front.
    pub fn image(&self, port: &Port) -> Result<Layout, OnnxError> {
        port.axes.as_deref().and_then(Layout::of).ok_or_else(|| OnnxError::Form {
            path: self.path.clone(),
            what: format!("its input {}", port.name),
            expected: "one image, float [1, 3, height, width] or [1, height, width, 3]".to_owned(),
            found: port.kind.clone(),
        })
    }

    /// Runs the network on a shape and row-major values for each input; returns shape and values of the output number
    /// `output`.
    ///
    /// # Errors
    /// Errors of the runtime: values that do not fit, insufficient memory.
    ///
    /// # Panics
    /// If the number of inputs is wrong, or `output` does not exist.
    pub fn run(&mut self, inputs: &[(&[usize], &[f32])], output: usize) -> Result<(Vec<usize>, Vec<f32>), OnnxError> {
        assert_eq!(inputs.len(), self.inputs.len(), "one tensor for each input");
        let name = &self.outputs[output].name;
        let path = &self.path;
        let failed = |e: ort::Error| OnnxError::Run { path: path.clone(), cause: e.to_string() };
        let mut values: Vec<(&str, SessionInputValue<'_>)> = Vec::with_capacity(inputs.len());
        for (port, (shape, samples)) in self.inputs.iter().zip(inputs) {
            let tensor = TensorRef::from_array_view((shape.to_vec(), *samples)).map_err(failed)?;
            values.push((&port.name, tensor.into()));
        }
        let results = self.session.run(values).map_err(failed)?;
        let Some(result) = results.get(name) else {
            return Err(OnnxError::Run { path: path.clone(), cause: format!("there is no output {name}") });
        };
        let (shape, samples) = result.try_extract_tensor::<f32>().map_err(failed)?;
        Ok((shape.iter().map(|&length| length as usize).collect(), samples.to_vec()))
    }
}

/// One thread, node after node, deterministic kernels: the same bits for any number of this program's threads.
fn commit(runtime: &Runtime, path: &Path) -> ort::Result<Session> {
    Session::builder(&runtime.environment)?
        .with_intra_threads(1)?
        .with_inter_threads(1)?
        .with_parallel_execution(false)?
        .with_deterministic_compute(true)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .commit_from_file(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_the_axis_that_is_three() {
        let open = None;
        let of =
            |axes: &[Option<usize>]| Layout::of(axes).map(|layout| (layout.leading, layout.colours_last, layout.sides));
        assert_eq!(of(&[Some(1), Some(3), open, open]), Some((1, false, [open, open])));
        assert_eq!(of(&[Some(1), open, open, Some(3)]), Some((1, true, [open, open])));
        assert_eq!(of(&[open, Some(518), Some(924), Some(3)]), Some((1, true, [Some(518), Some(924)])));
        assert_eq!(of(&[Some(3), Some(8), Some(3)]), Some((0, false, [Some(8), Some(3)])));
        assert_eq!(of(&[open, open, open, open]), Some((1, false, [open, open])));
        assert_eq!(of(&[Some(2), Some(3), open, open]), None);
        assert_eq!(of(&[Some(1), Some(4), open, open]), None);
        assert_eq!(of(&[Some(1), Some(3)]), None);
    }
}
