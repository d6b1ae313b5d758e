//! Runs every kernel at small shapes, on every level with one thread and with three: for sanitizers and Miri
//! (`tests/checked/run`), and as a first test of a new level. Sizes are those at the ends of vectors, register blocks,
//! tiles and tasks. The kernels' own tests check values; here levels and threads must agree.

#![forbid(unsafe_code)]

use streamsplat_kernels::attention::{Rows, Shape, Windows, attend_as, attend_some};
use streamsplat_kernels::change::{Tolerance, moved};
use streamsplat_kernels::exposure::Exposure;
use streamsplat_kernels::feed_forward::FeedForward;
use streamsplat_kernels::flow::{self, Blend, Field, Options, Pyramid};
use streamsplat_kernels::gemm::{Activation, Epilogue, Input, Precision, Weights, linear};
use streamsplat_kernels::harmonics::{Eye, Gradients, MAX_DEGREE, adjoint, colours, rest};
use streamsplat_kernels::memory::{Aligned, Scratch};
use streamsplat_kernels::norm::{Norm, layer_norm, rms_norm};
use streamsplat_kernels::parallel::{for_each_chunk, map_indexed};
use streamsplat_kernels::philox::Stream;
use streamsplat_kernels::raster::{
    ColourMap, Defocus, Drawing, Falloff, FootprintGradient, Gaussians, Lists, OwnedGaussians, Projection, Rasteriser,
    Request, WorldGradients, WorldProjection, WorldRasteriser, WorldView, render,
};
use streamsplat_kernels::resize::{Grid, antialiased, bicubic_antialiased, bilinear, bilinear_antialiased};
use streamsplat_kernels::{Level, activation, patches, pointwise, resize, truncated_normal};

const PRECISIONS: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];

/// Values between −1 and 1 that follow from `seed`.
fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut values = vec![0.0; len];
    Stream { seed, frame: 1 }.fill_uniform(0, &mut values);
    values.into_iter().map(|x| 2.0 * x - 1.0).collect()
}

/// Checks that `compute` returns the same bits on every level with one thread and with three.
fn everywhere(what: &str, compute: impl Fn(Level) -> Vec<f32> + Sync) {
    let run = |level, threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| compute(level)).iter().map(|x| x.to_bits()).collect::<Vec<u32>>()
    };
    let expected = run(Level::scalar(), 1);
    for level in Level::available() {
        for threads in [1, 3] {
            assert!(run(level, threads) == expected, "{what}: {level} with {threads} threads differs");
        }
    }
}

/// The sizes, fewer of them under an interpreter.
fn some<T: Copy>(sizes: &[T]) -> &[T] {
    if cfg!(miri) { &sizes[..sizes.len().min(2)] } else { sizes }
}

#[test]
fn products() {
    for &(m, n, k) in
        some(&[(5, 17, 3), (13, 33, 20), (1, 1, 1), (12, 96, 257), (3, 5, 0), (0, 5, 3), (25, 16, 16), (4, 40, 1030)])
    {
        let (x, w, norm) = (noise(m * k, 1), noise(n * k, 2), noise(k, 3));
        let (bias, gamma) = (noise(n, 4), noise(n, 5));
        for precision in PRECISIONS {
            let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
            everywhere("linear", |level| {
                let mut all = Vec::new();
                let plain = Epilogue::new();
                for epilogue in [plain, plain.bias(&bias).gelu().gamma(&gamma), plain.bias(&bias).silu().residual()] {
                    let mut out = vec![0.5; m * n];
                    linear(level, &x, m, &weights, &epilogue, &mut out);
                    all.append(&mut out);
                    if k > 0 {
                        let mut out = vec![0.5; m * n];
                        linear(level, Input::Normed(&x, Norm::rms(&norm, 1e-5)), m, &weights, &epilogue, &mut out);
                        all.append(&mut out);
                    }
                }
                all
            });
        }
    }
}

