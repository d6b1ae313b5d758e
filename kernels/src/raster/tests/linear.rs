//! The linear map of the colours: the bits of the image, adjointness, the plain version, extremes.

use std::collections::HashMap;

use super::super::project::BLOCK;
use super::*;

/// Values between −1 and 1.
fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut random = Random(seed);
    (0..len).map(|_| random.range(-1.0, 1.0)).collect()
}

fn colours(len: usize, seed: u64) -> Vec<[f32; 3]> {
    noise(3 * len, seed).as_chunks().0.to_vec()
}

/// A map with its inputs, of the budget of weights `bytes`.
fn map(level: Level, scene: &OwnedGaussians, projection: &Projection, size: [usize; 2], bytes: usize) -> ColourMap {
    let mut map = ColourMap::with_budget(level, bytes);
    map.prepare(&scene.gaussians(), projection, size);
    map
}

fn forward(map: &ColourMap, colours: &[[f32; 3]], background: [f32; 3]) -> Vec<f32> {
    let mut image = vec![f32::NAN; 3 * map.size()[0] * map.size()[1]];
    map.forward(colours, background, &mut image);
    image
}

fn adjoint(map: &ColourMap, residual: &[f32]) -> Vec<[f32; 3]> {
    let mut sums = vec![[f32::NAN; 3]; map.gaussians()];
    map.adjoint(residual, &mut sums);
    sums
}

fn normal(map: &ColourMap, colours: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut sums = vec![[f32::NAN; 3]; map.gaussians()];
    map.normal(colours, &mut sums);
    sums
}

/// Bits of all results of a map.
fn everything_of(map: &ColourMap, colours: &[[f32; 3]], target: &[f32]) -> Vec<u32> {
    let mut all = forward(map, colours, [0.5, 0.25, 0.75]);
    all.extend(adjoint(map, target).as_flattened());
    all.extend(normal(map, colours).as_flattened());
    let mut sums = vec![[f32::NAN; 3]; map.gaussians()];
    let squares = map.residual_adjoint(colours, [0.5, 0.25, 0.75], target, &mut sums);
    all.extend(sums.as_flattened());
    let mut rows = vec![f32::NAN; map.gaussians()];
    map.row_sums(&mut rows);
    all.extend(rows);
    let mut columns = vec![[f32::NAN; 2]; map.gaussians()];
    map.column_sums(&mut columns);
    all.extend(columns.as_flattened());
    let mut bits: Vec<u32> = all.iter().map(|v| v.to_bits()).collect();
    bits.extend([squares.to_bits() as u32, (squares.to_bits() >> 32) as u32]);
    bits
}

fn assert_same(found: &[f32], expected: &[f32], what: &str) {
    let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(found) == bits(expected), "{what}");
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
}

/// Scenes of each kind: separable, turned, opaque and deep, extreme.
fn scenes() -> Vec<OwnedGaussians> {
    let mut deep = ordinary(900, true, 6);
    deep.opacity.fill(1.0);
    deep.mean.iter_mut().for_each(|mean| mean[2] = 1.0);
    deep.scale.iter_mut().for_each(|scale| *scale = scale.map(|s| 4.0 * s));
    let mut clear = ordinary(900, false, 7);
    clear.opacity.iter_mut().for_each(|opacity| *opacity *= 0.02);
    vec![ordinary(3000, false, 3), ordinary(3000, true, 4), extreme(500, 5), deep, clear, OwnedGaussians::default()]
}

/// The unit in which the map stores each weight: the smallest power of two, at least 2⁻¹⁶, with the Gaussian's largest
/// weight on the block of 4×4 pixels below 256 units. That weight may be larger by the part `doubt`.
fn units(weights: &[reference::Weight], size: [usize; 2], doubt: f64) -> Vec<f64> {
    let block = |w: &reference::Weight| (w.gaussian, w.pixel % size[0] / BLOCK, w.pixel / size[0] / BLOCK);
    let mut most: HashMap<_, f64> = HashMap::new();
    for w in weights {
        let most = most.entry(block(w)).or_default();
        *most = most.max(w.weight * (1.0 + doubt));
    }
    let unit = |most: f64| {
        let mut unit = 1.0 / 65536.0;
        while most >= 256.0 * unit {
            unit *= 2.0;
        }
        unit
    };
    weights.iter().map(|w| unit(most[&block(w)])).collect()
}

