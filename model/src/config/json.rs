//! The JSON file of a checkpoint: settings that shapes do not determine, and others that must agree with them.
//!
//! Keys are at the top level or inside an object `config`; the latter take precedence. Unknown keys are ignored.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use serde_json::{Map, Value};

use crate::ModelError;

/// Longest configuration that is read, in bytes.
const LONGEST: u64 = 16 << 20;

/// The settings of a configuration file.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    file: String,
    values: Map<String, Value>,
}

impl Settings {
    /// No settings; `file` names the source of defaults in errors.
    pub(crate) fn none(file: impl Into<String>) -> Settings {
        Settings { file: file.into(), values: Map::new() }
    }

    /// Reads the JSON file of the checkpoint's name in the same folder. Without one there are no settings.
    pub(crate) fn beside(checkpoint: &Path) -> Result<Settings, ModelError> {
        let path = checkpoint.with_extension("json");
        let file = path.display().to_string();
        let mut text = String::new();
        match File::open(&path).and_then(|file| file.take(LONGEST + 1).read_to_string(&mut text)) {
            Ok(length) if length as u64 > LONGEST => {
                let reason = format!("expected a configuration of at most {LONGEST} bytes, found more");
                Err(ModelError::Format { file, reason })
            }
            Ok(_) => Settings::parse(&text, file),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                Ok(Settings::none(checkpoint.display().to_string()))
            }
            Err(source) => Err(ModelError::Io { file, source }),
        }
    }

    /// Parses the text of `file`.
    pub(crate) fn parse(text: &str, file: impl Into<String>) -> Result<Settings, ModelError> {
        let file = file.into();
        match serde_json::from_str(text) {
            Ok(Value::Object(mut values)) => {
                if let Some(Value::Object(inner)) = values.remove("config") {
                    values.extend(inner);
                }
                Ok(Settings { file, values })
            }
            Ok(_) => Err(ModelError::Format { file, reason: "expected a JSON object".to_owned() }),
            Err(error) => Err(ModelError::Format { file, reason: format!("not JSON: {error}") }),
        }
    }

    /// An error about `key`.
    pub(crate) fn wrong(&self, key: &str, expected: impl Into<String>, found: impl ToString) -> ModelError {
        ModelError::Config {
            file: self.file.clone(),
            key: key.to_owned(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    /// The value of `key`, read by `read`; absent and `null` are the same.
    fn value<T>(&self, key: &str, expected: &str, read: impl Fn(&Value) -> Option<T>) -> Result<Option<T>, ModelError> {
        match self.values.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(value) => read(value).map(Some).ok_or_else(|| self.wrong(key, expected, value)),
        }
    }

    /// A positive integer.
    pub(crate) fn size(&self, key: &str) -> Result<Option<usize>, ModelError> {
        self.value(key, "a positive integer", size)
    }

    /// Two positive integers.
    pub(crate) fn pair(&self, key: &str) -> Result<Option<[usize; 2]>, ModelError> {
        self.value(key, "[height, width]", |value| match value.as_array()?.as_slice() {
            [height, width] => Some([size(height)?, size(width)?]),
            _ => None,
        })
    }

    /// True or false.
    pub(crate) fn flag(&self, key: &str) -> Result<Option<bool>, ModelError> {
        self.value(key, "true or false", Value::as_bool)
    }

    /// A text.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&str>, ModelError> {
        match self.values.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(self.wrong(key, "a string", other)),
        }
    }

    /// Returns an error where the file's value for `key` differs from that of the tensors' shapes.
    pub(crate) fn agrees(&self, key: &str, shapes: usize) -> Result<(), ModelError> {
        match self.size(key)? {
            Some(stated) if stated != shapes => {
                Err(self.wrong(key, format!("{shapes}, as the tensors' shapes"), stated))
            }
            _ => Ok(()),
        }
    }
}

/// A positive integer that a size can have: the bound keeps products of several of them from overflowing.
fn size(value: &Value) -> Option<usize> {
    value.as_u64().filter(|n| (1..=1 << 20).contains(n)).map(|n| n as usize)
}
