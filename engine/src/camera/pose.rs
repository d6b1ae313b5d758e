//! Rigid poses in scene space.

/// Maximum deviation of a rotation's rows from orthonormal ones.
const ORTHONORMAL: f64 = 1e-3;

/// A rotation as a unit quaternion (w, x, y, z). Always normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation([f64; 4]);

impl Default for Rotation {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Rotation {
    /// No rotation.
    pub const IDENTITY: Rotation = Rotation([1.0, 0.0, 0.0, 0.0]);

    /// Returns the rotation of a quaternion (w, x, y, z) of any length; `None` if it is zero or not finite.
    pub fn from_quaternion(q: [f64; 4]) -> Option<Self> {
        let largest = q.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
        if !(q.iter().all(|c| c.is_finite()) && largest > 0.0) {
            return None;
        }
        // Scaled first, so that no square overflows or vanishes.
        let scaled = q.map(|c| c / largest);
        let norm = scaled.iter().map(|c| c * c).sum::<f64>().sqrt();
        Some(Self(scaled.map(|c| c / norm)))
    }

    /// The rotation whose matrix has these columns; `None` unless they are orthonormal and right-handed.
    pub fn from_columns([x, y, z]: [[f64; 3]; 3]) -> Option<Self> {
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let cross = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
        let products =
            [dot(x, x) - 1.0, dot(y, y) - 1.0, dot(z, z) - 1.0, dot(x, y), dot(x, z), dot(y, z), dot(cross, z) - 1.0];
        if !products.iter().all(|p| p.abs() < ORTHONORMAL) {
            return None;
        }
        // Four times each squared component of the quaternion. The largest component is computed by the root, the rest
        // by division.
        let squares =
            [1.0 + x[0] + y[1] + z[2], 1.0 + x[0] - y[1] - z[2], 1.0 - x[0] + y[1] - z[2], 1.0 - x[0] - y[1] + z[2]];
        let largest = (1..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
        let s = squares[largest];
        Self::from_quaternion(match largest {
            0 => [s, y[2] - z[1], z[0] - x[2], x[1] - y[0]],
            1 => [y[2] - z[1], s, x[1] + y[0], z[0] + x[2]],
            2 => [z[0] - x[2], x[1] + y[0], s, y[2] + z[1]],
            _ => [x[1] - y[0], z[0] + x[2], y[2] + z[1], s],
        })
    }

    /// Returns the quaternion (w, x, y, z), of length 1.
    pub fn quaternion(&self) -> [f64; 4] {
        self.0
    }

    /// Returns the opposite rotation.
    pub fn inverse(&self) -> Self {
        let [w, x, y, z] = self.0;
        Self([w, -x, -y, -z])
    }

    /// Returns true if this is the identity rotation.
    pub fn is_identity(&self) -> bool {
        self.0[1..] == [0.0; 3]
    }

    /// Returns the rotation's matrix, row by row.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        let [w, x, y, z] = self.0;
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// Interpolates between this rotation (`t` = 0) and another (`t` = 1) on the shorter way: normalised linear
    /// interpolation.
    pub fn towards(&self, other: &Self, t: f64) -> Self {
        let dot: f64 = self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum();
        let sign = if dot < 0.0 { -1.0 } else { 1.0 };
        let mixed = std::array::from_fn(|i| self.0[i] * (1.0 - t) + sign * other.0[i] * t);
        // The sum vanishes only for opposite quaternions. They are the same rotation, and the choice of sign avoids the
        // case.
        Self::from_quaternion(mixed).unwrap_or(*self)
    }
}

/// A camera's position and orientation in scene space (x right, y down, z forward).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// The camera's centre.
    pub position: [f64; 3],
    /// The rotation from the camera's axes (right, down, forward) to scene space.
    pub rotation: Rotation,
}

impl Pose {
    /// Returns a camera at `eye` that looks at `target`, with `up` upwards in its image (scene space: up is −y). `None`
    /// if the two points coincide, `up` is parallel to the view, or a number is not finite.
    pub fn look_at(eye: [f64; 3], target: [f64; 3], up: [f64; 3]) -> Option<Self> {
        let forward = unit(std::array::from_fn(|i| target[i] - eye[i]))?;
        let right = unit(cross(forward, up))?;
        let down = cross(forward, right);
        Some(Self { position: eye, rotation: Rotation::from_columns([right, down, forward])? })
    }