#[test]
fn forward_is_the_image_with_the_same_colours_up_to_the_rounding_of_weights() {
    for size in [[131, 77], [1, 1], [64, 32]] {
        for projection in projections(size[0], size[1]) {
            for mut scene in scenes() {
                let background = [0.5, -0.0, 0.75];
                let map = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
                let colours = colours(scene.mean.len(), 8);
                scene.rgb.clone_from(&colours);
                let request = Request::colour(size[0], size[1], background);
                let image = render(Level::detect(), &scene.gaussians(), &projection, &request);
                // Half a unit for each Gaussian of a pixel, as colours are at most 1, and the rounding of binary32.
                let (_, weights) = reference::weights(&scene.gaussians(), &projection, &request);
                let mut allowed = vec![8e-6; size[0] * size[1]];
                for (w, unit) in weights.iter().zip(units(&weights, size, 1e-3)) {
                    allowed[w.pixel] += 1e-6 + unit * if w.weight > 254.5 * unit { 1.0 } else { 0.5 };
                }
                for (at, (found, expected)) in forward(&map, &colours, background).iter().zip(&image.rgb).enumerate() {
                    let allowed = allowed[at % allowed.len()];
                    let error = f64::from((found - expected).abs());
                    assert!(error <= allowed, "{at}: {found}, expected {expected}");
                }
            }
        }
    }
}

#[test]
fn every_level_thread_count_and_budget_gives_the_same_bits() {
    let size = [131, 77];
    for projection in projections(size[0], size[1]) {
        for scene in scenes() {
            let (colours, target) = (colours(scene.mean.len(), 9), noise(3 * size[0] * size[1], 10));
            let run = |level, bytes| everything_of(&map(level, &scene, &projection, size, bytes), &colours, &target);
            let expected = run(Level::scalar(), WEIGHT_BYTES);
            for level in crate::testing::levels() {
                for threads in [1, 2, 3, 8] {
                    for bytes in [0, 100_000, WEIGHT_BYTES] {
                        let found = pool(threads).install(|| run(level, bytes));
                        assert!(found == expected, "{} with {threads} threads, {bytes} bytes", level.name());
                    }
                }
            }
        }
    }
}

#[test]
fn maps_prepared_in_the_same_memory_have_their_own_bits() {
    let size = [131, 77];
    let projection = projections(size[0], size[1])[0];
    let scenes = scenes();
    for bytes in [0, 100_000, WEIGHT_BYTES] {
        let mut memory = Preparation::new(Level::detect());
        let maps: Vec<ColourMap> = scenes
            .iter()
            .map(|scene| {
                let mut map = ColourMap::with_budget(Level::detect(), bytes);
                map.prepare_in(&mut memory, &scene.gaussians(), &projection, size, |_| true);
                map
            })
            .collect();
        for (found, scene) in maps.iter().zip(&scenes) {
            let (colours, target) = (colours(scene.mean.len(), 9), noise(3 * size[0] * size[1], 10));
            let expected = map(Level::detect(), scene, &projection, size, bytes);
            let [found, expected] = [found, &expected].map(|map| everything_of(map, &colours, &target));
            assert!(found == expected, "{bytes} bytes");
        }
    }
}

#[test]
fn the_adjoint_is_one() {
    for size in [[131, 77], [33, 65], [1, 1]] {
        for projection in projections(size[0], size[1]) {
            for scene in scenes() {
                let map = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
                let x = colours(scene.mean.len(), 11);
                let y = noise(3 * size[0] * size[1], 12);
                let (ax, aty) = (forward(&map, &x, [0.0; 3]), adjoint(&map, &y));
                let (one, other) = (dot(&ax, &y), dot(x.as_flattened(), aty.as_flattened()));
                let scale = (dot(&ax, &ax) * dot(&y, &y)).sqrt().max(1e-30);
                assert!((one - other).abs() <= 1e-6 * scale, "{one} and {other} of {scale}");
            }
        }
    }
}

