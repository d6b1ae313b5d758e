//! Search for ONNX Runtime's shared library.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::OnnxError;
use crate::folder::natural;

/// File name of the library; on Linux and macOS the name may contain a version.
const LIBRARY: &str = if cfg!(windows) {
    "onnxruntime.dll"
} else if cfg!(target_vendor = "apple") {
    "libonnxruntime.dylib"
} else {
    "libonnxruntime.so"
};

/// Prints the folder of the package's libraries without importing it. Python runs isolated, so that no foreign file is
/// executed: it searches the user's own packages, but neither the working folder nor the folders of environment
/// variables.
const ASK: &str = "import importlib.util, os, site, sys; sys.path.append(site.getusersitepackages()); \
                   s = importlib.util.find_spec('onnxruntime'); \
                   print(os.path.join(os.path.dirname(s.origin), 'capi') if s and s.origin else '')";

/// Finds the library's file (in the order in the module above), as an absolute path.
pub(super) fn library() -> Result<PathBuf, OnnxError> {
    if let Some(named) = std::env::var_os("ORT_DYLIB_PATH").filter(|value| !value.is_empty()) {
        let path = PathBuf::from(named);
        return if path.is_file() { Ok(absolute(path)) } else { Err(OnnxError::Named(path)) };
    }
    let beside = std::env::current_exe().ok().and_then(|program| program.parent().map(Path::to_owned));
    let beside = beside.unwrap_or_default();
    if let Some(path) = in_folder(&beside) {
        return Ok(absolute(path));
    }
    match in_python() {
        Ok(path) => Ok(absolute(path)),
        Err(python) => Err(OnnxError::Missing { library: LIBRARY, beside, python }),
    }
}

fn absolute(path: PathBuf) -> PathBuf {
    std::path::absolute(&path).unwrap_or(path)
}

/// Returns true if a file of this name is the library.
fn is_library(name: &str) -> bool {
    if name == LIBRARY {
        return true;
    }
    if cfg!(windows) {
        false
    } else if cfg!(target_vendor = "apple") {
        name.starts_with("libonnxruntime.") && name.ends_with(".dylib")
    } else {
        name.strip_prefix(LIBRARY).is_some_and(|version| version.starts_with('.'))
    }
}

/// Returns the library in `folder`: of several the last in natural order, which is the newest.
fn in_folder(folder: &Path) -> Option<PathBuf> {
    let names = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.file_name());
    let mut names: Vec<OsString> = names.filter(|name| name.to_str().is_some_and(is_library)).collect();
    names.sort_by(|a, b| natural::compare(a.as_encoded_bytes(), b.as_encoded_bytes()));
    names.pop().map(|name| folder.join(name)).filter(|path| path.is_file())
}

/// Returns the library of an installed `onnxruntime` package, or the reason why there is none.
fn in_python() -> Result<PathBuf, String> {
    let mut interpreters = Vec::new();
    if let Some(environment) = std::env::var_os("VIRTUAL_ENV").filter(|value| !value.is_empty()) {
        let inside = if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" };
        interpreters.push(Path::new(&environment).join(inside));
    }
    interpreters.extend(["python3", "python"].map(PathBuf::from));
    let mut asked = None;
    for interpreter in interpreters {
        let answer =
            Command::new(&interpreter).args(["-I", "-c", ASK]).stdin(Stdio::null()).stderr(Stdio::null()).output();
        let Some(answer) = answer.ok().filter(|answer| answer.status.success()) else { continue };
        let folder = String::from_utf8_lossy(&answer.stdout).trim().to_owned();
        if let Some(path) = Some(&folder).filter(|f| !f.is_empty()).and_then(|f| in_folder(Path::new(f))) {
            return Ok(path);
        }
        asked.get_or_insert(interpreter);
    }
    Err(match asked {
        Some(interpreter) => format!("{} has no package onnxruntime", interpreter.display()),
        None => "there is no python3 to ask for its package onnxruntime".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_several_libraries_in_a_folder_the_newest_is_taken() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        assert_eq!(in_folder(folder.path()), None);
        let versioned = |version: &str| match LIBRARY {
            "libonnxruntime.dylib" => format!("libonnxruntime.{version}.dylib"),
            "onnxruntime.dll" => LIBRARY.to_owned(),
            other => format!("{other}.{version}"),
        };
        for name in [versioned("1.9.0"), versioned("1.31.1"), versioned("1.24.2"), "libonnxruntime_extra.so".into()] {
            std::fs::write(folder.path().join(name), b"").expect("writable");
        }
        assert_eq!(in_folder(folder.path()), Some(folder.path().join(versioned("1.31.1"))));
    }
}
