//! The whole network on the parity data, in every kind of configuration.

use crate::forward::forward;
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::{LoadOptions, Network, Precision};

use super::Thing;

/// The smaller parity cases.
const CASES: [&str; 3] = ["tiny-nodino", "tiny-sampled", "tiny-window"];

pub(super) fn things() -> Vec<Thing> {
    let case = |name: &'static str| {
        Thing::new(format!("network/{name}"), move |level, digest| {
            let path = |end: &str| streamsplat_fixtures::path(&format!("parity/{name}{end}.safetensors"));
            let network =
                Network::open(path(""), &LoadOptions { level, precision: Precision::F32, ..LoadOptions::default() })
                    .expect("a model");
            let input = Checkpoint::open(path(".io")).expect("inputs");
            for tensor in forward(&network, &input).expect("outputs") {
                digest.floats(&tensor.values);
            }
        })
    };
    CASES.map(case).into()
}