#[test]
fn normal_has_the_bits_of_the_adjoint_of_the_forward_map() {
    let size = [131, 77];
    for projection in projections(size[0], size[1]) {
        for scene in scenes() {
            let map = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
            let mut x = colours(scene.mean.len(), 13);
            // Magnitudes down to the smallest, of either sign.
            for (i, x) in x.iter_mut().enumerate() {
                *x = x.map(|v| v * [1.0, 1e-38, 1e-44, 1e30][i % 4]);
            }
            let expected = adjoint(&map, &forward(&map, &x, [0.0; 3]));
            assert_same(normal(&map, &x).as_flattened(), expected.as_flattened(), "normal differs");
            let mut rows = vec![f32::NAN; map.gaussians()];
            map.row_sums(&mut rows);
            let ones = normal(&map, &vec![[1.0; 3]; map.gaussians()]);
            assert_same(&rows, &ones.iter().map(|v| v[1]).collect::<Vec<_>>(), "row sums differ");
            let mut columns = vec![[f32::NAN; 2]; map.gaussians()];
            map.column_sums(&mut columns);
            let ones = adjoint(&map, &vec![1.0; 3 * size[0] * size[1]]);
            assert_same(
                &columns.iter().map(|v| v[0]).collect::<Vec<_>>(),
                &ones.iter().map(|v| v[2]).collect::<Vec<_>>(),
                "column sums differ",
            );
        }
    }
}

#[test]
fn sums_agree_with_the_plain_version() {
    let size = [61, 47];
    let pixels = size[0] * size[1];
    for projection in projections(size[0], size[1]) {
        let mut cases = vec![(ordinary(700, false, 14), 1e-5, 1e-4), (ordinary(700, true, 15), 1e-5, 1e-4)];
        cases.extend((0..4).map(|seed| (extreme(60, seed), 5e-4, 5e-3)));
        for (case, (mut scene, tolerance, doubt)) in cases.into_iter().enumerate() {
            // The plain version drops Gaussians whose colour is not finite; the map does not look at it.
            scene.rgb.fill([0.5; 3]);
            let request = everything(size[0], size[1]);
            let (image, weights) = reference::weights(&scene.gaussians(), &projection, &request);
            // Pixels that rounding may decide differently are excluded from the comparison.
            let mut residual = noise(3 * pixels, 17);
            for (at, value) in residual.iter_mut().enumerate() {
                if image.margin[at % pixels] <= doubt {
                    *value = f32::NAN;
                }
            }
            let map = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
            let mut expected = vec![[0.0_f64; 3]; map.gaussians()];
            let mut drawn = vec![0.0_f64; map.gaussians()];
            let mut doubtful = vec![0.0_f64; map.gaussians()];
            let all = weights.iter().zip(units(&weights, size, 0.0)).zip(units(&weights, size, doubt));
            for ((w, unit), larger) in all.filter(|((w, _), _)| image.margin[w.pixel] > doubt) {
                let units = w.weight / unit;
                for c in 0..3 {
                    let stored = (units + 0.5).floor().min(255.0) * unit;
                    expected[w.gaussian][c] += stored * f64::from(residual[c * pixels + w.pixel]);
                }
                drawn[w.gaussian] += 1.0;
                // Weights near a tie: binary32 decides how they are rounded.
                let near = ((units + 0.5) - (units + 0.5).round()).abs() * unit < tolerance;
                doubtful[w.gaussian] += if larger > unit { larger } else { f64::from(u8::from(near)) * unit };
            }
            for (i, found) in adjoint(&map, &residual).iter().enumerate() {
                for c in 0..3 {
                    let error = (f64::from(found[c]) - expected[i][c]).abs();
                    let allowed = tolerance * drawn[i].max(4.0) + doubtful[i];
                    assert!(error <= allowed, "{case}, {i}: {} expected {}", found[c], expected[i][c]);
                }
            }
        }
    }
}

