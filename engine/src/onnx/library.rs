//! Checks of a shared library before it is used.
//!
//! The loader of the `ort` crate trusts the library's entry point: another file of that name would end the process. So
//! this module checks the library first.
#![expect(unsafe_code, reason = "a foreign library is opened and its entry point called")]

use std::ffi::CStr;
use std::fs::File;
use std::path::Path;

use libloading::Library;
use ort::sys::{ORT_API_VERSION, OrtApiBase};

use super::{OLDEST, OnnxError, elf};

/// The entry point of ONNX Runtime (`onnxruntime_c_api.h`).
type GetApiBase = unsafe extern "C" fn() -> *const OrtApiBase;

/// Returns the version of the library at `path`, which is loaded for the check only.
///
/// # Errors
/// Files that cannot be loaded or are not ONNX Runtime; versions before [`OLDEST`].
pub(super) fn version(path: &Path) -> Result<String, OnnxError> {
    let broken = |cause: String| OnnxError::Broken { path: path.to_owned(), cause };
    whole(path).map_err(broken)?;
    // SAFETY: loading runs the library's initialisers. The user has named or installed the file as ONNX Runtime, whose
    // initialisers have no conditions.
    let library = unsafe { Library::new(path) }.map_err(|e| broken(reason(&e)))?;
    // SAFETY: `OrtGetApiBase` has this signature in every version of ONNX Runtime.
    let entry = unsafe { library.get::<GetApiBase>(b"OrtGetApiBase\0") };
    let entry = entry.map_err(|_| broken("it does not export OrtGetApiBase".to_owned()))?;
    // SAFETY: the function takes no arguments and returns a pointer to a constant, or null.
    let base = unsafe { entry().as_ref() }.ok_or_else(|| broken("OrtGetApiBase gives nothing".to_owned()))?;
    // SAFETY: a member of the constant above; it takes no arguments and returns a constant string, or null.
    let text = unsafe { (base.GetVersionString)() };
    if text.is_null() {
        return Err(broken("it tells no version".to_owned()));
    }
    // SAFETY: not null; a string that ends in a zero byte and lives as long as the library is loaded, which it is.
    let found = unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned();
    match numbers(&found) {
        None => return Err(broken(format!("its version is {found:?}"))),
        Some(version) if version < OLDEST => return Err(OnnxError::TooOld { path: path.to_owned(), found }),
        Some(_) => {}
    }
    // SAFETY: a member of the constant above; for an unsupported version it returns null.
    if unsafe { (base.GetApi)(ORT_API_VERSION) }.is_null() {
        return Err(broken(format!("it calls itself {found} and has no interface of version {ORT_API_VERSION}")));
    }
    Ok(found)
}

/// Returns an error if the file cannot be read or is shorter than its header declares.
fn whole(path: &Path) -> Result<(), String> {
    let mut file = File::open(path).map_err(|e| e.to_string())?;
    let found = file.metadata().map_err(|e| e.to_string())?.len();
    match elf::announced_length(&mut file) {
        Ok(Some(expected)) if found < expected => Err(format!("it ends after {found} of {expected} bytes")),
        Ok(_) => Ok(()),
        Err(e) => Err(format!("it ends within its header or cannot be read: {e}")),
    }
}

/// Returns the loader's message, from the error's source.
fn reason(error: &libloading::Error) -> String {
    std::error::Error::source(error).map_or_else(|| error.to_string(), |source| source.to_string())
}

/// Returns major and minor number of a version.
fn numbers(version: &str) -> Option<(u32, u32)> {
    let mut parts = version.split('.');
    Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_as_numbers() {
        assert!(numbers("1.9.0").expect("a version") < OLDEST && numbers("1.31.1").expect("a version") > OLDEST);
        assert_eq!(numbers("1.24.0-dev"), Some((1, 24)));
        assert_eq!([numbers(""), numbers("1"), numbers("one.two")], [None; 3]);
    }

    #[test]
    fn a_file_that_is_no_library_is_broken() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("libonnxruntime.so");
        std::fs::write(&path, b"no library").expect("writable");
        let error = version(&path).expect_err("not a library").to_string();
        assert!(error.contains("libonnxruntime.so: expected ONNX Runtime's shared library"), "{error}");
        assert!(matches!(version(&folder.path().join("absent.so")), Err(OnnxError::Broken { .. })));
    }
}
