//! Exposure and footprints of images, from their options.

use clap::Args;
use serde::{Deserialize, Serialize};
use streamsplat::camera::{Camera, CameraPath, Lens};
use streamsplat::render::{Aperture, Backend, Falloff, Focus, SENSOR_HEIGHT};
use streamsplat::run::views::{Shutter, Views};

use crate::console::failure::Failure;

/// Default number of images of a shutter.
const SAMPLES: u32 = 16;
/// Maximum number of images of a shutter.
const MOST_SAMPLES: i64 = 1024;
/// A full turn of the shutter, in degrees.
const TURN: f64 = 360.0;

/// Footprints, lens and shutter.
#[derive(Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Optics {
    /// Footprints: gaussian, splat-transform (0 from three standard deviations on) or playcanvas (0 from √8 on), as
    /// those programs draw [default: gaussian]
    #[arg(long, value_name = "NAME")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub footprint: Option<String>,
    /// All directions around the camera, instead of its lens: longitudes across the image, latitudes down [default:
    /// from the middle of a still scene, 2048x1024]
    #[arg(long, conflicts_with = "stereo")]
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub panorama: bool,
    /// Depth of field of a pinhole camera: the focal length over the diameter of the lens
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_stop: Option<f64>,
    /// Distance of the plane in focus, along the camera's axis, in the scene's units, or inf [default: that of a still
    /// scene's middle]
    #[arg(long, value_name = "DISTANCE", requires = "f_stop", allow_hyphen_values = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focus: Option<String>,
    /// Height of the sensor in the scene's units, from which the focal length follows [default: 0.024, film in metres]
    #[arg(long, value_name = "UNITS", requires = "f_stop", allow_negative_numbers = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_height: Option<f64>,
    /// Motion blur: each image is the mean, in linear light, of several over this part of the time from one image to
    /// the next; 360 is all of it, 0 none
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<f64>,
    /// Images of a shutter [default: 16]
    #[arg(long, value_name = "N", requires = "shutter", value_parser = clap::value_parser!(u32).range(1..=MOST_SAMPLES))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter_samples: Option<u32>,
}

impl Optics {
    /// Sets the footprints, the lens and the shutter of `views`.
    pub fn apply(&self, views: &mut Views) -> Result<(), Failure> {
        if let Some(name) = &self.footprint {
            let found = Falloff::ALL.iter().find(|falloff| falloff.name() == name);
            views.options.falloff = *found.ok_or_else(|| {
                let names: Vec<&str> = Falloff::ALL.iter().map(|falloff| falloff.name()).collect();
                Failure::usage(format!("--footprint {name}: expected {}", names.join(", ")))
            })?;
        }
        if self.panorama && self.f_stop.is_some() {
            return Err(Failure::usage("--f-stop: expected none beside --panorama, whose camera has no lens"));
        }
        views.options.aperture = self.aperture()?;
        views.shutter = self.shutter()?;
        let alone = [
            ("--footprint", self.footprint.is_some() && views.options.falloff != Falloff::Gaussian),
            ("--panorama", self.panorama),
            ("--f-stop", self.f_stop.is_some()),
        ];
        match alone.iter().find(|(_, asked)| *asked && views.backend != Backend::Cpu) {
            Some((option, _)) => Err(Failure::usage(format!("{option}: expected --renderer cpu, which alone has it"))),
            None => Ok(()),
        }
    }

    /// Returns the path, with panorama lenses if `--panorama` is set.
    pub fn around(&self, path: CameraPath) -> Result<CameraPath, Failure> {
        if !self.panorama {
            return Ok(path);
        }
        let views = path.views().iter().map(|(time, camera)| match camera {
            Camera::Posed { pose, .. } => Ok((*time, Camera::Posed { pose: *pose, lens: Lens::Equirectangular })),
            Camera::Canonical => {
                Err(Failure::usage("--panorama: expected a place (--camera), as the source's own view is from none"))
            }
        });
        let views = views.collect::<Result<_, _>>()?;
        CameraPath::new(views).ok_or_else(|| Failure::usage("--panorama: expected usable cameras"))
    }