#[test]
fn the_adjoint_of_a_residual_is_that_of_target_less_image() {
    let size = [131, 77];
    let pixels = size[0] * size[1];
    for projection in projections(size[0], size[1]) {
        for scene in scenes() {
            let map = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
            let (colours, background) = (colours(scene.mean.len(), 18), [0.1, 0.2, 0.3]);
            let mut target = noise(3 * pixels, 19);
            target[pixels + 5] = f32::NAN;
            target[7] = f32::INFINITY;
            let image = forward(&map, &colours, background);
            let residual: Vec<f32> = target.iter().zip(&image).map(|(t, i)| t - i).collect();
            let mut sums = vec![[f32::NAN; 3]; map.gaussians()];
            let mut squares = vec![f64::NAN; map.tiles()[0] * map.tiles()[1]];
            let total = map.residual_adjoint_tiles(&colours, background, &target, &mut sums, &mut squares);
            assert_same(sums.as_flattened(), adjoint(&map, &residual).as_flattened(), "sums differ");
            let finite: Vec<f32> = residual.iter().map(|r| if r.is_finite() { *r } else { 0.0 }).collect();
            let expected = dot(&finite, &finite);
            assert!((total - expected).abs() <= 1e-12 * expected, "{total}, expected {expected}");
            assert!(total.to_bits() == squares.iter().fold(0.0, |a, b| a + b).to_bits());
        }
    }
}

#[test]
fn gaussians_that_are_not_finite_have_no_sums_and_change_nothing() {
    let size = [70, 50];
    for projection in projections(size[0], size[1]) {
        let scene = ordinary(300, true, 20);
        let mut spoiled = scene.clone();
        spoiled.push([0.0, f32::NAN, 1.0], [0.5; 3], [1.0, 0.0, 0.0, 0.0], 0.9, [0.0; 3]);
        spoiled.push([0.0, 0.0, 0.5], [0.5, f32::INFINITY, 0.5], [1.0, 0.0, 0.0, 0.0], 0.9, [0.0; 3]);
        spoiled.push([0.0, 0.0, 0.5], [0.5; 3], [1.0, 0.0, 0.0, 0.0], f32::NAN, [0.0; 3]);
        // Colours of the scene are ignored.
        spoiled.rgb.fill([f32::NAN; 3]);
        let residual = noise(3 * size[0] * size[1], 21);
        let clean = adjoint(&map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES), &residual);
        let found = adjoint(&map(Level::detect(), &spoiled, &projection, size, WEIGHT_BYTES), &residual);
        assert_same(found[..300].as_flattened(), clean.as_flattened(), "sums differ");
        assert_eq!(found[300..], [[0.0; 3]; 3]);
    }
}

#[test]
fn huge_residuals_are_summed_and_those_that_are_not_finite_count_as_zero() {
    let size = [70, 50];
    let pixels = size[0] * size[1];
    let scene = ordinary(300, false, 22);
    let map = map(Level::detect(), &scene, &projections(70, 50)[0], size, WEIGHT_BYTES);
    let huge: Vec<f32> = noise(3 * pixels, 23).iter().map(|v| v * 1e30).collect();
    assert!(adjoint(&map, &huge).as_flattened().iter().all(|v| v.is_finite()));
    let (mut bad, mut zero) = (noise(3 * pixels, 24), noise(3 * pixels, 24));
    for (at, value) in [(0, f32::NAN), (77, f32::INFINITY), (pixels, f32::NEG_INFINITY), (3 * pixels - 1, f32::NAN)] {
        (bad[at], zero[at]) = (value, 0.0);
    }
    assert_same(adjoint(&map, &bad).as_flattened(), adjoint(&map, &zero).as_flattened(), "sums differ");
    let (mut bad, mut zero) = (colours(300, 25), colours(300, 25));
    for (at, value) in [(0, f32::NAN), (1, f32::INFINITY), (299, f32::NEG_INFINITY)] {
        (bad[at][at % 3], zero[at][at % 3]) = (value, 0.0);
    }
    assert_same(&forward(&map, &bad, [0.5; 3]), &forward(&map, &zero, [0.5; 3]), "images differ");
}