#[test]
fn products_in_other_layouts() {
    let (m, n, k) = (6, 64, 19);
    let (x, w) = (noise(m * k, 1), noise(n * k, 2));
    for precision in PRECISIONS {
        let weights = Weights::pack_as(Level::detect(), precision, &w, n, k);
        everywhere("layouts", |level| {
            let mut all = Vec::new();
            for epilogue in
                [Epilogue::new().in_groups_of(32), Epilogue::new().shuffled(3), Epilogue::new().shuffled(2).residual()]
            {
                let mut out = vec![0.5; m * n];
                linear(level, &x, m, &weights, &epilogue, &mut out);
                all.append(&mut out);
            }
            all
        });
    }
}

#[test]
fn feed_forward_layers() {
    // Few rows, and enough for a task to take rows through both products.
    for &(m, d, h) in some(&[(3, 16, 20), (90, 5, 7), (100, 16, 33)]) {
        let (x, norm) = (noise(m * d, 1), noise(d, 2));
        let (first, second, bias) = (noise(h * d, 3), noise(d * h, 4), noise(h, 5));
        for precision in PRECISIONS {
            let (expand, contract) = (
                Weights::pack_as(Level::detect(), precision, &first, h, d),
                Weights::pack_as(Level::detect(), precision, &second, d, h),
            );
            everywhere("feed forward", |level| {
                let mut out = x.clone();
                let layer = FeedForward {
                    norm: Norm::layer(&norm, &norm, 1e-6),
                    expand: &expand,
                    hidden: Epilogue::new().bias(&bias).silu(),
                    contract: &contract,
                    residual: Epilogue::new().residual(),
                };
                layer.accumulate(level, &mut out);
                out
            });
        }
    }
}

#[test]
fn narrow_layers() {
    for &(tokens, n, k) in some(&[(5, 3, 7), (50, 9, 20), (48, 8, 300), (200, 17, 4)]) {
        let (x, w, bias) = (noise(tokens * k, 1), noise(n * k, 2), noise(n, 3));
        for activation in [Activation::Identity, Activation::Silu, Activation::Gelu] {
            let layer = pointwise::Layer::pack(&w, Some(&bias), activation, n, k);
            everywhere("pointwise", |level| {
                let mut out = vec![0.5; tokens * n];
                pointwise::for_each_block(&mut out, n, |first, rows| {
                    let (mut from, mut to) = (vec![0.0; k * pointwise::TOKENS], vec![0.0; n * pointwise::TOKENS]);
                    pointwise::load(&x[first * k..][..rows.len() / n * k], k, &mut from);
                    layer.apply(level, &from, &mut to);
                    pointwise::store(&to, n, rows);
                });
                out
            });
        }
    }
}

#[test]
fn attention() {
    let full = Windows::Full;
    let runs = |length, roll| Windows::Runs { length, roll };
    let cases = [
        (2, 16, 5, 5, runs(3, 1)),
        (1, 16, 17, 13, full),
        (1, 64, 3, 1, full),
        (2, 48, 30, 30, runs(12, 7)),
        (1, 16, 70, 400, full),
        (3, 16, 9, 0, full),
        (2, 80, 40, 40, runs(40, 0)),
    ];
    for &(heads, width, queries, keys, windows) in some(&cases) {
        let (shape, d) = (Shape { heads, width, windows }, heads * width);
        let (q, k, v) = (noise(queries * d, 1), noise(keys * d, 2), noise(keys * d, 3));
        let places: Vec<u32> = (0..queries as u32).step_by(2).collect();
        for precision in PRECISIONS {
            everywhere("attention", |level| {
                let mut all = vec![0.5; queries * d];
                let rows = |x, n| Rows::new(x, n, d, 0);
                attend_as(precision, level, shape, rows(&q, queries), rows(&k, keys), rows(&v, keys), &mut all);
                let heads = |x, n| Rows::of_heads(x, n, width, 0);
                let mut out = vec![0.5; queries * d];
                attend_as(precision, level, shape, heads(&q, queries), heads(&k, keys), heads(&v, keys), &mut out);
                all.append(&mut out);
                if queries <= keys {
                    let mut out = vec![0.5; places.len() * d];
                    let asked = &q[..places.len() * d];
                    attend_some(
                        precision,
                        level,
                        shape,
                        &places,
                        rows(asked, places.len()),
                        rows(&k, keys),
                        rows(&v, keys),
                        &mut out,
                    );
                    all.append(&mut out);
                }
                all
            });
        }
    }
}

