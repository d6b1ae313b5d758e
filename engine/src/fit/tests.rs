use super::*;

#[test]
fn a_wide_frame_touches_left_and_right_and_keeps_its_shape() {
    let p = Placement::new(Fit::Letterbox, [100, 400], [144, 256]).unwrap();
    assert_eq!((p.content, p.offset), ([64, 256], [40, 0]));
    let p = Placement::new(Fit::Letterbox, [400, 100], [144, 256]).unwrap();
    assert_eq!((p.content, p.offset), ([144, 36], [0, 110]));
    let p = Placement::new(Fit::Letterbox, [288, 512], [144, 256]).unwrap();
    assert!(p.is_full());
    assert_eq!(Placement::new(Fit::Stretch, [7, 9000], [144, 256]).unwrap().content, [144, 256]);
}

#[test]
fn degenerate_shapes_keep_one_pixel_and_empty_ones_are_refused() {
    assert_eq!(Placement::new(Fit::Letterbox, [1, 100_000], [16, 16]).unwrap().content, [1, 16]);
    assert_eq!(Placement::new(Fit::Letterbox, [1, 1], [16, 32]).unwrap().content, [16, 16]);
    assert!(Placement::new(Fit::Letterbox, [0, 4], [16, 16]).is_none());
    assert!(Placement::new(Fit::Stretch, [4, usize::MAX], [16, 16]).is_none());
}

#[test]
fn the_inputs_aspect_is_that_of_square_pixels_of_the_source() {
    let aspect = |fit, source, model| Placement::new(fit, source, model).unwrap().aspect();
    assert_eq!(aspect(Fit::Letterbox, [144, 256], [288, 512]), 16.0 / 9.0);
    // A border belongs to the input: the content keeps the source's shape in it.
    assert_eq!(aspect(Fit::Letterbox, [256, 144], [144, 256]), 16.0 / 9.0);
    // A stretched content is stretched back.
    assert_eq!(aspect(Fit::Stretch, [256, 144], [144, 256]), 9.0 / 16.0);
    assert_eq!(aspect(Fit::Stretch, [101, 77], [40, 32]), 77.0 / 101.0);
}

#[test]
fn the_border_repeats_the_edge_and_the_crop_gives_the_content_back() {
    let p = Placement::new(Fit::Letterbox, [2, 4], [6, 4]).unwrap();
    assert_eq!((p.content, p.offset), ([2, 4], [2, 0]));
    let frame: Vec<f32> = (0..16).map(|i| i as f32).collect();
    let fitted = p.fit_in(Level::scalar(), &frame);
    assert_eq!(fitted.len(), 2 * 24);
    assert_eq!(fitted[..4], [0.0, 1.0, 2.0, 3.0]);
    assert_eq!(fitted[4 * 4..4 * 5], [4.0, 5.0, 6.0, 7.0]);
    assert_eq!(fitted[4 * 5..4 * 6], [4.0, 5.0, 6.0, 7.0]);
    assert_eq!(fitted[24..28], [8.0, 9.0, 10.0, 11.0]);
    assert_eq!(p.crop(&fitted), frame);
}

#[test]
fn a_constant_frame_stays_constant_at_any_size() {
    for source in [[1, 1], [1, 7], [31, 1], [17, 23], [5, 3]] {
        for fit in [Fit::Letterbox, Fit::Stretch] {
            let p = Placement::new(fit, source, [16, 24]).unwrap();
            let fitted = p.fit_in(Level::detect(), &vec![0.375; source[0] * source[1]]);
            assert!(fitted.iter().all(|&x| x == 0.375), "{source:?} {fit:?}");
        }
    }
}

#[test]
fn every_level_fits_to_the_same_bits() {
    let p = Placement::new(Fit::Letterbox, [37, 53], [40, 72]).unwrap();
    let frame: Vec<f32> = (0..3 * 37 * 53).map(|i| ((i * 7919) % 1009) as f32 / 1009.0).collect();
    let expected = p.fit_in(Level::scalar(), &frame);
    for level in Level::available() {
        let found = p.fit_in(level, &frame);
        assert!(expected.iter().zip(&found).all(|(a, b)| a.to_bits() == b.to_bits()), "{level}");
    }
}

#[test]
fn depth_is_normalised_by_its_own_range() {
    let mut depth = [2.0, 4.0, f32::NAN, 3.0, f32::INFINITY];
    assert_eq!(normalise_depth(&mut depth), 2);
    assert_eq!(depth, [0.0, 1.0, 0.0, 0.5, 0.0]);
    let mut constant = [7.0; 3];
    assert_eq!(normalise_depth(&mut constant), 0);
    assert_eq!(constant, [0.0; 3]);
    let mut wide = [f32::MIN, f32::MAX, 0.0];
    normalise_depth(&mut wide);
    assert_eq!(wide, [0.0, 1.0, 0.5]);
    assert_eq!(normalise_depth(&mut [f32::NAN]), 1);
}