#[test]
fn blocks_left_out_are_no_part_of_the_map() {
    let size = [131, 77];
    let plane = size[0] * size[1];
    let [width, height] = TILE_PIXELS;
    for projection in projections(size[0], size[1]) {
        let scene = ordinary(3000, true, 26);
        let full = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
        // Every second tile, and of these three blocks in five.
        let odd =
            |x: usize, y: usize| (y / height * full.tiles()[0] + x / width) % 2 == 1 && (x / 4 + 2 * (y / 4)) % 5 < 3;
        let mut part = ColourMap::new(Level::detect());
        part.prepare_blocks(&scene.gaussians(), &projection, size, |[x, y]| odd(4 * x, 4 * y));
        let inside = |at: usize| odd(at % plane % size[0], at % plane / size[0]);
        let (colours, target) = (colours(3000, 27), noise(3 * plane, 28));
        let masked: Vec<f32> = target.iter().enumerate().map(|(i, &v)| if inside(i) { v } else { 0.0 }).collect();
        let (found, expected) = (adjoint(&part, &target), adjoint(&full, &masked));
        // Except sums of zeros.
        assert!(found == expected);
        let mut image = vec![7.0; 3 * plane];
        part.forward(&colours, [0.5; 3], &mut image);
        let whole = forward(&full, &colours, [0.5; 3]);
        for (i, value) in image.iter().enumerate() {
            assert_eq!(*value, if inside(i) { whole[i] } else { 7.0 });
        }
        let mut squares = vec![f64::NAN; part.tiles()[0] * part.tiles()[1]];
        part.residual_adjoint_tiles(&colours, [0.5; 3], &target, &mut vec![[0.0; 3]; 3000], &mut squares);
        assert!(squares.iter().enumerate().all(|(tile, &sum)| (sum > 0.0) == (tile % 2 == 1)));
    }
}

#[test]
fn a_map_can_be_prepared_again_for_another_scene_and_size() {
    let mut again = ColourMap::with_budget(Level::detect(), 200_000);
    for (count, size) in [(3000, [131, 77]), (10, [5, 5]), (0, [0, 7]), (2000, [200, 90]), (700, [131, 77])] {
        let (scene, projection) = (ordinary(count, count % 20 == 0, 29), projections(size[0], size[1])[0]);
        again.prepare(&scene.gaussians(), &projection, size);
        let (colours, target) = (colours(count, 30), noise(3 * size[0] * size[1], 31));
        let fresh = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
        assert!(everything_of(&again, &colours, &target) == everything_of(&fresh, &colours, &target));
    }
    let empty = ColourMap::new(Level::detect());
    assert!(normal(&empty, &[]).is_empty() && forward(&empty, &[], [0.5; 3]).is_empty());
}

/// Three views of some Gaussians: unknowns and factors of each.
struct Views {
    maps: Vec<ColourMap>,
    unknown: Vec<Vec<u32>>,
    factor: Vec<Vec<f32>>,
    frames: Vec<Vec<f32>>,
}

