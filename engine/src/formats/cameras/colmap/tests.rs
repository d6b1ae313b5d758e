use super::*;

const CAMERAS: &str = "# a comment\n1 SIMPLE_PINHOLE 40 30 35 20 15\n7 PINHOLE 40 30 35 36 19 14.5\n";
const IMAGES: &str = "# a comment\n1 1 0 0 0 0 0 2 1 b 10.png\n\n2 0.5 0.5 0.5 0.5 1 2 3 7 b 9.png\n1 2 3 4 5 6\n";

/// Returns the files of a model without rigs.
fn files<'a>(cameras: &'a [u8], images: &'a [u8]) -> Files<'a> {
    Files { cameras, images, rigs: None }
}

fn binary_files() -> (Vec<u8>, Vec<u8>) {
    let (mut cameras, mut images) = (2_u64.to_le_bytes().to_vec(), 2_u64.to_le_bytes().to_vec());
    for (id, model, parameters) in [(1_u32, 0_u32, &[35.0, 20.0, 15.0][..]), (7, 1, &[35.0, 36.0, 19.0, 14.5])] {
        cameras.extend(id.to_le_bytes());
        cameras.extend(model.to_le_bytes());
        [40_u64, 30].iter().for_each(|side| cameras.extend(side.to_le_bytes()));
        parameters.iter().for_each(|p: &f64| cameras.extend(p.to_le_bytes()));
    }
    let second = [0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 3.0];
    for (id, numbers, camera, name, points) in
        [(1_u32, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0], 1_u32, "b 10.png", 0_u64), (2, second, 7, "b 9.png", 2)]
    {
        images.extend(id.to_le_bytes());
        numbers.iter().for_each(|n: &f64| images.extend(n.to_le_bytes()));
        images.extend(camera.to_le_bytes());
        images.extend(name.as_bytes());
        images.push(0);
        images.extend(points.to_le_bytes());
        images.extend(vec![9; 24 * points as usize]);
    }
    (cameras, images)
}

#[test]
fn text_and_binary_give_the_same_cameras_in_the_order_of_their_names() {
    let set = text(&files(CAMERAS.as_bytes(), IMAGES.as_bytes())).expect("a model");
    let names: Vec<&str> = set.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["b 9.png", "b 10.png"]);
    let (cameras, images) = binary_files();
    assert_eq!(binary(&files(&cameras, &images)), Ok(set));
    for length in 0..images.len() {
        assert!(binary(&files(&cameras, &images[..length])).is_err(), "{length}");
    }
    for length in 0..cameras.len() {
        assert!(binary(&files(&cameras[..length], &images)).is_err(), "{length}");
    }
}

/// Returns the errors of a set's views, by name.
fn refused(set: &CameraSet) -> Vec<(&str, String)> {
    let refused = set.cameras.iter().filter_map(|named| Some((named, named.camera.as_ref().err()?)));
    refused.map(|(named, error)| (named.name.as_str(), error.to_string())).collect()
}

#[test]
fn only_views_through_distortion_are_refused_by_name() {
    let radial = CAMERAS.replace("1 SIMPLE_PINHOLE 40 30 35 20 15", "1 SIMPLE_RADIAL 40 30 35 20 15 0.1");
    let set = text(&files(radial.as_bytes(), IMAGES.as_bytes())).expect("a model");
    let [(name, error)] = &refused(&set)[..] else { panic!("{set:?}") };
    assert_eq!(*name, "b 10.png");
    assert!(
        error.contains("camera 1: expected SIMPLE_PINHOLE or PINHOLE") && error.ends_with("SIMPLE_RADIAL"),
        "{error}"
    );
    assert!(set.find("b 9.png").expect("there").camera.is_ok() && set.path().is_err());
    let set = text(&files(b"1 PINHOLE 4 3 1 2", IMAGES.as_bytes())).expect("a model");
    let errors = refused(&set);
    assert!(errors[0].1.contains("expected camera 7 to be listed"), "{errors:?}");
    assert!(errors[1].1.contains("expected 4 parameters"), "{errors:?}");
}

#[test]
fn a_camera_of_any_model_that_no_image_uses_changes_nothing() {
    let (cameras, images) = binary_files();
    let expected = binary(&files(&cameras, &images)).expect("a model");
    for (model, parameters) in [(4_u32, 8), (12, 4), (13, 5), (14, 3), (15, 4), (16, 6), (17, 2)] {
        let mut more = 3_u64.to_le_bytes().to_vec();
        more.extend([2_u32, model].iter().flat_map(|n| n.to_le_bytes()));
        more.extend([40_u64, 30].iter().flat_map(|n| n.to_le_bytes()));
        more.extend(vec![0; 8 * parameters]);
        more.extend(&cameras[8..]);
        assert_eq!(binary(&files(&more, &images)), Ok(expected.clone()), "{model}");
        more[12] = 18;
        let error = binary(&files(&more, &images)).expect_err("unknown").to_string();
        assert_eq!(error, "cameras.bin: expected camera models 0 to 17, found 18");
    }
}

