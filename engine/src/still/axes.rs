//! Directions of coordinate axes.

use std::fmt;
use std::str::FromStr;

use super::{Similarity, Still};
use crate::camera::Rotation;

/// Directions in which x, y and z grow, as three letters: R(ight) or L(eft), D(own) or U(p), F(ront) or B(ack). Those
/// of scene space are RDF. In eight of the sixteen, y is the depth, as in LFD.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Axes {
    /// True for x to the right, the vertical axis down, the depth to the front.
    along: [bool; 3],
    /// True if y is the depth and z vertical.
    upright: bool,
}

/// Letters of scene space's directions, and of the opposite ones.
const LETTERS: [[char; 2]; 3] = [['R', 'L'], ['D', 'U'], ['F', 'B']];

/// Which of the axes x, y, z each coefficient above the harmonics' first is odd in.
const ODD: [[bool; 3]; 15] = {
    const X: [bool; 3] = [true, false, false];
    const Y: [bool; 3] = [false, true, false];
    const Z: [bool; 3] = [false, false, true];
    const EVEN: [bool; 3] = [false; 3];
    [
        Y,
        Z,
        X,
        [true, true, false],
        [false, true, true],
        EVEN,
        [true, false, true],
        EVEN,
        Y,
        [true, true, true],
        Y,
        Z,
        X,
        Z,
        X,
    ]
};

impl Axes {
    /// Axes of scene space, of COLMAP and of PLY files: right, down, front.
    pub const RDF: Axes = Axes { along: [true, true, true], upright: false };
    /// Axes of OpenGL, and of SPZ's description: right, up, back.
    pub const RUB: Axes = Axes { along: [true, false, false], upright: false };
    /// Axes of glTF: left, up, front.
    pub const LUF: Axes = Axes { along: [false, false, true], upright: false };

    /// All sixteen, in the order of SPZ's numbers from 1.
    pub fn all() -> impl Iterator<Item = Axes> {
        (0..16_u32).map(|code| {
            let bit = |k: u32| code >> k & 1 == 1;
            // x changes fastest. From 9 on, the order starts with the depth at the front and the vertical axis down.
            let along = if code < 8 { [bit(0), !bit(1), bit(2)] } else { [bit(0), !bit(1), !bit(2)] };
            Axes { along, upright: code >= 8 }
        })
    }

    /// Axes of an SPZ code.
    pub fn of_code(code: u32) -> Option<Axes> {
        Axes::all().nth(code.checked_sub(1)? as usize)
    }

    /// SPZ code of these axes.
    pub fn code(self) -> u32 {
        Axes::all().position(|axes| axes == self).map_or(0, |place| place as u32 + 1)
    }

    /// Signs that convert numbers to scene space, after the quarter turn if there is one.
    fn signs(self) -> [f32; 3] {
        let [x, y, z] = self.along.map(|along| if along { 1.0 } else { -1.0 });
        if self.upright { [x, -y, z] } else { [x, y, z] }
    }
}

impl Default for Axes {
    fn default() -> Self {
        Axes::RDF
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let letter = |k: usize| LETTERS[k][usize::from(!self.along[k])];
        let order = if self.upright { [0, 2, 1] } else { [0, 1, 2] };
        order.into_iter().try_for_each(|k| write!(f, "{}", letter(k)))
    }
}

impl fmt::Debug for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

impl FromStr for Axes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wanted = text.to_ascii_uppercase();
        Axes::all().find(|axes| axes.to_string() == wanted).ok_or_else(|| {
            let names: Vec<String> = Axes::all().map(|axes| axes.to_string()).collect();
            format!("expected {}, found {text:?}", names.join(", "))
        })
    }
}

impl Still {
    /// Interprets the file's numbers by other axes than those assumed so far.
    pub fn taken_along(&mut self, axes: Axes) {
        let before = std::mem::replace(&mut self.about.axes, axes);
        self.about.axes_assumed = false;
        if before.upright == axes.upright {
            let signs = std::array::from_fn(|k| before.signs()[k] * axes.signs()[k]);
            self.mirror(signs);
        } else {
            self.mirror(before.signs());
            if before.upright {
                self.transform(&quarter_turn(-1.0));
            } else {
                self.transform(&quarter_turn(1.0));
            }
            self.mirror(axes.signs());
        }
    }

    /// Converts numbers along these axes to scene space.
    pub(crate) fn bring_from(&mut self, axes: Axes) {
        self.about.axes = Axes::RDF;
        self.taken_along(axes);
    }

    /// Converts numbers of scene space to other axes.
    pub(crate) fn bring_to(&mut self, axes: Axes) {
        self.about.axes = axes;
        self.taken_along(Axes::RDF);
    }