impl Views {
    fn new(level: Level, bytes: usize) -> Self {
        let size = [131, 77];
        let scene = ordinary(9000, false, 21);
        let projection = projections(size[0], size[1])[0];
        let mut views = Self { maps: Vec::new(), unknown: Vec::new(), factor: Vec::new(), frames: Vec::new() };
        for view in 0..3_u32 {
            // Each view lacks different Gaussians and sees the others at different positions.
            let unknown: Vec<u32> = (0..9000).filter(|i| i % 5 != view).collect();
            let of = |v: &[[f32; 3]]| unknown.iter().map(|&i| v[i as usize]).collect::<Vec<_>>();
            let mut part =
                OwnedGaussians { mean: of(&scene.mean), scale: of(&scene.scale), ..OwnedGaussians::default() };
            part.mean.iter_mut().for_each(|mean| mean[0] += 0.02 * view as f32);
            part.opacity = unknown.iter().map(|&i| scene.opacity[i as usize]).collect();
            part.rgb = of(&scene.rgb);
            part.mean[17] = [f32::NAN; 3];
            views.maps.push(map(level, &part, &projection, size, bytes));
            let mut random = Random(30 + u64::from(view));
            let factor = unknown.iter().map(|_| random.range(-1.0, 1.0)).collect();
            views.factor.push(if view == 1 { Vec::new() } else { factor });
            views.unknown.push(unknown);
            views.frames.push(noise(3 * size[0] * size[1], 40 + u64::from(view)));
        }
        views
    }

    fn fit(&self, level: Level) -> ColourFit<'_> {
        let views = (0..3).map(|k| FitView { map: &self.maps[k], unknown: &self.unknown[k], factor: &self.factor[k] });
        ColourFit::new(level, views.collect(), 9000, 1e-3)
    }

    fn solve(&self, level: Level, from: &[[f32; 3]], steps: u32) -> Solution {
        let frames: Vec<&[f32]> = self.frames.iter().map(Vec::as_slice).collect();
        self.fit(level).solve(from, &frames, [0.5; 3], Effort { steps, ..Effort::default() })
    }

    fn factor(&self, k: usize, at: usize) -> f32 {
        self.factor[k].get(at).map_or(1.0, |factor| *factor)
    }

    /// Solution by the steps that [`ColourFit`] documents, operation by operation.
    fn plainly(&self, from: &[[f32; 3]], steps: u32) -> Vec<[f32; 3]> {
        let n = from.len();
        let add = |k: usize, sums: &[[f32; 3]], magnitude: bool, to: &mut [[f32; 3]]| {
            for (at, (&i, sum)) in self.unknown[k].iter().zip(sums).enumerate() {
                let tau = if magnitude { self.factor(k, at).abs() } else { self.factor(k, at) };
                for c in 0..3 {
                    to[i as usize][c] = sum[c].mul_add(tau, to[i as usize][c]);
                }
            }
        };
        let (mut r, mut rows) = (vec![[0.0; 3]; n], vec![[1e-3; 3]; n]);
        for k in 0..3 {
            let colours: Vec<_> = self.unknown[k].iter().map(|&i| from[i as usize]).collect();
            let mut sums = vec![[0.0; 3]; colours.len()];
            self.maps[k].residual_adjoint(&colours, [0.5; 3], &self.frames[k], &mut sums);
            add(k, &sums, false, &mut r);
            let ones: Vec<_> = (0..colours.len()).map(|at| [self.factor(k, at).abs(); 3]).collect();
            add(k, &normal(&self.maps[k], &ones), true, &mut rows);
        }
        let diagonal: Vec<f32> = rows.iter().map(|row| 1.0 / row[0]).collect();
        let dot = |a: &[[f32; 3]], b: &[[f32; 3]]| -> [f64; 3] {
            std::array::from_fn(|c| {
                let part = |(a, b): (&[[f32; 3]], &[[f32; 3]])| {
                    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + f64::from(a[c]) * f64::from(b[c]))
                };
                a.chunks(4096).zip(b.chunks(4096)).map(part).fold(0.0, |a, b| a + b)
            })
        };
        let scaled = |r: &[[f32; 3]]| r.iter().zip(&diagonal).map(|(r, d)| r.map(|r| r * d)).collect::<Vec<_>>();
        let mut x = vec![[0.0; 3]; n];
        let mut z = scaled(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        for _ in 0..steps {
            let mut q: Vec<[f32; 3]> = p.iter().map(|p| p.map(|p| 1e-3 * p)).collect();
            for k in 0..3 {
                let seen = self.unknown[k].iter().enumerate();
                let colours: Vec<_> = seen.map(|(at, &i)| p[i as usize].map(|p| p * self.factor(k, at))).collect();
                add(k, &normal(&self.maps[k], &colours), false, &mut q);
            }
            let pq = dot(&p, &q);
            for c in 0..3 {
                let a = (rz[c] / pq[c]) as f32;
                for i in 0..n {
                    x[i][c] = p[i][c].mul_add(a, x[i][c]);
                    r[i][c] = q[i][c].mul_add(-a, r[i][c]);
                }
            }
            z = scaled(&r);
            let new = dot(&r, &z);
            for c in 0..3 {
                let ratio = (new[c] / rz[c]) as f32;
                for i in 0..n {
                    p[i][c] = p[i][c].mul_add(ratio, z[i][c]);
                }
            }
            rz = new;
        }
        x
    }
}

