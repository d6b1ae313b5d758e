//! The formulas of `mod.rs` in binary64, one pixel at a time.

/// A picture or a plane of a field.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Rows.
    pub h: usize,
    /// Columns.
    pub w: usize,
    /// Values, row by row.
    pub values: Vec<f64>,
}

impl Picture {
    /// The value of `f` at every row and column.
    pub fn new([h, w]: [usize; 2], f: impl Fn(isize, isize) -> f64) -> Self {
        let values = (0..h * w).map(|i| f((i / w) as isize, (i % w) as isize)).collect();
        Self { h, w, values }
    }

    /// The value at a row and a column, the border repeated.
    pub fn at(&self, y: isize, x: isize) -> f64 {
        let inside = |at: isize, n: usize| at.clamp(0, n as isize - 1) as usize;
        self.values[inside(y, self.h) * self.w + inside(x, self.w)]
    }

    /// The value between pixels, bilinear, the border repeated.
    pub fn between(&self, y: f64, x: f64) -> f64 {
        let inside = |at: f64, n: usize| at.clamp(0.0, (n - 1) as f64);
        let (y, x) = (inside(y, self.h), inside(x, self.w));
        let (i, j) = (y.floor() as isize, x.floor() as isize);
        let (fy, fx) = (y.fract(), x.fract());
        let row = |i: isize| (1.0 - fx) * self.at(i, j) + fx * self.at(i, j + 1);
        (1.0 - fy) * row(i) + fy * row(i + 1)
    }

    /// Half the difference of the neighbours to the right and left.
    pub fn along_x(&self) -> Self {
        Self::new([self.h, self.w], |y, x| 0.5 * (self.at(y, x + 1) - self.at(y, x - 1)))
    }

    /// Half the difference of the neighbours below and above.
    pub fn along_y(&self) -> Self {
        Self::new([self.h, self.w], |y, x| 0.5 * (self.at(y + 1, x) - self.at(y - 1, x)))
    }

    /// Sobel's derivatives along x and y at a pixel, 0 outside the picture.
    pub fn sobel(&self, y: isize, x: isize) -> [f64; 2] {
        if y < 0 || x < 0 || y >= self.h as isize || x >= self.w as isize {
            return [0.0; 2];
        }
        let sum = |f: &dyn Fn(isize) -> f64| 0.25 * f(-1) + 0.5 * f(0) + 0.25 * f(1);
        let dx = sum(&|i| 0.5 * (self.at(y + i, x + 1) - self.at(y + i, x - 1)));
        let dy = sum(&|i| 0.5 * (self.at(y + 1, x + i) - self.at(y - 1, x + i)));
        [dx, dy]
    }
}

/// Cost and slope of the 8×8 patch of `first` whose first pixel is at row `y`, column `x`, displaced by (u, v).
pub fn patch(first: &Picture, second: &Picture, [y, x]: [isize; 2], [u, v]: [f64; 2]) -> (f64, [f64; 2]) {
    let places: Vec<[isize; 2]> = (0..64).map(|i| [y + i / 8, x + i % 8]).collect();
    let centred = |values: Vec<f64>| {
        let mean = values.iter().sum::<f64>() / 64.0;
        values.into_iter().map(|x| x - mean).collect::<Vec<f64>>()
    };
    let differences =
        centred(places.iter().map(|&[y, x]| second.between(y as f64 + v, x as f64 + u) - first.at(y, x)).collect());
    let slope = [0, 1].map(|k| {
        let gradient = centred(places.iter().map(|&[y, x]| first.sobel(y, x)[k]).collect());
        gradient.iter().zip(&differences).map(|(g, d)| g * d).sum()
    });
    (differences.iter().map(|d| d * d).sum(), slope)
}

/// Flow of every pixel from patches, each a first pixel (row, column) and a displacement.
pub fn densify(first: &Picture, second: &Picture, patches: &[([usize; 2], [f64; 2])]) -> [Picture; 2] {
    let mut sums = vec![[0.0; 3]; first.h * first.w];
    for &([y, x], [u, v]) in patches {
        for i in y..(y + 8).min(first.h) {
            for j in x..(x + 8).min(first.w) {
                let moved = second.between(i as f64 + v, j as f64 + u);
                let weight = 1.0 / (moved - first.at(i as isize, j as isize)).abs().max(1.0);
                let sum = &mut sums[i * first.w + j];
                *sum = [sum[0] + weight, sum[1] + weight * u, sum[2] + weight * v];
            }
        }
    }
    [1, 2].map(|k| Picture { h: first.h, w: first.w, values: sums.iter().map(|sum| sum[k] / sum[0]).collect() })
}