    /// Multiplies coordinates by signs, and adapts rotations and harmonics. Exact.
    fn mirror(&mut self, signs: [f32; 3]) {
        if signs == [1.0; 3] {
            return;
        }
        let [x, y, z] = signs;
        self.mean.iter_mut().for_each(|m| *m = [m[0] * x, m[1] * y, m[2] * z]);
        (0..3).for_each(|k| self.about.offset[k] *= f64::from(signs[k]));
        // S·R·S: the Gaussian's own axes are mirrored as well.
        self.rotation.iter_mut().for_each(|q| *q = [q[0], q[1] * (y * z), q[2] * (x * z), q[3] * (x * y)]);
        let rest = self.rest();
        if rest > 0 {
            let sign = |odd: [bool; 3]| (0..3).filter(|k| odd[*k]).map(|k| signs[k]).product::<f32>();
            let signs: Vec<f32> = ODD[..rest].iter().map(|odd| sign(*odd)).collect();
            for own in self.higher.chunks_exact_mut(3 * rest) {
                own.chunks_exact_mut(3).zip(&signs).for_each(|(c, sign)| c.iter_mut().for_each(|c| *c *= sign));
            }
        }
    }
}

/// (x, y, z) to (x, −z, y); the inverse with −1.
fn quarter_turn(sign: f64) -> Similarity {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = Rotation::from_quaternion([half, sign * half, 0.0, 0.0]).unwrap_or_default();
    Similarity { scale: 1.0, rotation, offset: [0.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_are_those_of_spz() {
        let names: Vec<String> = Axes::all().map(|axes| axes.to_string()).collect();
        let expected = "LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU";
        assert_eq!(names.join(" "), expected);
        for (code, name) in (1..).zip(&names) {
            let axes: Axes = name.to_lowercase().parse().expect(name);
            assert_eq!((axes.code(), Axes::of_code(code)), (code, Some(axes)));
        }
        assert_eq!((Axes::of_code(0), Axes::of_code(17)), (None, None));
        assert_eq!([Axes::RDF, Axes::RUB, Axes::LUF].map(Axes::code), [6, 4, 7]);
        let error = "rdd".parse::<Axes>().expect_err("no axes");
        assert!(error.starts_with("expected LDB, RDB") && error.ends_with("found \"rdd\""), "{error}");
    }

    fn still() -> Still {
        let value = |i: usize| ((i * 37) % 101) as f32 * 0.02 - 1.0;
        let mut still = Still::zeros(2, 3);
        (still.mean, still.base) = (vec![[1.0, 2.0, 3.0], [-0.5, 0.25, 4.0]], vec![[1.0; 3]; 2]);
        still.rotation = vec![[0.5, 0.5, -0.5, 0.5], [0.1, 0.2, -0.3, 0.4]];
        still.log_scale = vec![[-1.0, -2.0, -3.0]; 2];
        still.higher = (0..90).map(|i| 0.1 * value(i)).collect();
        still
    }

    #[test]
    fn a_half_turn_by_signs_is_the_half_turn_and_all_axes_go_back() {
        for (axes, axis) in [(Axes::RUB, 1), (Axes::LUF, 3)] {
            let (mut mirrored, mut turned) = (still(), still());
            mirrored.bring_from(axes);
            let rotation = Rotation::from_quaternion(std::array::from_fn(|i| f64::from(u8::from(i == axis))));
            turned.transform(&Similarity { scale: 1.0, rotation: rotation.expect("a turn"), offset: [0.0; 3] });
            assert_eq!((&mirrored.mean, &mirrored.higher), (&turned.mean, &turned.higher), "{axes}");
        }
        for axes in Axes::all() {
            let mut found = still();
            found.bring_from(axes);
            assert_eq!(found.about.axes, axes);
            found.taken_along(Axes::RDF);
            let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(near(found.mean.as_flattened(), still().mean.as_flattened()), "{axes}");
            assert!(near(&found.higher, &still().higher), "{axes}");
        }
    }

    #[test]
    fn letters_say_where_each_axis_points() {
        // Each axis of unit length, seen in scene space: x right, y down, z front.
        let direction = |letter: char| match letter {
            'R' => [1.0, 0.0, 0.0],
            'L' => [-1.0, 0.0, 0.0],
            'D' => [0.0, 1.0, 0.0],
            'U' => [0.0, -1.0, 0.0],
            'F' => [0.0, 0.0, 1.0],
            _ => [0.0_f32, 0.0, -1.0],
        };
        for axes in Axes::all() {
            for (k, letter) in axes.to_string().chars().enumerate() {
                let mut still = Still::zeros(1, 0);
                still.mean[0][k] = 1.0;
                still.bring_from(axes);
                let expected = direction(letter);
                assert!((0..3).all(|i| (still.mean[0][i] - expected[i]).abs() < 1e-6), "{axes} {letter}");
            }
        }
    }
}