#[test]
fn a_fit_is_conjugate_gradients_step_by_step() {
    let views = Views::new(Level::detect(), WEIGHT_BYTES);
    let from = colours(9000, 20);
    for steps in [1, 2, 5] {
        let Solution { change, steps: taken } = views.solve(Level::detect(), &from, steps);
        assert_eq!(taken, steps);
        assert_same(change.as_flattened(), views.plainly(&from, steps).as_flattened(), "a step differs");
    }
    let nothing = views.solve(Level::detect(), &from, 0);
    assert_eq!(nothing, Solution { change: vec![[0.0; 3]; 9000], steps: 0 });
}

#[test]
fn a_fit_has_the_same_bits_for_every_level_thread_count_and_budget() {
    let from = colours(9000, 20);
    let expected = Views::new(Level::scalar(), WEIGHT_BYTES).solve(Level::scalar(), &from, 3);
    for level in crate::testing::levels() {
        for threads in [1, 3] {
            for bytes in [0, 100_000, WEIGHT_BYTES] {
                let found = pool(threads).install(|| Views::new(level, bytes).solve(level, &from, 3));
                assert!(found == expected, "{} with {threads} threads, {bytes} bytes", level.name());
            }
        }
    }
}

#[test]
fn a_fit_lowers_the_error_to_where_its_gradient_is_small() {
    let views = Views::new(Level::detect(), WEIGHT_BYTES);
    let from = colours(9000, 20);
    let error = |change: &[[f32; 3]]| -> f64 {
        let ridge: f64 = change.as_flattened().iter().map(|x| 1e-3 * f64::from(*x) * f64::from(*x)).sum();
        let of = |k: usize| {
            let seen = views.unknown[k].iter().enumerate();
            let colour = |(at, &i): (usize, &u32)| -> [f32; 3] {
                std::array::from_fn(|c| change[i as usize][c].mul_add(views.factor(k, at), from[i as usize][c]))
            };
            let image = forward(&views.maps[k], &seen.map(colour).collect::<Vec<_>>(), [0.5; 3]);
            image.iter().zip(&views.frames[k]).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
        };
        (0..3).map(of).sum::<f64>() + ridge
    };
    let errors: Vec<f64> =
        [0, 1, 2, 4, 8, 16, 32, 64].map(|n| error(&views.solve(Level::detect(), &from, n).change)).to_vec();
    assert!(errors.windows(2).all(|pair| pair[1] < pair[0]), "{errors:?}");
    assert!(errors[7] > 0.995 * errors[6], "{errors:?}");
    // Random frames cannot be reached, random colours are far from the best.
    assert!(errors[7] < 0.8 * errors[0], "{errors:?}");
    // A loose bound ends it early.
    let frames: Vec<&[f32]> = views.frames.iter().map(Vec::as_slice).collect();
    let early =
        views.fit(Level::detect()).solve(&from, &frames, [0.5; 3], Effort { steps: 64, enough: 0.01, close: 0.0 });
    assert!((1..20).contains(&early.steps), "{}", early.steps);
}

