//! Cameras that move around a scene's middle, and pairs of eyes, from their options.

use crate::render::turn::{Angles, Turn};

use crate::run::Error;
use crate::run::options::{Fill, Motion, Swing};
use crate::run::views::Views;

/// Seconds of a motion given without seconds.
const SECONDS: f64 = 4.0;
/// Widest circle, in degrees from its middle.
const WIDEST: f64 = 80.0;
/// Default distance between the eyes, as a part of their distance from the scene's middle.
const EYE_DISTANCE: f64 = 0.06;
/// Largest number of images of a motion.
const MOST: f64 = 1e6;

/// The camera's angles at each image.
#[derive(Clone, Debug, PartialEq)]
pub enum Course {
    /// One pair of angles per image, all at one instant of the scene.
    Held(Vec<Angles>),
    /// Angles by the time since the first image.
    Running(Turn),
}

/// A motion as given by the options, with seconds where they are given.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Asked {
    Orbit(f64, Option<f64>),
    Sway(f64, Option<f64>),
    Turntable(f64),
}

/// Seconds from the first image to the last, and the number of images.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Whole {
    span: f64,
    images: usize,
}

impl Asked {
    fn option(self) -> &'static str {
        match self {
            Asked::Orbit(..) => "--orbit",
            Asked::Sway(..) => "--sway",
            Asked::Turntable(_) => "--turntable",
        }
    }

    /// Angles of the images of a motion at one instant, `fps` of them a second.
    fn held(self, fps: f64) -> Result<Vec<Angles>, Error> {
        let (Asked::Orbit(_, seconds) | Asked::Sway(_, seconds)) = self else {
            let Asked::Turntable(seconds) = self else { return Ok(Vec::new()) };
            let count = self.count(seconds, fps)?;
            let right = |i: usize| 360.0 * i as f64 / count as f64;
            return Ok((0..count).map(|i| Angles { right: right(i), up: 0.0 }).collect());
        };
        let count = self.count(seconds.unwrap_or(SECONDS), fps)?;
        let last = count.saturating_sub(1).max(1) as f64;
        Ok((0..count)
            .map(|i| match self {
                Asked::Orbit(degrees, _) => Angles { right: degrees * (i as f64 / last - 0.5), up: 0.0 },
                Asked::Sway(degrees, _) => Turn::Sway { degrees, seconds: count as f64 }.at(i as f64),
                Asked::Turntable(_) => Angles::default(),
            })
            .collect())
    }

    fn count(self, seconds: f64, fps: f64) -> Result<usize, Error> {
        let count = (seconds * fps).round();
        if !(seconds > 0.0 && (1.0..=MOST).contains(&count)) {
            return Err(Error::usage(format!(
                "{}: expected at least one image and at most {MOST}, found {seconds} s at {fps} images per second",
                self.option()
            )));
        }
        Ok(count as usize)
    }

    /// The motion while time advances, over all images where their number is known.
    fn running(self, whole: Option<Whole>) -> Result<Turn, Error> {
        let (said, turn): (Option<f64>, &dyn Fn(f64) -> Turn) = match self {
            Asked::Orbit(degrees, seconds) => (seconds, &move |seconds| Turn::Orbit { degrees, seconds }),
            Asked::Sway(degrees, seconds) => (seconds, &move |seconds| Turn::Sway { degrees, seconds }),
            Asked::Turntable(seconds) => (Some(seconds), &move |seconds| Turn::Around { seconds }),
        };
        if let Some(seconds) = said {
            if !(seconds > 0.0 && seconds.is_finite()) {
                return Err(Error::usage(format!("{}: expected seconds above 0, found {seconds} s", self.option())));
            }
            return Ok(turn(seconds));
        }
        let seconds = match (self, whole) {
            (Asked::Orbit(..), Some(Whole { span, .. })) => span,
            (Asked::Sway(..), Some(Whole { span, images })) => {
                // The image after the last would be the first again.
                let all = span * images as f64 / images.saturating_sub(1).max(1) as f64;
                all / (all / SECONDS).round().max(1.0)
            }
            _ => SECONDS,
        };
        Ok(turn(if seconds > 0.0 { seconds } else { SECONDS }))
    }
}

impl Motion {
    /// Degrees of the circle for `--sway` without a value.
    pub const SWAY: &str = "4";

    fn asked(&self) -> Result<Option<Asked>, Error> {
        if let Some(Swing { degrees, seconds }) = self.orbit {
            return Ok(Some(Asked::Orbit(degrees, seconds)));
        }
        if let Some(swing @ Swing { degrees, seconds }) = self.sway {
            if !(degrees > 0.0 && degrees <= WIDEST) {
                return Err(Error::usage(format!("--sway {swing}: expected more than 0 and at most {WIDEST} degrees")));
            }
            return Ok(Some(Asked::Sway(degrees, seconds)));
        }
        Ok(self.turntable.map(Asked::Turntable))
    }

    /// Returns true if the camera moves.
    pub fn moves(&self) -> bool {
        self.orbit.is_some() || self.sway.is_some() || self.turntable.is_some()
    }

    /// Returns true if the motion is a loop: the last image leads into the first.
    pub fn closes(&self) -> bool {
        self.sway.is_some() || self.turntable.is_some()
    }

    /// The camera's angles around a static scene, `fps` of them a second; `None` where it does not move.
    pub fn held(&self, fps: f64) -> Result<Option<Vec<Angles>>, Error> {
        self.asked()?.map(|asked| asked.held(fps)).transpose()
    }