#[test]
fn norms_and_activations() {
    for &(rows, d) in some(&[(3, 17), (2, 16), (1, 1), (5, 130), (300, 64)]) {
        let (x, w, b) = (noise(rows * d, 1), noise(d, 2), noise(d, 3));
        everywhere("norms", |level| {
            let (mut rms, mut layer) = (vec![0.5; rows * d], vec![0.5; rows * d]);
            rms_norm(level, &x, &w, 1e-5, &mut rms);
            layer_norm(level, &x, &w, &b, 1e-6, &mut layer);
            rms.append(&mut layer);
            for function in
                [activation::silu, activation::gelu, activation::sigmoid, activation::tanh, activation::softplus]
            {
                let mut y = x.clone();
                function(level, &mut y);
                rms.append(&mut y);
            }
            rms
        });
    }
}

#[test]
fn images_of_other_sizes() {
    for &[h, w, to_h, to_w] in some(&[[3, 5, 7, 2], [20, 19, 9, 33], [1, 1, 4, 4], [8, 8, 8, 3], [8, 40, 17, 40]]) {
        let source = noise(3 * h * w, 1);
        everywhere("resize", |level| {
            let mut all = vec![0.5; 3 * to_h * to_w];
            bilinear(level, &source, 3, h, w, to_h, to_w, &mut all);
            let mut out = vec![0.5; 3 * to_h * to_w];
            bilinear_antialiased(level, &source, 3, h, w, to_h, to_w, &mut out);
            all.append(&mut out);
            let mut out = vec![0.5; 3 * to_h * to_w];
            bicubic_antialiased(level, &source, h, w, 3, to_h, to_w, &mut out);
            all.append(&mut out);
            let grid = Grid { outer: 3, height: h, width: w, inner: 1 };
            let mut out = vec![0.5; 3 * to_h * to_w];
            antialiased(level, resize::Filter::Cubic, &source, grid, to_h, to_w, &mut out);
            all.append(&mut out);
            all
        });
    }
    let plane = noise(12 * 6, 2);
    everywhere("patches", |_| {
        let mut out = vec![0.5; 2 * 72];
        patches::patches(&[&plane, &plane], 12, 6, 3, &mut out);
        out
    });
}

#[test]
fn rows_that_moved_and_colours_by_direction() {
    let (rows, d) = (9, 21);
    let (x, mut y) = (noise(rows * d, 1), noise(rows * d, 1));
    y[3 * d] += 0.5;
    let at: Vec<u32> = (0..rows as u32).rev().collect();
    everywhere("change", |level| {
        let mut all = Vec::new();
        for tolerance in [Tolerance::Bits, Tolerance::Relative(0.01)] {
            for at in [None, Some(&at[..])] {
                let mut out = vec![false; rows];
                moved(level, tolerance, d, &x, &y, at, &mut out);
                all.extend(out.into_iter().map(|moved| f32::from(u8::from(moved))));
            }
        }
        all
    });
    for degree in 0..=MAX_DEGREE {
        let n = 19;
        let (base, higher) = (vec![[0.3, -0.2, 0.9]; n], noise(n * 3 * rest(degree), 3));
        let mean: Vec<[f32; 3]> = noise(3 * n, 4).as_chunks().0.to_vec();
        everywhere("harmonics", |level| {
            let mut out = vec![[0.5; 3]; n];
            colours(level, degree, &base, &higher, &mean, Eye::At([0.1, 0.2, -3.0]), &mut out);
            let mut all = out.concat();
            let (mut first, mut others, mut centres) = (vec![[0.0; 3]; n], vec![0.0; higher.len()], vec![[0.0; 3]; n]);
            let to = Gradients { base: &mut first, higher: &mut others, mean: &mut centres };
            let of_eye = adjoint(level, degree, &higher, &mean, Eye::At([0.1, 0.2, -3.0]), &out, &mean, to);
            all.extend([first.concat(), others, centres.concat(), of_eye.map(|of| of as f32).to_vec()].concat());
            colours(level, degree, &base, &higher, &mean, Eye::Along([0.0, 0.0, 1.0]), &mut out);
            all.extend(out.concat());
            all
        });
    }
}