#[test]
fn tiles_that_are_close_enough_in_all_views_are_left_out() {
    let size = [131, 77];
    let (scene, projection) = (ordinary(9000, false, 21), projections(size[0], size[1])[0]);
    let from = colours(9000, 51);
    let unknown: Vec<u32> = (0..9000).collect();
    let whole = map(Level::detect(), &scene, &projection, size, WEIGHT_BYTES);
    // The second view misses its frame in one tile by 0.1, the first one nowhere.
    let frame = forward(&whole, &from, [0.5; 3]);
    let tile = |i: usize| i / size[0] % size[1] / TILE_PIXELS[1] * whole.tiles()[0] + i % size[0] / TILE_PIXELS[0];
    let missed: Vec<f32> = frame.iter().enumerate().map(|(i, x)| if tile(i) == 4 { x + 0.1 } else { *x }).collect();
    let frames = [&frame[..], &missed];
    let solve = |map: &ColourMap, level, close| {
        let views = vec![FitView { map, unknown: &unknown, factor: &[] }; 2];
        ColourFit::new(level, views, 9000, 1e-3).solve(
            &from,
            &frames,
            [0.5; 3],
            Effort { steps: 4, enough: 0.0, close },
        )
    };
    let mut part = ColourMap::new(Level::detect());
    part.prepare_blocks(&scene.gaussians(), &projection, size, |[x, y]| {
        4 * y / TILE_PIXELS[1] * whole.tiles()[0] + 4 * x / TILE_PIXELS[0] == 4
    });
    let expected = solve(&part, Level::detect(), 0.0);
    assert!(expected.change.iter().any(|change| *change != [0.0; 3]));
    for level in Level::available() {
        for bytes in [0, WEIGHT_BYTES] {
            let map = map(level, &scene, &projection, size, bytes);
            assert!(solve(&map, level, 0.0099) == expected, "{level}, {bytes} bytes");
        }
    }
    // Where all tiles are close, nothing is done.
    assert_eq!(solve(&whole, Level::detect(), 0.0101), Solution { change: vec![[0.0; 3]; 9000], steps: 0 });
}

#[test]
fn what_is_below_the_least_weight_is_a_constant_of_the_image() {
    let (size, least) = ([131, 77], 1.0 / 64.0);
    for projection in projections(size[0], size[1]) {
        let scene = ordinary(6000, true, 61);
        let prepare = |level, bytes, least| {
            let mut map = ColourMap::with_budget(level, bytes).from_weight(least);
            map.prepare(&scene.gaussians(), &projection, size);
            map
        };
        let [whole, part] = [0.0, least].map(|least| prepare(Level::detect(), WEIGHT_BYTES, least));
        assert!(part.weight_bytes() < whole.weight_bytes() * 4 / 5, "weights are left out");
        // With the colours of the preparation nothing is missing.
        let [expected, found] = [&whole, &part].map(|map| forward(map, &scene.rgb, [0.5; 3]));
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 2e-3, "{found}, expected {expected}");
        }
        // With black colours only B remains, and the map without B is linear.
        let black = forward(&part, &vec![[0.0; 3]; 6000], [0.0; 3]);
        assert!(black.iter().any(|x| *x > 0.01) && black.iter().all(|x| *x < 0.5));
        let (colours, residual) = (colours(6000, 62), noise(3 * size[0] * size[1], 63));
        let linear: Vec<f32> = forward(&part, &colours, [0.0; 3]).iter().zip(&black).map(|(a, b)| a - b).collect();
        let (sides, scale) = (
            [dot(&linear, &residual), dot(colours.as_flattened(), adjoint(&part, &residual).as_flattened())],
            dot(&linear, &linear),
        );
        assert!((sides[0] - sides[1]).abs() < 1e-5 * scale, "{sides:?}");
        let expected = everything_of(&prepare(Level::scalar(), WEIGHT_BYTES, least), &colours, &residual);
        for level in crate::testing::levels() {
            for bytes in [0, 50_000, WEIGHT_BYTES] {
                let found = everything_of(&prepare(level, bytes, least), &colours, &residual);
                assert!(found == expected, "{} with {bytes} bytes", level.name());
            }
        }
    }
}