/// Weights of the variational refinement: smoothness, brightness, gradient.
pub type Weights = [f64; 3];

/// `iterations` fixed-point iterations of the refinement of a flow, five red-black steps each.
pub fn refine(
    first: &Picture,
    second: &Picture,
    start: &[Picture; 2],
    [alpha, delta, gamma]: Weights,
    iterations: usize,
) -> [Picture; 2] {
    let size @ [h, w] = [first.h, first.w];
    let [wu, wv] = start;
    let change =
        Picture::new(size, |y, x| second.between(y as f64 + wv.at(y, x), x as f64 + wu.at(y, x)) - first.at(y, x));
    let mean = Picture::new(size, |y, x| first.at(y, x) + 0.5 * change.at(y, x));
    let (dx, dy) = (mean.along_x(), mean.along_y());
    let (xx, xy, yy) = (dx.along_x(), dx.along_y(), dy.along_y());
    let (xz, yz) = (change.along_x(), change.along_y());
    let [mut u, mut v] = start.clone();
    for _ in 0..iterations {
        // Smoothness between a pixel and the next one to the right and below.
        let edge = Picture::new(size, |y, x| {
            let square = |p: &Picture| (p.at(y, x + 1) - p.at(y, x)).powi(2) + (p.at(y + 1, x) - p.at(y, x)).powi(2);
            alpha / (square(&u) + square(&v) + 1e-6).sqrt()
        });
        let terms = |y: isize, x: isize| {
            let at = |p: &Picture| p.at(y, x);
            let (px, py) = (x as f64 + at(wu), y as f64 + at(wv));
            let inside = px >= 0.0 && py >= 0.0 && px <= (w - 1) as f64 && py <= (h - 1) as f64;
            let (du, dv) = (at(&u) - at(wu), at(&v) - at(wv));
            let term = |a: f64, b: f64, c: f64| {
                let length = (a * a + b * b + 0.01).sqrt();
                let scale = if inside { 1.0 / length } else { 0.0 };
                [a * scale, b * scale, c * scale]
            };
            let terms =
                [term(at(&dx), at(&dy), at(&change)), term(at(&xx), at(&xy), at(&xz)), term(at(&xy), at(&yy), at(&yz))];
            let rest = terms.map(|[a, b, c]| a * du + b * dv + c);
            let brightness = delta / (rest[0] * rest[0] + 1e-6).sqrt();
            let slope = gamma / (rest[1] * rest[1] + rest[2] * rest[2] + 1e-6).sqrt();
            (terms, [brightness, slope, slope])
        };
        let systems: Vec<[f64; 5]> = (0..h * w)
            .map(|i| {
                let (y, x) = ((i / w) as isize, (i % w) as isize);
                let (terms, weights) = terms(y, x);
                let mut system = [0.01, 0.0, 0.01, 0.0, 0.0];
                for ([a, b, c], weight) in terms.into_iter().zip(weights) {
                    for (sum, product) in system.iter_mut().zip([a * a, a * b, b * b, -a * c, -b * c]) {
                        *sum += weight * product;
                    }
                }
                system
            })
            .collect();
        for half in 0..10 {
            for y in 0..h {
                for x in 0..w {
                    if (y + x + half) % 2 == 1 {
                        continue;
                    }
                    let (i, j) = (y as isize, x as isize);
                    let mut near = Vec::new();
                    if x > 0 {
                        near.push((edge.at(i, j - 1), i, j - 1));
                    }
                    if x + 1 < w {
                        near.push((edge.at(i, j), i, j + 1));
                    }
                    if y > 0 {
                        near.push((edge.at(i - 1, j), i - 1, j));
                    }
                    if y + 1 < h {
                        near.push((edge.at(i, j), i + 1, j));
                    }
                    let total: f64 = near.iter().map(|n| n.0).sum();
                    let [a11, a12, a22, b1, b2] = systems[y * w + x];
                    let (su, sv) = (wu.at(i, j), wv.at(i, j));
                    let pull = |p: &Picture| near.iter().map(|&(weight, i, j)| weight * p.at(i, j)).sum::<f64>();
                    let k = y * w + x;
                    let goal = (b1 + a11 * su + a12 * sv + pull(&u) - a12 * v.values[k]) / (a11 + total);
                    u.values[k] += 1.6 * (goal - u.values[k]);
                    let goal = (b2 + a12 * su + a22 * sv + pull(&v) - a12 * u.values[k]) / (a22 + total);
                    v.values[k] += 1.6 * (goal - v.values[k]);
                }
            }
        }
    }
    [u, v]
}

