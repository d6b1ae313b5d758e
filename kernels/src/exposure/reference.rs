//! The plain version, in binary64.

/// Display value → linear light.
pub fn decode(c: f64) -> f64 {
    let c = c.max(0.0);
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Linear light → display value.
pub fn encode(c: f64) -> f64 {
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// The mean of display values in linear light.
pub fn mean(values: &[f32]) -> f64 {
    encode(values.iter().map(|c| decode(f64::from(*c))).sum::<f64>() / values.len() as f64)
}

/// The mean of colours that are multiplied by alpha: pairs of both.
pub fn transparent_mean(values: &[[f32; 2]]) -> f64 {
    let alpha = values.iter().map(|[_, a]| f64::from(*a)).sum::<f64>() / values.len() as f64;
    let light = |[c, a]: &[f32; 2]| if *a > 0.0 { f64::from(*a) * decode(f64::from(*c) / f64::from(*a)) } else { 0.0 };
    let sum = values.iter().map(light).sum::<f64>() / values.len() as f64;
    if alpha > 0.0 { alpha * encode(sum / alpha) } else { 0.0 }
}