    fn aperture(&self) -> Result<Option<Aperture>, Failure> {
        let Some(f_stop) = self.f_stop else { return Ok(None) };
        if f_stop.is_nan() || f_stop <= 0.0 {
            return Err(Failure::usage(format!("--f-stop {f_stop}: expected a number above 0")));
        }
        let sensor_height = self.sensor_height.unwrap_or(SENSOR_HEIGHT);
        if !(sensor_height > 0.0 && sensor_height.is_finite()) {
            return Err(Failure::usage(format!("--sensor-height {sensor_height}: expected a number above 0")));
        }
        let focus = match &self.focus {
            // Replaced by the scene's middle.
            None => Focus::Distance(f64::INFINITY),
            Some(text) => Focus::Distance(
                text.parse()
                    .ok()
                    .filter(|distance| *distance > 0.0)
                    .ok_or_else(|| Failure::usage(format!("--focus {text}: expected a distance above 0, or inf")))?,
            ),
        };
        Ok(Some(Aperture { f_stop, focus, sensor_height }))
    }

    /// Focuses on a point, if no distance was given.
    pub fn focus_on(&self, views: &mut Views, point: [f64; 3]) {
        if let (None, Some(aperture)) = (&self.focus, &mut views.options.aperture) {
            aperture.focus = Focus::Point(point);
        }
    }

    /// Returns an error for a lens without a focus distance, if the scene has no middle known beforehand.
    pub fn needs_focus(&self) -> Result<(), Failure> {
        match (self.f_stop, &self.focus) {
            (Some(_), None) => Err(Failure::usage("--f-stop: expected --focus as well for a scene in time")),
            _ => Ok(()),
        }
    }

    fn shutter(&self) -> Result<Option<Shutter>, Failure> {
        let Some(degrees) = self.shutter else { return Ok(None) };
        if !(0.0..=TURN).contains(&degrees) {
            return Err(Failure::usage(format!("--shutter {degrees}: expected from 0 to {TURN} degrees")));
        }
        if degrees == 0.0 {
            return Ok(None);
        }
        let count = self.shutter_samples.unwrap_or(SAMPLES);
        let open = degrees / TURN;
        let part = |i: u32| open * ((f64::from(i) + 0.5) / f64::from(count) - 0.5);
        Ok(Some(Shutter((0..count).map(part).collect())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied(optics: &Optics) -> Result<Views, Failure> {
        let mut views = Views::own();
        optics.apply(&mut views).map(|()| views)
    }

    #[test]
    fn a_shutter_is_open_around_the_time_of_its_image() {
        let parts = |shutter: f64, samples: Option<u32>| {
            let optics = Optics { shutter: Some(shutter), shutter_samples: samples, ..Optics::default() };
            applied(&optics).expect("valid").shutter.map(|shutter| shutter.parts().to_vec())
        };
        assert_eq!(parts(0.0, None), None);
        assert_eq!(parts(360.0, Some(4)), Some(vec![-0.375, -0.125, 0.125, 0.375]));
        assert_eq!(parts(180.0, Some(2)), Some(vec![-0.125, 0.125]));
        assert_eq!(parts(180.0, Some(1)), Some(vec![0.0]));
        assert_eq!(parts(90.0, None).map(|parts| parts.len()), Some(16));
        for wrong in [-1.0, 360.5, f64::NAN, f64::INFINITY] {
            let optics = Optics { shutter: Some(wrong), ..Optics::default() };
            assert!(matches!(applied(&optics), Err(Failure::Usage(_))), "{wrong}");
        }
    }

    #[test]
    fn what_is_no_lens_is_wrong_use() {
        let lens = |f_stop: f64, focus: Option<&str>, sensor_height: Option<f64>| {
            applied(&Optics {
                f_stop: Some(f_stop),
                focus: focus.map(str::to_owned),
                sensor_height,
                ..Optics::default()
            })
        };
        for f_stop in [0.0, -2.0, f64::NAN] {
            assert!(matches!(lens(f_stop, None, None), Err(Failure::Usage(_))), "{f_stop}");
        }
        for focus in ["0", "-1", "nan", "", "far", "-inf"] {
            assert!(matches!(lens(2.0, Some(focus), None), Err(Failure::Usage(_))), "{focus}");
        }
        for height in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(lens(2.0, None, Some(height)), Err(Failure::Usage(_))), "{height}");
        }
        let far = lens(2.8, Some("inf"), None).expect("valid").options.aperture.expect("a lens");
        assert_eq!(far.focus, Focus::Distance(f64::INFINITY));
    }

    #[test]
    fn footprints_have_names() {
        for (name, falloff) in [("gaussian", Falloff::Gaussian), ("splat-transform", Falloff::SplatTransform)] {
            let optics = Optics { footprint: Some(name.to_owned()), ..Optics::default() };
            assert_eq!(applied(&optics).expect("valid").options.falloff, falloff);
        }
        let optics = Optics { footprint: Some("square".to_owned()), ..Optics::default() };
        assert!(matches!(applied(&optics), Err(Failure::Usage(text)) if text.contains("playcanvas")));
    }
}