/// The picture at time `t` between two of three channels each, from the flow forth and back.
pub fn blend(a: &[Picture; 3], b: &[Picture; 3], [forward, backward]: &[[Picture; 2]; 2], t: f64) -> [Picture; 3] {
    let size @ [h, w] = [a[0].h, a[0].w];
    let outside = |y: f64, x: f64| {
        let beyond = |at: f64, n: usize| (-at).max(at - (n - 1) as f64).max(0.0);
        1.0 + (beyond(y, h).powi(2) + beyond(x, w).powi(2)) / 16.0
    };
    let sources = |own: &[Picture; 3], other: &[Picture; 3], f: &[Picture; 2], t: f64, y: isize, x: isize| {
        let (y, x) = (y as f64, x as f64);
        let motion = |y: f64, x: f64| [f[0].between(y, x), f[1].between(y, x)];
        let [u, v] = motion(y, x);
        let [u, v] = motion(y - t * v, x - t * u);
        let from = [y - t * v, x - t * u];
        let [u, v] = motion(from[0], from[1]);
        let to = [from[0] + v, from[1] + u];
        let off = (from[0] + t * v - y).powi(2) + (from[1] + t * u - x).powi(2);
        let near = [0, 1, 2].map(|k| own[k].between(from[0], from[1]));
        let far = [0, 1, 2].map(|k| other[k].between(to[0], to[1]));
        let unlike = near.iter().zip(&far).map(|(a, b)| (a - b).abs()).sum::<f64>() / 3.0;
        let weight = 1.0 / (1.0 + off / 16.0 + (unlike / 0.3).powi(2));
        let near_weight = (1.0 - t).powi(2) * weight / outside(from[0], from[1]);
        let far_weight = t * (1.0 - t) * weight / outside(to[0], to[1]);
        ([0, 1, 2].map(|k| near_weight * near[k] + far_weight * far[k]), near_weight + far_weight)
    };
    let apart = |y: isize, x: isize, own: &[Picture; 3], other: &[Picture; 3], [u, v]: [f64; 2]| {
        let (row, column) = (y as f64 + v, x as f64 + u);
        own.iter().zip(other).map(|(own, other)| (own.at(y, x) - other.between(row, column)).abs()).sum::<f64>() / 3.0
    };
    let along = |y: isize, x: isize, f: &[Picture; 2]| [f[0].at(y, x), f[1].at(y, x)];
    let moved = Picture::new(size, |y, x| {
        0.5 * (apart(y, x, a, b, along(y, x, forward)) + apart(y, x, b, a, along(y, x, backward)))
    });
    let still = Picture::new(size, |y, x| apart(y, x, a, b, [0.0; 2]));
    let near = |plane: &Picture, y: isize, x: isize| -> f64 {
        (0..15 * 15).map(|i| plane.at(y + i / 15 - 7, x + i % 15 - 7)).sum()
    };
    let still = Picture::new(size, |y, x| {
        let [moved, still] = [&moved, &still].map(|plane| near(plane, y, x).powi(2));
        moved / (moved + still + 1e-12)
    });
    [0, 1, 2].map(|k| {
        Picture::new(size, |y, x| {
            let (first, weight) = sources(a, b, forward, t, y, x);
            let (second, rest) = sources(b, a, backward, 1.0 - t, y, x);
            let (n, mixed) = (still.at(y, x), (1.0 - t) * a[k].at(y, x) + t * b[k].at(y, x));
            (first[k] + second[k] + n * mixed) / (weight + rest + n)
        })
    })
}