    /// Distance between the eyes; `None` for a single view.
    pub fn eyes(&self) -> Result<Option<f64>, Error> {
        let distance = self.eye_distance.unwrap_or(EYE_DISTANCE);
        if !(distance > 0.0 && distance <= 1.0) {
            return Err(Error::usage(format!(
                "--eye-distance {distance}: expected more than 0 and at most 1, as a part of the distance from the scene's middle"
            )));
        }
        Ok(self.stereo.then_some(distance))
    }

    /// Sets the motion of `views` for images at the times of `due`. A single time in `due` is repeated for all images
    /// of the motion.
    pub fn along<T: Copy>(
        &self,
        views: &mut Views,
        due: &mut Vec<T>,
        time: impl Fn(T) -> f64,
        fps: f64,
    ) -> Result<(), Error> {
        views.refuse_cameras()?;
        views.eyes = self.eyes()?;
        views.fill = self.filling()?;
        views.course = match (self.asked()?, &due[..]) {
            (None, _) => None,
            (Some(asked), &[only]) => {
                let angles = asked.held(fps)?;
                *due = vec![only; angles.len()];
                Some(Course::Held(angles))
            }
            (Some(asked), due) => {
                let span = due.first().zip(due.last()).map(|(first, last)| time(*last) - time(*first));
                Some(Course::Running(asked.running(span.map(|span| Whole { span, images: due.len() }))?))
            }
        };
        Ok(())
    }

    /// The filling of parts that were never filmed; without a motion, the background.
    fn filling(&self) -> Result<Fill, Error> {
        match self.fill {
            Some(fill) if !self.moves() => Err(Error::usage(format!(
                "--fill {fill}: expected --orbit, --sway or --turntable of a scene in time as well"
            ))),
            fill => Ok(if self.moves() { fill.unwrap_or_default() } else { Fill::None }),
        }
    }

    /// Sets the motion of `views` for a video of `fps` frames a second whose end is unknown.
    pub fn follow(&self, views: &mut Views, fps: f64) -> Result<(), Error> {
        if self.fill == Some(Fill::Crop) {
            return Err(Error::usage(
                "--fill crop: expected extend or none, as images are drawn as they come; render has it",
            ));
        }
        if let Some(mut times) = views.times.take() {
            self.along(views, &mut times, |time| time, fps)?;
            views.times = Some(times);
            return Ok(());
        }
        views.eyes = self.eyes()?;
        views.fill = self.filling()?;
        views.course = self.asked()?.map(|asked| asked.running(None)).transpose()?.map(Course::Running);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sway(text: &str) -> Motion {
        Motion { sway: Some(text.parse().expect("an angle")), ..Motion::default() }
    }

    #[test]
    fn one_instant_is_held_and_many_run_on() {
        let mut views = Views::own();
        let mut due = vec![1.5];
        sway("3:2").along(&mut views, &mut due, |time| time, 4.0).expect("valid");
        assert_eq!(due, [1.5; 8]);
        assert!(matches!(&views.course, Some(Course::Held(angles)) if angles.len() == 8));
        let mut due = vec![1.0, 1.5, 2.0];
        sway("3:2").along(&mut views, &mut due, |time| time, 4.0).expect("valid");
        assert_eq!(due, [1.0, 1.5, 2.0]);
        assert_eq!(views.course, Some(Course::Running(Turn::Sway { degrees: 3.0, seconds: 2.0 })));
    }

    #[test]
    fn without_seconds_an_orbit_takes_all_the_time_and_circles_close() {
        let course = |motion: &Motion, images: usize| {
            let (mut views, mut due) = (Views::own(), (0..images).map(|i| i as f64 / 8.0).collect());
            motion.along(&mut views, &mut due, |time| time, 8.0).expect("valid");
            views.course
        };
        let orbit = Motion { orbit: Some("20".parse().expect("an angle")), ..Motion::default() };
        assert_eq!(course(&orbit, 81), Some(Course::Running(Turn::Orbit { degrees: 20.0, seconds: 10.0 })));
        // 80 images of an eighth of a second: ten seconds. Two or three circles come nearest to 4 seconds each.
        let Some(Course::Running(Turn::Sway { seconds, .. })) = course(&sway("4"), 80) else { panic!("a circle") };
        assert!((seconds - 10.0 / 3.0).abs() < 1e-9, "{seconds}");
        let Some(Course::Running(Turn::Sway { seconds, .. })) = course(&sway("4"), 8) else { panic!("a circle") };
        assert!((seconds - 1.0).abs() < 1e-9, "{seconds}");
    }

    #[test]
    fn a_video_without_an_end_has_four_seconds() {
        let mut views = Views::own();
        sway("4").follow(&mut views, 24.0).expect("valid");
        assert_eq!(views.course, Some(Course::Running(Turn::Sway { degrees: 4.0, seconds: 4.0 })));
        assert_eq!(views.times, None);
        views.times = Some(vec![0.5]);
        sway("4:0.5").follow(&mut views, 24.0).expect("valid");
        assert_eq!(views.times, Some(vec![0.5; 12]));
    }

    #[test]
    fn what_is_no_motion_is_wrong_use() {
        let mut views = Views::own();
        for text in ["", "a", "4:", "4:x", "nan", "4:inf"] {
            assert!(text.parse::<Swing>().is_err(), "{text}");
        }
        for text in ["0", "-3", "81", "4:0", "4:-1"] {
            assert!(matches!(sway(text).follow(&mut views, 24.0), Err(Error::Usage(_))), "{text}");
        }
        for distance in [0.0, -1.0, 1.5, f64::NAN] {
            let motion = Motion { stereo: true, eye_distance: Some(distance), ..Motion::default() };
            assert!(matches!(motion.follow(&mut views, 24.0), Err(Error::Usage(_))), "{distance}");
        }
    }
}