const RIGS: &str = "# rigs\n5 3 CAMERA 1 CAMERA 7 1 0.5 0.5 0.5 0.5 0.25 0 0 IMU 1 0\n";
const FRAMES: &str = "# frames\n1 5 0 0 1 0 1 2 3 2 CAMERA 1 1 CAMERA 7 2\n";

fn with_rigs(rigs: &str, frames: &str) -> CameraSet {
    let rigs = Some([rigs.as_bytes(), frames.as_bytes()]);
    text(&Files { rigs, ..files(CAMERAS.as_bytes(), IMAGES.as_bytes()) }).expect("a model")
}

/// Returns the binary form of the same rigs.
fn binary_rigs() -> [Vec<u8>; 2] {
    fn push(bytes: &mut Vec<u8>, words: &[u32], numbers: &[f64]) {
        bytes.extend(words.iter().flat_map(|n| n.to_le_bytes()));
        bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    }
    let (mut rigs, mut frames) = (1_u64.to_le_bytes().to_vec(), 1_u64.to_le_bytes().to_vec());
    push(&mut rigs, &[5, 3, 0, 1, 0, 7], &[]);
    rigs.push(1);
    push(&mut rigs, &[], &[0.5, 0.5, 0.5, 0.5, 0.25, 0.0, 0.0]);
    push(&mut rigs, &[1, 1], &[]);
    rigs.push(0);
    push(&mut frames, &[1, 5], &[0.0, 0.0, 1.0, 0.0, 1.0, 2.0, 3.0]);
    push(&mut frames, &[2, 0, 1, 1, 0, 0, 7, 2, 0], &[]);
    [rigs, frames]
}

#[test]
fn rigs_and_frames_decide_where_images_say_something_else() {
    let set = with_rigs(RIGS, FRAMES);
    let place = |name: &str| match set.find(name).expect("there").camera.clone().expect("a camera").camera {
        crate::camera::Camera::Posed { pose, .. } => pose,
        other => panic!("{other:?}"),
    };
    // A half turn about y maps to (−x, y, −z), and the translation is the frame's.
    let first = place("b 10.png");
    assert_eq!(first.position, [1.0, -2.0, 3.0]);
    // The frame's translation turned by (x, y, z) → (z, x, y), and the camera's own position.
    let second = place("b 9.png");
    let down = second
        .rotation
        .inverse()
        .matrix()
        .map(|row| -(row[0] * second.position[0] + row[1] * second.position[1] + row[2] * second.position[2]));
    assert!(down.iter().zip([3.25, 1.0, 2.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{down:?}");
    let (cameras, images) = binary_files();
    let [rigs, frames] = binary_rigs();
    let read = |rigs: &[u8], frames: &[u8]| binary(&Files { rigs: Some([rigs, frames]), ..files(&cameras, &images) });
    let found = read(&rigs, &frames).expect("a model");
    assert_eq!(found, set);
    for length in 0..rigs.len() {
        assert!(read(&rigs[..length], &frames).is_err(), "{length}");
    }
    for length in 0..frames.len() {
        assert!(read(&rigs, &frames[..length]).is_err(), "{length}");
    }
}

#[test]
fn poses_are_the_images_own_without_frames_and_missing_ones_are_named() {
    let own = text(&files(CAMERAS.as_bytes(), IMAGES.as_bytes())).expect("a model");
    assert_eq!(with_rigs("# none\n", ""), own);
    assert_eq!(with_rigs(RIGS, "# none\n"), own);
    let second = |rigs: &str, frames: &str| refused(&with_rigs(rigs, frames))[0].1.clone();
    for (error, expected) in [
        (
            second(&RIGS.replace("CAMERA 7 1 0.5 0.5 0.5 0.5 0.25 0 0", "CAMERA 7 0"), FRAMES),
            "the pose of camera 7 in rig 5",
        ),
        (second(&RIGS.replace("CAMERA 7", "IMU 7"), FRAMES), "camera 7 in rig 5"),
        (second(RIGS, &FRAMES.replace("2 CAMERA 1 1 CAMERA 7 2", "1 CAMERA 1 1")), "image 2 in a frame"),
        (second("", FRAMES), "rig 5 in the file rigs"),
    ] {
        assert!(error.starts_with(&format!("b 9.png: expected {expected}")), "{error}");
    }
    let rigs = Some([RIGS.as_bytes(), b"1 5 x".as_slice()]);
    let error =
        text(&Files { rigs, ..files(CAMERAS.as_bytes(), IMAGES.as_bytes()) }).expect_err("no frame").to_string();
    assert!(error.starts_with("frames.txt, line 1: expected FRAME_ID"), "{error}");
}
