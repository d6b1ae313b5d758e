use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Blocks, Compression, Encoding, FlatSamples, Image, ImageAttributes,
    IntegerBounds, Layer, LayerAttributes, LineOrder, SmallVec, Text, Vec2, WritableImage,
};

use super::*;
use crate::picture::Picture;

/// A file of one part.
struct Written<'a> {
    /// Left edge, upper edge, width and height.
    display: [i32; 4],
    data: [i32; 4],
    channels: Vec<(&'a str, Vec<f32>)>,
    texts: Vec<(&'a str, &'a str)>,
    half: bool,
    aspect: f32,
    chromaticities: Option<crate::openexr::Chromaticities>,
    aces: bool,
}

impl Default for Written<'_> {
    fn default() -> Self {
        let (display, data) = ([0, 0, 1, 1], [0, 0, 1, 1]);
        Written {
            display,
            data,
            channels: Vec::new(),
            texts: Vec::new(),
            half: false,
            aspect: 1.0,
            chromaticities: None,
            aces: false,
        }
    }
}

impl Written<'_> {
    fn bytes(&self) -> Vec<u8> {
        let size = |window: [i32; 4]| Vec2(window[2] as usize, window[3] as usize);
        let mut list = SmallVec::new();
        for (name, samples) in &self.channels {
            let samples = match self.half {
                true => FlatSamples::F16(samples.iter().map(|&v| half::f16::from_f32(v)).collect()),
                false => FlatSamples::F32(samples.clone()),
            };
            list.push(AnyChannel::new(*name, samples));
        }
        let text = |text: &str| Text::from(text);
        let mut other: std::collections::HashMap<_, _> =
            self.texts.iter().map(|(name, value)| (text(name), AttributeValue::Text(text(value)))).collect();
        if self.aces {
            other.insert(text("acesImageContainerFlag"), AttributeValue::I32(1));
        }
        let attributes =
            LayerAttributes { layer_position: Vec2(self.data[0], self.data[1]), other, ..LayerAttributes::default() };
        let encoding =
            Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
        let layer = Layer::new(size(self.data), attributes, encoding, AnyChannels::sort(list));
        let mut image = Image::from_layer(layer);
        let display = IntegerBounds { position: Vec2(self.display[0], self.display[1]), size: size(self.display) };
        image.attributes = ImageAttributes { pixel_aspect: self.aspect, ..ImageAttributes::new(display) };
        image.attributes.chromaticities = self.chromaticities.map(|[red, green, blue, white]| {
            let xy = |[x, y]: [f64; 2]| Vec2(x as f32, y as f32);
            exr::meta::attribute::Chromaticities { red: xy(red), green: xy(green), blue: xy(blue), white: xy(white) }
        });
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write().non_parallel().to_buffered(&mut bytes).expect("memory");
        bytes.into_inner()
    }

    fn still(&self) -> Still {
        decode(&self.bytes(), Path::new("a.exr")).expect("valid")
    }

    fn error(&self) -> String {
        decode(&self.bytes(), Path::new("a.exr")).expect_err("refused").to_string()
    }
}

fn rgb(r: f32, g: f32, b: f32) -> Vec<(&'static str, Vec<f32>)> {
    vec![("R", vec![r]), ("G", vec![g]), ("B", vec![b])]
}

/// One pixel in a file with these text attributes.
fn said<'a>(texts: &[(&'a str, &'a str)], [r, g, b]: [f32; 3]) -> Written<'a> {
    Written { channels: rgb(r, g, b), texts: texts.to_vec(), ..Written::default() }
}

#[test]
fn colours_are_linear_light_unless_the_file_says_otherwise() {
    for half in [false, true] {
        let file = Written { channels: rgb(0.5, 0.0, 1.0), half, ..Written::default() };
        let found = file.still();
        assert_eq!(found.picture.to_rgb8(), [188, 0, 255]);
        assert!(found.notes.len() == 1 && found.notes[0].contains("linear light"), "{:?}", found.notes);
    }
    for name in ["lin_rec709_scene", "lin_rec709", "Linear", "scene_linear", "lin_srgb", "Linear Rec.709"] {
        let found = said(&[("oiio:ColorSpace", name)], [0.5, 0.0, 1.0]).still();
        assert_eq!(found.picture.to_rgb8(), [188, 0, 255], "{name}");
        assert_eq!(found.notes, [format!("EXR colours are converted from {name} to sRGB")]);
    }
    for name in ["sRGB", "srgb_rec709_display", "srgb_rec709_scene", "sRGB - Texture", "g24_rec709_display"] {
        let found = said(&[("oiio:ColorSpace", name)], [0.25, 0.0, 1.0]).still();
        assert_eq!((found.picture.rgb, found.notes.len()), (vec![0.25, 0.0, 1.0], 0), "{name}");
    }
    // The identifier takes precedence over the older name.
    let both = [("oiio:ColorSpace", "Linear"), ("colorInteropID", "srgb_rec709_scene")];
    assert_eq!(said(&both, [0.25; 3]).still().picture.rgb, [0.25; 3]);
    // 0.5 to the power 2.2, and sRGB's curve.
    let expected = 1.055 * 0.5_f32.powf(2.2 / 2.4) - 0.055;
    for name in ["g22_rec709_scene", "Gamma2.2"] {
        let found = said(&[("colorInteropID", name)], [0.5; 3]).still().picture.rgb[1];
        assert!((found - expected).abs() < 1e-6, "{name}: {found}");
    }
}

