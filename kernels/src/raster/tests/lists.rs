//! Footprints and lists for a blend elsewhere.

use super::*;

fn lists(level: Level, scene: &OwnedGaussians, projection: &Projection, request: &Request) -> (Lists, Work) {
    let (mut rasteriser, mut lists) = (Rasteriser::new(level), Lists::default());
    rasteriser.lists(&scene.gaussians(), projection, request, &mut lists);
    (lists, rasteriser.work())
}

/// Blends the lists as documented for [`Footprint`], in binary32, without fused operations.
fn blend(lists: &Lists, request: &Request) -> Vec<f32> {
    let pixels = request.width * request.height;
    let mut rgb = vec![0.0; 3 * pixels];
    for at in 0..pixels {
        let (column, row) = (at % request.width, at / request.width);
        let (x, y) = (column as f32, row as f32);
        let tile = row / TILE_PIXELS[1] * lists.tiles[0] + column / TILE_PIXELS[0];
        let mut transmittance = 1.0_f32;
        let mut colour = [0.0_f32; 3];
        for &place in &lists.order[lists.starts[tile] as usize..lists.starts[tile + 1] as usize] {
            let f = &lists.footprints[place as usize];
            let block = [(column / 4) as u16, (row / 4) as u16];
            if !(f.columns[0] <= block[0] && block[0] <= f.columns[1] && f.rows[0] <= block[1] && block[1] <= f.rows[1])
            {
                continue;
            }
            let s = f.down * ((y - f.row[0]) - f.row[1]);
            let t = f.across * ((x - f.middle[0]) - (f.middle[1] + f.slope * (y - f.anchor)));
            let alpha = (f.opacity * (-(s * s + t * t).min(126.0)).exp2()).min(0.99);
            if alpha < ALPHA_MIN {
                continue;
            }
            let weight = alpha * transmittance;
            if transmittance - weight < 1e-4 {
                break;
            }
            for (sum, value) in colour.iter_mut().zip(f.rgb) {
                *sum += weight * value;
            }
            transmittance -= weight;
        }
        for channel in 0..3 {
            rgb[channel * pixels + at] = colour[channel] + transmittance * request.background[channel];
        }
    }
    rgb
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, rng_seed: RngSeed::Fixed(6), ..ProptestConfig::default() })]

    #[test]
    fn lists_blended_plainly_give_the_image(
        seed: u64, count in 0_usize..300, width in 1_usize..150, height in 1_usize..100, rotated: bool, wild: bool,
    ) {
        let scene = if wild { extreme(count, seed) } else { ordinary(count, rotated, seed) };
        for projection in projections(width, height) {
            let request = everything(width, height);
            let expected = render(Level::detect(), &scene.gaussians(), &projection, &request);
            let found = blend(&lists(Level::detect(), &scene, &projection, &request).0, &request);
            let brightest = scene.rgb.iter().flatten().filter(|v| v.is_finite()).fold(1.0_f32, |a, v| a.max(v.abs()));
            let off = |(a, b): &(&f32, &f32)| (*a - *b).abs() / brightest > 2.0 / 255.0;
            let count = found.iter().zip(&expected.rgb).filter(off).count();
            // A pixel or two may be on a threshold.
            prop_assert!(count <= 6 + found.len() / 2000, "{} of {} values differ", count, found.len());
        }
    }
}

#[test]
fn every_level_and_thread_count_gives_the_same_lists() {
    for projection in projections(131, 77) {
        for scene in [ordinary(5000, false, 3), ordinary(5000, true, 4), extreme(900, 5)] {
            let request = everything(131, 77);
            let (expected, work) = lists(Level::scalar(), &scene, &projection, &request);
            assert_eq!(expected.footprints.len() as u64, work.gaussians - work.culled - work.dropped);
            assert_eq!(expected.order.len() as u64, work.entries);
            for level in crate::testing::levels() {
                for threads in [1, 2, 3, 8] {
                    let (found, _) = pool(threads).install(|| lists(level, &scene, &projection, &request));
                    let same = bytemuck::cast_slice::<_, u32>(&found.footprints)
                        == bytemuck::cast_slice::<_, u32>(&expected.footprints);
                    assert!(same, "{} with {threads} threads", level.name());
                    assert_eq!((&found.starts, &found.order), (&expected.starts, &expected.order));
                }
            }
        }
    }
}

#[test]
fn an_image_after_lists_is_drawn_anew() {
    let (scene, projection, request) = (ordinary(500, true, 8), projections(80, 50)[1], everything(80, 50));
    let mut rasteriser = Rasteriser::new(Level::detect());
    let expected = bits(rasteriser.render(&scene.gaussians(), &projection, &request));
    rasteriser.lists(&scene.gaussians(), &projection, &request, &mut Lists::default());
    assert_eq!(bits(rasteriser.render(&scene.gaussians(), &projection, &request)), expected);
}