    /// Interpolates between this pose (`t` = 0) and another (`t` = 1).
    pub fn towards(&self, other: &Self, t: f64) -> Self {
        Self {
            position: std::array::from_fn(|i| self.position[i] * (1.0 - t) + other.position[i] * t),
            rotation: self.rotation.towards(&other.rotation, t),
        }
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let largest = v.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
    if !(v.iter().all(|c| c.is_finite()) && largest > 0.0) {
        return None;
    }
    let scaled = v.map(|c| c / largest);
    let norm = scaled.iter().map(|c| c * c).sum::<f64>().sqrt();
    Some(scaled.map(|c| c / norm))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apply(rotation: &Rotation, v: [f64; 3]) -> [f64; 3] {
        rotation.matrix().map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    fn close(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn looking_forward_with_up_against_y_is_the_canonical_orientation() {
        let pose = Pose::look_at([0.0; 3], [0.0, 0.0, 2.0], [0.0, -1.0, 0.0]).unwrap();
        assert_eq!(pose.rotation, Rotation::IDENTITY);
        assert!(pose.rotation.is_identity());
    }

    #[test]
    fn a_camera_looks_where_it_is_told_to() {
        for target in [[1.0, 2.0, 3.0], [-4.0, 0.1, -2.0], [0.0, 0.3, -1.0], [5.0, -1.0, 0.0], [1e-200, 0.0, 1e-200]] {
            let pose = Pose::look_at([0.0; 3], target, [0.0, -1.0, 0.0]).unwrap();
            let forward = apply(&pose.rotation, [0.0, 0.0, 1.0]);
            assert!(close(forward, unit(target).unwrap()), "{target:?}: {forward:?}");
            let down = apply(&pose.rotation, [0.0, 1.0, 0.0]);
            assert!(down[1] > 0.0, "down stays down: {down:?}");
            let back = apply(&pose.rotation.inverse(), forward);
            assert!(close(back, [0.0, 0.0, 1.0]));
        }
    }

    #[test]
    fn impossible_poses_are_refused() {
        assert!(Pose::look_at([1.0; 3], [1.0; 3], [0.0, -1.0, 0.0]).is_none());
        assert!(Pose::look_at([0.0; 3], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]).is_none());
        assert!(Pose::look_at([f64::NAN, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]).is_none());
        assert!(Rotation::from_quaternion([0.0; 4]).is_none());
        assert!(Rotation::from_quaternion([f64::INFINITY, 0.0, 0.0, 0.0]).is_none());
        assert_eq!(Rotation::from_quaternion([1e-300, 0.0, 0.0, 0.0]), Some(Rotation::IDENTITY));
    }

    #[test]
    fn interpolation_takes_the_shorter_way_and_keeps_its_ends() {
        let a = Rotation::from_quaternion([1.0, 0.2, -0.4, 0.1]).unwrap();
        let b = Rotation::from_quaternion([-0.9, -0.1, 0.5, 0.3]).unwrap();
        let same = |p: &Rotation, q: &Rotation| {
            let dot: f64 = p.quaternion().iter().zip(&q.quaternion()).map(|(a, b)| a * b).sum();
            (dot.abs() - 1.0).abs() < 1e-12
        };
        assert!(same(&a.towards(&b, 0.0), &a));
        assert!(same(&a.towards(&b, 1.0), &b));
        let negated = Rotation::from_quaternion(a.quaternion().map(|c| -c)).unwrap();
        assert!(same(&a.towards(&negated, 0.5), &a));
    }
}
