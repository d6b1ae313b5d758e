//! LPIPS (Zhang et al., CVPR 2018) of two pictures, computed by a network in an ONNX file.
//!
//! Accepts any network with two images as inputs, each float `[1, 3, height, width]` with values in [−1, 1], and one
//! number as output: LPIPS as exported from PyTorch. If the network has a fixed size, pictures of another size are
//! resized to it bilinearly. [`crate::onnx`] lists the arithmetic that is the runtime's.

use std::path::Path;

use crate::metrics::{MetricError, check_sizes};
use crate::onnx::{Model, OnnxError};
use crate::picture::Picture;

/// A network that measures the perceptual distance of two pictures.
#[derive(Debug)]
pub struct Lpips {
    model: Model,
    /// Axes of each input before the three of the image.
    leading: [usize; 2],
    /// Height and width, if the network has fixed ones.
    axes: [Option<usize>; 2],
}

/// Why a distance cannot be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LpipsError {
    /// The network.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// The pictures.
    #[error(transparent)]
    Pictures(#[from] MetricError),
}

impl Lpips {
    /// Loads the network in the ONNX file `path`.
    ///
    /// # Errors
    /// No usable ONNX Runtime; a file that is not a network, or not one with two images as inputs and one output.
    pub fn open(path: &Path) -> Result<Lpips, LpipsError> {
        let model = Model::open(path)?;
        let [a, b] = model.inputs() else {
            return Err(
                form(&model, "its inputs", "two images, float [1, 3, height, width]", model.inputs().len()).into()
            );
        };
        let (first, second) = (model.image(a)?, model.image(b)?);
        for (port, layout) in [(a, first), (b, second)] {
            if layout.colours_last {
                let expected = "two images, float [1, 3, height, width]";
                return Err(form(&model, "its inputs", expected, format!("{} {}", port.name, port.kind)).into());
            }
        }
        if first.sides != second.sides {
            return Err(
                form(&model, "its inputs", "two images of one size", format!("{} and {}", a.kind, b.kind)).into()
            );
        }
        if model.outputs().len() != 1 {
            return Err(form(&model, "its outputs", "one number", model.outputs().len()).into());
        }
        Ok(Lpips { leading: [first.leading, second.leading], axes: first.sides, model })
    }

    /// The version of the ONNX Runtime in use.
    pub fn runtime_version(&self) -> &str {
        self.model.runtime().version()
    }

    /// The distance of two pictures of one size.
    ///
    /// # Errors
    /// Different sizes, the runtime's errors, a result that is not one number.
    pub fn distance(&mut self, a: &Picture, b: &Picture) -> Result<f64, LpipsError> {
        check_sizes(a, b)?;
        let [height, width] = [self.axes[0].unwrap_or(a.height), self.axes[1].unwrap_or(a.width)];
        let prepared = [a, b].map(|picture| {
            let mut rgb = picture.resized(width, height).rgb;
            rgb.iter_mut().for_each(|x| *x = 2.0 * *x - 1.0);
            rgb
        });
        let shapes = self.leading.map(|leading| [vec![1; leading], vec![3, height, width]].concat());
        let (shape, answer) = self.model.run(&[(&shapes[0], &prepared[0]), (&shapes[1], &prepared[1])], 0)?;
        match answer[..] {
            [distance] => Ok(f64::from(distance)),
            _ => Err(form(&self.model, "its output", "one number", format!("{shape:?}")).into()),
        }
    }
}

fn form(model: &Model, what: &str, expected: &str, found: impl ToString) -> OnnxError {
    let (what, expected, found) = (what.to_owned(), expected.to_owned(), found.to_string());
    OnnxError::Form { path: model.path().to_owned(), what, expected, found }
}
