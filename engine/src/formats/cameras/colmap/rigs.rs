//! Poses that several cameras of a rig share.

use std::collections::BTreeMap;

use super::Rigid;
use crate::camera::Rotation;

/// A rig: its cameras by number. Other sensors are left out.
#[derive(Debug, Default)]
pub(super) struct Rig {
    /// The camera whose coordinates are the rig's.
    pub(super) reference: Option<u32>,
    /// The other cameras; `None` for an unknown pose in the rig.
    pub(super) others: BTreeMap<u32, Option<Rigid>>,
}

/// A moment at which a rig's cameras took images.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) rig: u32,
    pub(super) pose: Rigid,
    /// Camera and image.
    pub(super) images: Vec<(u32, u64)>,
}

/// All rigs, and the camera and frame of each image.
#[derive(Debug)]
pub(super) struct Rigs {
    rigs: BTreeMap<u32, Rig>,
    images: BTreeMap<u64, (u32, u32, Rigid)>,
    frames: usize,
}

impl Rigs {
    pub(super) fn new(rigs: BTreeMap<u32, Rig>, frames: Vec<Frame>) -> Self {
        let count = frames.len();
        let mut images = BTreeMap::new();
        for Frame { rig, pose, images: own } in frames {
            images.extend(own.into_iter().map(|(camera, image)| (image, (camera, rig, pose))));
        }
        Self { rigs, images, frames: count }
    }

    /// Returns true if the images' own poses are used.
    pub(super) fn is_empty(&self) -> bool {
        self.frames == 0
    }

    /// Returns the transformation from the world to an image's camera; or expected and found values.
    pub(super) fn pose(&self, image: u32, camera: u32) -> Result<Rigid, [String; 2]> {
        let Some(&(sensor, number, pose)) = self.images.get(&u64::from(image)) else {
            return Err([format!("image {image} in a frame of the file frames"), "none".to_owned()]);
        };
        if sensor != camera {
            return Err([format!("camera {camera} in its frame"), format!("camera {sensor}")]);
        }
        let Some(rig) = self.rigs.get(&number) else {
            return Err([format!("rig {number} in the file rigs"), "none".to_owned()]);
        };
        if rig.reference == Some(camera) {
            return Ok(pose);
        }
        match rig.others.get(&camera) {
            Some(Some(own)) => after(own, &pose)
                .ok_or_else(|| ["quaternions other than zero in its rig and its frame".to_owned(), "zeros".to_owned()]),
            Some(None) => Err([format!("the pose of camera {camera} in rig {number}"), "none".to_owned()]),
            None => Err([format!("camera {camera} in rig {number}"), "none".to_owned()]),
        }
    }
}

/// Returns the composition: `b` first, then `a`.
fn after(a: &Rigid, b: &Rigid) -> Option<Rigid> {
    let [p, q] = [Rotation::from_quaternion(a.quaternion)?, Rotation::from_quaternion(b.quaternion)?];
    let turned = p.matrix().map(|row| {
        let [x, y, z] = b.translation;
        row[0] * x + row[1] * y + row[2] * z
    });
    let translation = std::array::from_fn(|i| turned[i] + a.translation[i]);
    let ([aw, ax, ay, az], [bw, bx, by, bz]) = (p.quaternion(), q.quaternion());
    let quaternion = [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ];
    Some(Rigid { quaternion, translation })
}
