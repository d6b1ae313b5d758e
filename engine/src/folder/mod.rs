//! Files of a folder by the endings of their names, in natural order.

pub mod natural;

use std::io;
use std::path::{Path, PathBuf};

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
/// A folder that cannot be read, and a link of such a name that leads nowhere.
pub(crate) fn list(folder: &Path, extensions: &[&str]) -> io::Result<Vec<PathBuf>> {
    files(folder, |path| ends_in(path, extensions))
}

/// Lists the files of `folder` that are no images, in natural order; hidden ones and subfolders are left out.
///
/// # Errors
/// A folder that cannot be read.
pub(crate) fn others(folder: &Path) -> io::Result<Vec<PathBuf>> {
    files(folder, |path| !is_image(path) && path.is_file())
}

fn files(folder: &Path, wanted: impl Fn(&Path) -> bool) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let (path, name) = (entry.path(), entry.file_name());
        if name.as_encoded_bytes().starts_with(b".") || !wanted(&path) {
            continue;
        }
        let found = path.metadata().map_err(|e| io::Error::new(e.kind(), format!("{}: {e}", name.display())))?;
        if found.is_file() {
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
/// A folder that cannot be read.
pub fn images(folder: &Path) -> io::Result<Vec<PathBuf>> {
    list(folder, &EXTENSIONS)
}

/// Returns true if a folder has an image, or cannot be read.
pub fn has_images(folder: &Path) -> bool {
    !images(folder).is_ok_and(|files| files.is_empty())
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
        assert_eq!(
            others(folder.path()).expect("two others"),
            ["notes.txt", "png"].map(|name| folder.path().join(name))
        );
    }
}