#[test]
fn random_numbers() {
    let (mean, log_scale) = (noise(40, 1), noise(40, 2));
    everywhere("truncated normal", |level| {
        let mut all = vec![0.5; 40];
        truncated_normal::draw(Stream { seed: 1, frame: 2 }, &mean, &log_scale, &mut all);
        let mut out = vec![0.5; 40];
        truncated_normal::sample(&mean, &log_scale, &[0.25; 40], &mut out);
        all.append(&mut out);
        let mut out = vec![0.5; 40];
        truncated_normal::mean(level, &mean, &mut out);
        all.append(&mut out);
        all
    });
}

#[test]
fn optical_flow() {
    for &[h, w] in some(&[[9, 5], [1, 20], [40, 33], [70, 130]]) {
        let area = h * w;
        let picture = |shift: f32| -> Vec<f32> {
            let at = |i: usize| ((i % w) as f32 * 0.4 + shift, (i / w) as f32 * 0.3);
            (0..3 * area).map(|i| at(i % area)).map(|(x, y)| 0.5 + 0.25 * (x.sin() + y.cos())).collect()
        };
        let (a, b) = (picture(0.0), picture(0.4));
        everywhere("flow", |level| {
            let options = Options { refinement: if cfg!(miri) { 1 } else { 3 }, ..Options::default() };
            let pyramid =
                |rgb: &[f32]| Pyramid::new(level, &flow::luma(level, rgb), [h, w], &options).expect("finite frames");
            let (first, second) = (pyramid(&a), pyramid(&b));
            let still = Field::zero([h, w]);
            let [forth, back] = flow::both(level, &first, &second, [Some(&still), None], &options);
            let mut all = forth.then(level, &back).u;
            all.extend(forth.round_trip(level, &back));
            all.extend(flow::warp(level, &b, [h, w], &forth));
            all.extend(Blend::new(level, [&a, &b], [&forth, &back]).at(0.4));
            all.extend(forth.at(0.5, -3.0));
            all
        });
    }
}

/// `n` Gaussians in front of a camera, some of them large, faint, or outside the image.
fn scene(n: usize, rotated: bool) -> OwnedGaussians {
    let mut scene = OwnedGaussians { rotation: rotated.then(Vec::new), ..OwnedGaussians::default() };
    for (i, x) in noise(10 * n, 7).as_chunks::<10>().0.iter().enumerate() {
        let scale = if i % 7 == 0 { 0.8 } else { 0.06 };
        let turn = [0.9, 0.3 * x[3], 0.3 * x[4], 0.3 * x[5]];
        let size = [scale, 0.5 * scale, 0.3 * scale];
        scene.push([1.2 * x[0], 1.2 * x[1], 2.0 + x[2]], size, turn, 0.5 + 0.5 * x[6], [x[7].abs(), x[8].abs(), 0.5]);
    }
    scene
}

const PROJECTIONS: [Projection; 2] =
    [Projection::Orthographic { focal: [20.0; 2] }, Projection::Pinhole { focal: [30.0; 2], centre: [20.0, 12.0] }];

