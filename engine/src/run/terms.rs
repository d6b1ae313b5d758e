//! Terms of a run: the program, options and model, which determine its output together with the input.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::run::options::{DepthSource, RunOptions};
use crate::run::record::{Build, ModelRecord, NetworkRecord, Record, absolute};
use crate::run::{Error, digest};

/// Options whose files are compared by their content instead.
const BY_CONTENT: [&str; 2] = ["model", "dinov2"];

/// Program version, options and model.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Terms {
    version: String,
    /// Properties of the program, in addition to its version, that determine output bytes.
    #[serde(flatten)]
    build: Build,
    /// [`RunOptions`], with absolute paths.
    options: Value,
    model: ModelRecord,
    /// Digest of the camera's file.
    camera: Option<String>,
    /// Digest of the depth network.
    network: Option<String>,
}

impl Terms {
    /// The terms of a run with these options.
    pub fn given(options: &RunOptions, model: &ModelRecord, build: &Build) -> Result<Terms, Error> {
        let network = options.stream.depth_network();
        Ok(Terms {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build: build.clone(),
            options: serde_json::to_value(with_absolute_paths(options)).map_err(Error::work)?,
            model: model.clone(),
            camera: options.view.camera.as_deref().map(digest::file).transpose()?,
            network: network.map(NetworkRecord::digest).transpose()?,
        })
    }

    /// The terms of a recorded run. The record does not contain the digest of the camera's file.
    pub fn recorded(record: &Record, options: &RunOptions) -> Result<Terms, Error> {
        let model = record.model.clone().ok_or_else(|| Error::work("run.json: expected a model, found none"))?;
        let options = serde_json::to_value(options).map_err(Error::work)?;
        let network = record.depth.as_ref().map(|network| network.blake3.clone());
        Ok(Terms {
            version: record.version.clone(),
            build: record.build.clone(),
            options,
            model,
            camera: None,
            network,
        })
    }

    /// The same terms with the build of `record`, for comparing runs regardless of the program that made them.
    pub fn built_as(self, record: &Record) -> Terms {
        Terms { build: record.build.clone(), ..self }
    }

    /// Returns an error that names the first difference to `given`.
    pub fn check(&self, given: &Terms) -> Result<(), Error> {
        let work = |what: &str, recorded: &str, given: &str| {
            Err(Error::work(format!("--resume: {what}: recorded {recorded}, given {given}")))
        };
        if self.version != given.version {
            return work("the program's version", &self.version, &given.version);
        }
        if self.build.bit_contract != given.build.bit_contract {
            let [recorded, given] = [&self.build, &given.build].map(|build| build.bit_contract.to_string());
            return work("the version of the bit contract", &recorded, &given);
        }
        if self.build.program != given.build.program {
            return work("the program", &self.build.program, &given.build.program);
        }
        if self.model.blake3 != given.model.blake3 {
            let of = |model: &ModelRecord| format!("{} with the digest {}", model.path, model.blake3);
            return work("the model", &of(&self.model), &of(&given.model));
        }
        // Defaults of options depend on the model, so the model is compared first.
        if let Some((option, recorded, given)) = difference("", &self.options, &given.options) {
            let message = format!("--resume: --{option}: the run was started with {recorded}, given {given}");
            return Err(Error::usage(message));
        }
        let files =
            [("the camera's file", &self.camera, &given.camera), ("the depth network", &self.network, &given.network)];
        for (what, recorded, given) in files {
            if let (Some(recorded), Some(given)) = (recorded, given)
                && recorded != given
            {
                return work(what, &format!("digest {recorded}"), &format!("digest {given}"));
            }
        }
        Ok(())
    }
}

/// Returns the options with absolute paths.
pub fn with_absolute_paths(options: &RunOptions) -> RunOptions {
    let mut options = options.clone();
    for path in [&mut options.stream.model.model, &mut options.stream.model.dinov2, &mut options.view.camera] {
        *path = path.as_deref().map(absolute);
    }
    if let Some(DepthSource::Folder(path) | DepthSource::Network(path)) = &mut options.stream.depth {
        *path = absolute(path);
    }
    options
}

/// The name of the first option that differs, with both values.
fn difference(name: &str, recorded: &Value, given: &Value) -> Option<(String, String, String)> {
    if let (Value::Object(a), Value::Object(b)) = (recorded, given) {
        let names = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key)));
        let side = |map: &serde_json::Map<String, Value>, key: &String| map.get(key).cloned().unwrap_or(Value::Null);
        return names.filter_map(|key| difference(key, &side(a, key), &side(b, key))).next();
    }
    if recorded == given || BY_CONTENT.contains(&name) {
        return None;
    }
    let said = |value: &Value| match value {
        Value::Null => "its default".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    Some((name.replace('_', "-"), said(recorded), said(given)))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn another_contract_and_another_program_are_refused() {
        let options = RunOptions::default();
        let this = Build::of(None);
        let model = ModelRecord { path: "embedded".to_owned(), blake3: "ab".to_owned() };
        let given = Terms::given(&options, &model, &this).expect("terms");
        assert!(given.check(&given).is_ok());
        let other = |build: Build| Terms { build, ..given.clone() };
        let contract = other(Build { bit_contract: 0, ..this.clone() });
        let message = contract.check(&given).expect_err("another contract").to_string();
        assert!(message.contains("the version of the bit contract: recorded 0, given"), "{message}");
        let program = other(Build { program: "another".to_owned(), ..this.clone() });
        let message = program.check(&given).expect_err("another program").to_string();
        assert!(message.contains("the program: recorded another, given"), "{message}");
        let model = Terms { model: ModelRecord { blake3: "cd".to_owned(), ..model }, ..given.clone() };
        assert!(model.check(&given).is_err());
    }

    #[test]
    fn the_first_option_that_differs_is_named() {
        let recorded = json!({"stream": {"gap": "4", "max_age": null, "model": {"model": "/a"}}, "fit": "letterbox"});
        assert_eq!(difference("", &recorded, &recorded), None);
        let mut given = recorded.clone();
        given["stream"]["model"]["model"] = "/b".into();
        assert_eq!(difference("", &recorded, &given), None, "models are compared by their digests");
        given["stream"]["max_age"] = 3.into();
        let found = difference("", &recorded, &given).expect("one differs");
        assert_eq!((found.0.as_str(), found.1.as_str(), found.2.as_str()), ("max-age", "its default", "3"));
    }
}
