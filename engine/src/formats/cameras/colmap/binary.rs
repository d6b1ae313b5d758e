//! The binary form of a model: little-endian numbers; each list follows its length.

use std::collections::BTreeMap;

use super::rigs::{Frame, Rig, Rigs};
use super::{Extrinsics, Intrinsics, Rigid};
use crate::formats::FormatError;

/// Names and numbers of parameters of the camera models, by model number.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// Sensor type of cameras.
const CAMERA: u32 = 0;

/// The unread bytes of a file.
struct Bytes<'a> {
    part: &'static str,
    rest: &'a [u8],
}

impl<'a> Bytes<'a> {
    fn end(&self) -> FormatError {
        FormatError::new(self.part, "more bytes", "its end")
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], FormatError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or_else(|| self.end())?;
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32, FormatError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64, FormatError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64, FormatError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    fn rigid(&mut self) -> Result<Rigid, FormatError> {
        let mut numbers = [0.0; 7];
        for value in &mut numbers {
            *value = self.f64()?;
        }
        Ok(Rigid::new(numbers))
    }

    /// Reads a sensor; returns the number of a camera, `None` for another sensor.
    fn sensor(&mut self) -> Result<Option<u32>, FormatError> {
        let (kind, id) = (self.u32()?, self.u32()?);
        Ok((kind == CAMERA).then_some(id))
    }
}

// Counts are not trusted: each entry needs bytes that must be present.

pub(super) fn cameras(bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, FormatError> {
    let mut bytes = Bytes { part: "cameras.bin", rest: bytes };
    let mut cameras = BTreeMap::new();
    for _ in 0..bytes.u64()? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let known = usize::try_from(model).ok().and_then(|model| MODELS.get(model));
        let Some(&(model, count)) = known else {
            // The length of an unknown model is unknown, and so is the start of the next one.
            let expected = format!("camera models 0 to {}", MODELS.len() - 1);
            return Err(FormatError::new("cameras.bin", expected, model.to_string()));
        };
        let size = [bytes.u64()? as f64, bytes.u64()? as f64];
        let parameters: Result<Vec<f64>, FormatError> = (0..count).map(|_| bytes.f64()).collect();
        cameras.insert(id, Intrinsics { model: model.to_owned(), size, parameters: parameters? });
    }
    Ok(cameras)
}

pub(super) fn images(bytes: &[u8]) -> Result<Vec<Extrinsics>, FormatError> {
    let mut bytes = Bytes { part: "images.bin", rest: bytes };
    let mut images = Vec::new();
    for _ in 0..bytes.u64()? {
        let (id, pose, camera) = (bytes.u32()?, bytes.rigid()?, bytes.u32()?);
        let length = bytes.rest.iter().position(|byte| *byte == 0).ok_or_else(|| bytes.end())?;
        let name = String::from_utf8_lossy(bytes.take(length)?).into_owned();
        bytes.take(1)?;
        let points = bytes.u64()?;
        // Each point has two coordinates and a number.
        let skipped =
            usize::try_from(points).ok().and_then(|points| points.checked_mul(24)).ok_or_else(|| bytes.end())?;
        bytes.take(skipped)?;
        images.push(Extrinsics { id, name, pose, camera });
    }
    Ok(images)
}

pub(super) fn rigs([rigs, frames]: [&[u8]; 2]) -> Result<Rigs, FormatError> {
    let mut bytes = Bytes { part: "rigs.bin", rest: rigs };
    let mut all = BTreeMap::new();
    for _ in 0..bytes.u64()? {
        let (id, count) = (bytes.u32()?, bytes.u32()?);
        let mut rig = Rig::default();
        for i in 0..count {
            let sensor = bytes.sensor()?;
            if i == 0 {
                rig.reference = sensor;
                continue;
            }
            let [known] = bytes.array()?;
            let pose = if known == 0 { None } else { Some(bytes.rigid()?) };
            rig.others.extend(sensor.map(|camera| (camera, pose)));
        }
        all.insert(id, rig);
    }
    let mut bytes = Bytes { part: "frames.bin", rest: frames };
    let mut moments = Vec::new();
    for _ in 0..bytes.u64()? {
        let (_id, rig, pose, count) = (bytes.u32()?, bytes.u32()?, bytes.rigid()?, bytes.u32()?);
        let mut images = Vec::new();
        for _ in 0..count {
            let (sensor, image) = (bytes.sensor()?, bytes.u64()?);
            images.extend(sensor.map(|camera| (camera, image)));
        }
        moments.push(Frame { rig, pose, images });
    }
    Ok(Rigs::new(all, moments))
}
