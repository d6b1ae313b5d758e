//! Opacity windows that become steps.

use streamsplat_model::motion::opacity_at;

use super::{Case, Computed, Judged, Unit};

const GROUP: &str = "Opacity in time";
const STEPS: usize = 1000;
const OPACITY: f32 = 0.7;

/// τ from 0 to 1, and the surroundings of the step.
fn times(gamma1: f32) -> Vec<f32> {
    let even = (0..=STEPS).map(|i| i as f32 / STEPS as f32);
    let near = (-40..=40).map(|i| f32::from_bits(gamma1.to_bits().wrapping_add_signed(i)));
    let mut times: Vec<f32> = even.chain(near).filter(|t| (0.0..=1.0).contains(t)).collect();
    times.sort_unstable_by(f32::total_cmp);
    times
}

/// σ(−γ₀(|τ| − γ₁)) / σ(γ₀γ₁) times the opacity, without overflow.
fn exact([gamma0, gamma1]: [f32; 2], tau: f32) -> f64 {
    let [g0, g1, t] = [gamma0, gamma1, tau.abs()].map(f64::from);
    let x = g0 * (t - g1);
    let fading = if x > 0.0 { (-x).exp() / (1.0 + (-x).exp()) } else { 1.0 / (1.0 + x.exp()) };
    f64::from(OPACITY) * fading * (1.0 + (-g0 * g1).exp())
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for gamma0 in [0.0, 1e-30, 1.0, 87.0, 1e3, 1e6] {
        for gamma1 in [0.0, 0.5, 1.0] {
            let gamma = [gamma0, gamma1];
            let compute = move |place: super::Place| {
                let mut values = Vec::new();
                for tau in times(gamma1).into_iter().flat_map(|t| [t, -t]) {
                    // Enough for every lane; all values are equal.
                    let mut out = [0.0; 17];
                    opacity_at(place.level, &[OPACITY; 17], &[gamma; 17], tau, &mut out);
                    values.extend([out[0], out[16]]);
                }
                Computed::new(&values)
            };
            let judge = move |found: &Computed| {
                let times = times(gamma1);
                let expected = times.iter().flat_map(|t| [exact(gamma, *t); 4]);
                let mut judged = Judged::of(Unit::Absolute, &found.values, expected);
                let mut last = f64::from(OPACITY);
                for (tau, values) in times.iter().zip(found.values.chunks(4)) {
                    judged.demand(values.iter().all(|v| *v == values[0]), || format!("τ = ±{tau}: {values:?}"));
                    judged
                        .demand((0.0..=last).contains(&values[0]), || format!("τ = {tau}: {} after {last}", values[0]));
                    judged.demand(*tau != 0.0 || values[0] == f64::from(OPACITY), || {
                        format!("{} at τ = 0, expected the static opacity {OPACITY}", values[0])
                    });
                    last = values[0];
                }
                judged
            };
            cases.push(Case::new(GROUP, format!("γ₀ = {gamma0:e}, γ₁ = {gamma1}"), compute, judge));
        }
    }
    cases
}