#[test]
fn other_primaries_become_those_of_srgb() {
    // BT.709's green in each space, by the standards' matrices.
    for (name, colour) in [
        ("lin_ap1_scene", [0.339_523, 0.916_354, 0.109_570]),
        ("ACEScg", [0.339_523, 0.916_354, 0.109_570]),
        ("lin_rec2020_scene", [0.329_283, 0.919_540, 0.088_013]),
        ("lin_p3d65_scene", [0.177_538, 0.966_806, 0.072_397]),
        ("lin_ap0_scene", [0.382_983, 0.813_440, 0.111_547]),
    ] {
        let found = said(&[("colorInteropID", name)], colour).still().picture.to_rgb8();
        let near = |found: u8, expected: u8| found.abs_diff(expected) <= 2;
        assert!(near(found[1], 255) && found[0] < 12 && found[2] < 12, "{name}: {found:?}");
    }
    let by_chromaticities =
        |primaries| Written { chromaticities: Some(primaries), ..said(&[], [0.329_283, 0.919_540, 0.088_013]) };
    let found = by_chromaticities([[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], [0.3127, 0.3290]]).still();
    let eight = found.picture.to_rgb8();
    assert!(eight[1] >= 254 && eight[0] < 12 && eight[2] < 12, "{eight:?}");
    assert!(found.notes.iter().any(|note| note.contains("its chromaticities")), "{:?}", found.notes);
    // Primaries equal to sRGB's change nothing.
    let same = Written {
        chromaticities: Some([[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]]),
        ..said(&[], [0.5; 3])
    };
    assert_eq!(same.still().picture.to_rgb8(), [188; 3]);
    let aces = Written { aces: true, ..said(&[], [0.382_983, 0.813_440, 0.111_547]) };
    assert!(aces.still().picture.to_rgb8()[1] >= 253);
    assert!(by_chromaticities([[0.3, 0.3]; 4]).error().contains("expected chromaticities that span colours"));
}

#[test]
fn spaces_that_are_not_known_are_refused_by_name() {
    let error = said(&[("oiio:ColorSpace", "ARRI LogC4")], [0.5; 3]).error();
    assert!(error.contains("a.exr: the EXR colour space ARRI LogC4 is not known here; oiiotool"), "{error}");
    assert!(said(&[("colorInteropID", "pq_rec2020_display")], [0.5; 3]).error().contains("pq_rec2020_display"));
    assert!(said(&[("colorInteropID", "data")], [0.5; 3]).error().contains("expected colours, found samples"));
    assert_eq!(said(&[("colorInteropID", "unknown")], [0.5; 3]).still().picture.to_rgb8(), [188; 3]);
}

#[test]
fn bright_colours_are_clamped_and_that_is_said_and_no_number_names_its_pixel() {
    let file = |values: [f32; 4]| Written {
        display: [0, 0, 2, 2],
        data: [0, 0, 2, 2],
        channels: vec![("Y", values.to_vec())],
        texts: vec![("oiio:ColorSpace", "sRGB")],
        ..Written::default()
    };
    let found = file([0.25, 7.0, -1.0, 0.5]).still();
    assert_eq!(found.picture.rgb[..4], [0.25, 1.0, 0.0, 0.5]);
    assert_eq!(found.notes, ["colours outside 0 to 1 are clamped"]);
    let error = decode(&file([0.25, 7.0, -1.0, f32::NAN]).bytes(), Path::new("a.exr")).expect_err("NaN");
    assert!(matches!(error, SourceError::NotFinite { x: 1, y: 1, .. }), "{error}");
}

#[test]
fn the_display_window_is_the_picture() {
    let shown = |display: [i32; 4], data: [i32; 4]| {
        let area = (data[2] * data[3]) as usize;
        let samples: Vec<f32> = (0..area).map(|i| (i + 1) as f32 / 100.0).collect();
        let texts = vec![("oiio:ColorSpace", "sRGB")];
        let Picture { width, height, rgb } =
            Written { display, data, channels: vec![("Y", samples)], texts, ..Written::default() }.still().picture;
        let hundredths: Vec<i32> = rgb[..width * height].iter().map(|v| (v * 100.0).round() as i32).collect();
        (width, height, hundredths)
    };
    // Data window inside the display window, at its edge, all around it, and outside.
    assert_eq!(shown([0, 0, 4, 3], [1, 1, 2, 1]), (4, 3, vec![0, 0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0]));
    assert_eq!(shown([10, 20, 3, 2], [12, 19, 2, 2]), (3, 2, vec![0, 0, 3, 0, 0, 0]));
    assert_eq!(shown([0, 0, 2, 1], [-1, -1, 4, 3]), (2, 1, vec![6, 7]));
    assert_eq!(shown([-2, -1, 2, 2], [-3, -1, 3, 2]), (2, 2, vec![2, 3, 5, 6]));
    assert_eq!(shown([0, 0, 2, 1], [5, 5, 1, 1]), (2, 1, vec![0, 0]));
}