/// Everything that was drawn.
fn planes(image: &streamsplat_kernels::raster::Image) -> Vec<f32> {
    let mut all = image.rgb.clone();
    for plane in [&image.depth, &image.alpha, &image.final_t] {
        all.extend(plane.iter().flatten());
    }
    all.extend(image.blended.iter().flatten().map(|&n| n as f32));
    all
}

#[test]
fn images_of_gaussians() {
    for &(n, width, height) in some(&[(12, 21, 9), (3, 66, 33), (40, 130, 70), (0, 5, 5), (9, 0, 4), (300, 64, 32)]) {
        for rotated in [false, true] {
            let scene = scene(n, rotated);
            for projection in PROJECTIONS {
                everywhere("raster", |level| {
                    let mut request = Request::colour(width, height, [0.1, 0.2, 0.3]);
                    let mut all = planes(&render(level, &scene.gaussians(), &projection, &request));
                    (request.depth, request.alpha, request.statistics) = (true, true, true);
                    let mut rasteriser = Rasteriser::new(level);
                    all.extend(planes(rasteriser.render(&scene.gaussians(), &projection, &request)));
                    // The same scene again, then with some Gaussians changed: tiles are kept.
                    let mut changed = scene.clone();
                    for mean in changed.mean.iter_mut().take(2) {
                        mean[0] += 0.3;
                    }
                    all.extend(planes(rasteriser.render(&scene.gaussians(), &projection, &request)));
                    all.extend(planes(rasteriser.render(&changed.gaussians(), &projection, &request)));
                    let mut lists = Lists::default();
                    rasteriser.lists(&changed.gaussians(), &projection, &request, &mut lists);
                    all.extend(lists.order.iter().map(|&at| at as f32));
                    all.extend(lists.footprints.iter().flat_map(|footprint| footprint.middle));
                    all
                });
            }
        }
    }
}

#[test]
fn images_all_around_through_lenses_and_with_other_footprints() {
    let lens = Some(Defocus { aperture: 0.4, focus: 1.5 });
    for &(n, width, height) in some(&[(12, 21, 9), (40, 130, 70), (0, 5, 5)]) {
        let scene = scene(n, true);
        for falloff in [Falloff::Gaussian, Falloff::SplatTransform] {
            for (projection, defocus) in
                [(Projection::Equirectangular, None), (PROJECTIONS[0], None), (PROJECTIONS[1], lens)]
            {
                everywhere("raster", |level| {
                    let request = Request { falloff, defocus, ..Request::colour(width, height, [0.1, 0.2, 0.3]) };
                    let image = render(level, &scene.gaussians(), &projection, &request);
                    let mut exposure = Exposure::new(level, false);
                    exposure.add(&image);
                    exposure.add(&image);
                    let mut all = planes(&exposure.mean());
                    all.extend(planes(&image));
                    all
                });
            }
        }
    }
}

