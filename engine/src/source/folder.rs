//! The images of a folder, in natural order.

use std::path::{Path, PathBuf};

use super::{SourceError, natural};

/// File name endings of images, in any letter case.
pub const EXTENSIONS: [&str; 14] =
    ["png", "apng", "jpg", "jpeg", "jfif", "bmp", "tif", "tiff", "webp", "exr", "ppm", "pgm", "tga", "qoi"];

/// Returns true if the name ends like an image's.
pub fn is_image(path: &Path) -> bool {
    ends_in(path, &EXTENSIONS)
}

/// Returns true if the name ends in one of `extensions` (lower case, without the dot).
pub(crate) fn ends_in(path: &Path, extensions: &[&str]) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| extensions.contains(&e.to_ascii_lowercase().as_str()))
}

/// Lists the files of `folder` whose names end in one of `extensions`, in natural order. Hidden files, subfolders and
/// other files are left out.
///
/// # Errors
/// A folder that cannot be read.
pub(crate) fn list(folder: &Path, extensions: &[&str]) -> Result<Vec<PathBuf>, SourceError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(SourceError::read(folder))? {
        let entry = entry.map_err(SourceError::read(folder))?;
        let path = entry.path();
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        if !hidden && ends_in(&path, extensions) && path.is_file() {
            files.push(path);
        }
    }
    let name = |path: &PathBuf| path.file_name().map(|n| n.as_encoded_bytes().to_vec()).unwrap_or_default();
    files.sort_by(|a, b| natural::compare(&name(a), &name(b)));
    Ok(files)
}

/// Lists the images of `folder` in natural order.
///
/// # Errors
/// A folder that cannot be read or has no image.
pub fn images(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let files = list(folder, &EXTENSIONS)?;
    if files.is_empty() {
        return Err(SourceError::EmptyFolder { path: folder.to_owned() });
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_and_other_files_are_left_out_and_the_rest_is_in_natural_order() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for name in ["f10.png", "f9.PNG", ".f1.png", "notes.txt", "f011.jpg", "png"] {
            std::fs::write(folder.path().join(name), b"x").expect("writable");
        }
        std::fs::create_dir(folder.path().join("f1.png")).expect("writable");
        let names: Vec<_> = images(folder.path())
            .expect("three images")
            .iter()
            .map(|p| p.file_name().and_then(|n| n.to_str()).expect("UTF-8").to_owned())
            .collect();
        assert_eq!(names, ["f9.PNG", "f10.png", "f011.jpg"]);
    }

    #[test]
    fn an_empty_folder_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let error = images(folder.path()).expect_err("empty").to_string();
        assert!(error.contains(&folder.path().display().to_string()) && error.contains("png"), "{error}");
    }
}