#[test]
fn what_has_no_samples_is_transparent_and_light_is_added_as_light() {
    let file = Written {
        display: [0, 0, 3, 1],
        data: [0, 0, 2, 1],
        channels: vec![("R", vec![0.5, 0.25]), ("G", vec![0.0, 0.0]), ("B", vec![0.0, 0.0]), ("A", vec![1.0, 0.5])],
        ..Written::default()
    };
    let found = file.still();
    let half = 0.25 + 0.5 * 0.214_041_14;
    let expected = 1.055 * f32::powf(half, 1.0 / 2.4) - 0.055;
    let red = &found.picture.rgb[..3];
    assert!(
        (red[0] - 0.735_357).abs() < 1e-6 && (red[1] - expected).abs() < 1e-6 && (red[2] - 0.5).abs() < 1e-6,
        "{red:?}"
    );
    assert!(found.notes.iter().any(|note| note == super::super::OVER_GREY), "{:?}", found.notes);
}

#[test]
fn pixels_are_made_square() {
    let wide = Written {
        display: [0, 0, 4, 2],
        data: [0, 0, 4, 2],
        channels: vec![("Y", vec![1.0; 8])],
        aspect: 2.0,
        ..Written::default()
    };
    let found = wide.still();
    assert_eq!((found.picture.width, found.picture.height), (8, 2));
    assert!(found.notes.iter().any(|note| note.contains("made square")), "{:?}", found.notes);
    let high = Written { aspect: 0.5, ..wide }.still().picture;
    assert_eq!((high.width, high.height), (4, 4));
}

#[test]
fn the_layer_of_the_whole_picture_is_taken_and_the_others_are_said() {
    let layer = |name: &str, value: f32| -> Vec<(&'static str, Vec<f32>)> {
        ["R", "G", "B"].map(|c| (&*Box::leak(format!("{name}.{c}").into_boxed_str()), vec![value])).to_vec()
    };
    let of = |channels: Vec<(&'static str, Vec<f32>)>| Written {
        channels,
        texts: vec![("oiio:ColorSpace", "sRGB")],
        ..Written::default()
    };
    let blender =
        of([layer("ViewLayer.Combined", 0.5), layer("ViewLayer.DiffCol", 0.25), layer("ViewLayer.Emit", 0.75)]
            .concat());
    let found = blender.still();
    assert_eq!(found.picture.rgb, [0.5; 3]);
    assert_eq!(
        found.notes,
        ["of the EXR layers ViewLayer.Combined is taken, ViewLayer.DiffCol, ViewLayer.Emit left out"]
    );
    let plain = of([rgb(0.5, 0.5, 0.5), layer("specular", 0.25)].concat()).still();
    assert_eq!(plain.picture.rgb, [0.5; 3]);
    assert!(plain.notes[0].ends_with("is taken, specular left out"), "{:?}", plain.notes);
    let only = of([layer("specular", 0.25), vec![("depth.Z", vec![5.0])]].concat()).still();
    assert_eq!((only.picture.rgb, only.notes.len()), (vec![0.25; 3], 0));
    let error = of([layer("diffuse", 0.5), layer("specular", 0.25)].concat()).error();
    assert!(error.contains("expected one layer of colours") && error.contains("found diffuse, specular"), "{error}");
    assert!(of(vec![("Z", vec![0.5])]).error().contains("expected EXR channels R, G, B or Y, found Z"));
}

#[test]
fn compression_that_is_not_read_is_named_with_what_converts_it() {
    let mut bytes = Written { channels: rgb(0.5, 0.5, 0.5), ..Written::default() }.bytes();
    let name = b"compression\0compression\0";
    let at = bytes.windows(name.len()).position(|w| w == name).expect("an attribute") + name.len() + 4;
    for (code, word) in [(10, "HTJ2K256 (10)"), (13, "Zstandard (13)"), (99, "unknown (99)")] {
        bytes[at] = code;
        let error = decode(&bytes, Path::new("a.exr")).expect_err("refused").to_string();
        assert!(error.contains(word) && error.contains("oiiotool IN --compression zip -o OUT"), "{error}");
    }
}

#[test]
fn what_is_written_here_is_read_back_as_it_was() {
    let samples: Vec<f32> = (0..18).map(|i| i as f32 / 17.0).collect();
    let image = crate::render::Image {
        width: 3,
        height: 2,
        rgb: samples.clone(),
        depth: Some(vec![1.0; 6]),
        alpha: Some(vec![1.0; 6]),
        ..crate::render::Image::default()
    };
    let bytes = crate::output::layered_exr(&image).expect("memory");
    let found = decode(&bytes, Path::new("a.exr")).expect("valid");
    assert_eq!((found.picture.rgb, found.notes.len()), (samples, 0));
}