#[test]
fn images_of_gaussians_in_world_space_and_gradients() {
    for &(n, width, height) in some(&[(12, 21, 9), (3, 66, 33), (40, 130, 70), (0, 5, 5), (9, 0, 4), (300, 64, 32)]) {
        let scene = scene(n, true);
        let gaussians = scene.gaussians();
        let matrix = [[1.0, 0.1, 0.0, 0.0], [-0.1, 1.0, 0.0, 0.1], [0.0, 0.0, 1.0, 0.5]];
        let pinhole = WorldView::pinhole(matrix, [30.0; 2], [20.0, 12.0], [width, height]);
        let flat = WorldView { projection: WorldProjection::Orthographic, antialias: true, ..pinhole };
        for (view, channels) in [(pinhole, 3), (flat, 6), (pinhole, 0)] {
            let (colours, background) = (noise(n * channels, 3), vec![0.25; channels]);
            let drawing = Drawing { channels, colours: &colours, background: &background };
            let (of_image, of_alpha) = (noise(width * height * channels, 4), noise(width * height, 5));
            everywhere("world", |level| {
                let mut rasteriser = WorldRasteriser::new(level);
                rasteriser.project(&gaussians, &view);
                let (mut image, mut alpha) = (vec![0.5; of_image.len()], vec![0.5; of_alpha.len()]);
                rasteriser.draw(&drawing, &mut image, &mut alpha);
                let mut all = [&image[..], &alpha, &rasteriser.projected().opacity].concat();
                let mut footprints = vec![FootprintGradient::default(); n];
                let (mut of_colours, mut of_background) = (vec![0.5; colours.len()], vec![0.5; channels]);
                let (drawn, of) = ([&image[..], &alpha], [&of_image[..], &of_alpha]);
                rasteriser.draw_adjoint(&drawing, drawn, of, &mut footprints, &mut of_colours, &mut of_background);
                let (mut mean, mut rotation) = (vec![[0.0; 3]; n], vec![[0.0; 4]; n]);
                let (mut scale, mut opacity, depth) = (vec![[0.0; 3]; n], vec![0.0; n], noise(n, 6));
                let to = WorldGradients {
                    mean: &mut mean,
                    rotation: &mut rotation,
                    scale: &mut scale,
                    opacity: &mut opacity,
                };
                let view = rasteriser.project_adjoint(&gaussians, &footprints, Some(&depth), to);
                all.extend([of_colours, mean.concat(), rotation.concat(), scale.concat(), opacity].concat());
                all.extend(of_background.iter().chain(view.as_flattened()).map(|&of| of as f32));
                all
            });
        }
    }
}

#[test]
fn colours_as_a_linear_map() {
    for &(n, width, height) in some(&[(12, 21, 9), (40, 130, 70)]) {
        let scene = scene(n, true);
        let unrotated = Gaussians { rotation: None, ..scene.gaussians() };
        let residual = noise(3 * width * height, 9);
        for (gaussians, projection) in [(scene.gaussians(), PROJECTIONS[1]), (unrotated, PROJECTIONS[0])] {
            for budget in [0, usize::MAX] {
                everywhere("colour map", |level| {
                    let mut map = ColourMap::with_budget(level, budget);
                    map.prepare(&gaussians, &projection, [width, height]);
                    let (mut image, mut sums) = (vec![0.0; 3 * width * height], vec![[0.0; 3]; n]);
                    map.forward(gaussians.rgb, [0.1; 3], &mut image);
                    let mut all = image.clone();
                    map.adjoint(&residual, &mut sums);
                    all.extend(sums.as_flattened());
                    map.normal(gaussians.rgb, &mut sums);
                    all.extend(sums.as_flattened());
                    all.push(map.residual_adjoint(gaussians.rgb, [0.1; 3], &residual, &mut sums) as f32);
                    all.extend(sums.as_flattened());
                    let (mut one, mut two) = (vec![0.0; n], vec![[0.0; 2]; n]);
                    map.row_sums(&mut one);
                    map.column_sums(&mut two);
                    all.extend(one);
                    all.extend(two.as_flattened());
                    map.prepare_blocks(&gaussians, &projection, [width, height], |[x, y]| (x + y) % 2 == 0);
                    map.forward(gaussians.rgb, [0.1; 3], &mut image);
                    all.append(&mut image);
                    all
                });
            }
        }
    }
}

#[test]
fn memory_and_loops() {
    let mut memory = Aligned::<u32>::zeroed(17);
    memory[16] = 3;
    memory.resize(40);
    memory.fill(7);
    assert_eq!(memory.iter().sum::<u32>(), 7 * 40);
    let (mut first, mut second) = (Scratch::take(33), Scratch::take(7));
    first.fill(1.0);
    second.fill(2.0);
    drop(first);
    assert_eq!(Scratch::take(20).len(), 20);
    assert!(second.iter().all(|&x| x == 2.0));
    everywhere("loops", |_| {
        let mut data = vec![0.0; 100];
        for_each_chunk(&mut data, 7, |index, chunk| chunk.fill(index as f32));
        data.extend(map_indexed(20, |i| i as f32));
        data
    });
}
