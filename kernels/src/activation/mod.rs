//! Activation functions over slices: the functions of [`crate::math`], element by element, in place.
//!
//! Each element's result depends on that element alone. NaN returns NaN.

use tracing::debug_span;

use crate::Level;
use crate::math;
use crate::parallel::for_each_chunk;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// Values of a task.
const TASK: usize = 1 << 13;

/// A function of one value.
trait Function: Copy + Send + Sync {
    fn lanes<S: Simd>(s: S, x: S::F32) -> S::F32;
}

struct Task<'a, F>(&'a mut [f32], F);

impl<F: Function> Operation for Task<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for x in self.0.chunks_mut(LANES) {
            s.store_partial(F::lanes(s, s.load_partial(x, 0.0)), x);
        }
    }
}

macro_rules! functions {
    ($($(#[$doc:meta])* $name:ident = $type:ident($lanes:path);)*) => {$(
        #[derive(Clone, Copy)]
        struct $type;
        impl Function for $type {
            #[inline(always)]
            fn lanes<S: Simd>(s: S, x: S::F32) -> S::F32 {
                $lanes(s, x)
            }
        }
        $(#[$doc])*
        pub fn $name(level: Level, x: &mut [f32]) {
            let _span = debug_span!("activation", kind = stringify!($name), values = x.len()).entered();
            for_each_chunk(x, TASK, |_, x| dispatch(level, Task(x, $type)));
        }
    )*};
}

functions! {
    /// `x ← x · σ(x)`
    silu = Silu(math::silu);
    /// `x ← x · Φ(x)`, the exact GELU.
    gelu = Gelu(math::gelu);
    /// `x ← 1 / (1 + e⁻ˣ)`
    sigmoid = Sigmoid(math::sigmoid);
    /// `x ← tanh x`
    tanh = Tanh(math::tanh);
    /// `x ← log(1 + eˣ)`
    softplus = Softplus(math::softplus);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{noise, on_every_level_and_thread_count};

    #[test]
    fn slices_of_any_length_hold_the_functions_everywhere() {
        type Case = (fn(Level, &mut [f32]), fn(f32) -> f32);
        let cases: [Case; 5] = [
            (silu, math::scalar::silu),
            (gelu, math::scalar::gelu),
            (sigmoid, math::scalar::sigmoid),
            (tanh, math::scalar::tanh),
            (softplus, math::scalar::softplus),
        ];
        for (slice, scalar) in cases {
            for len in [0, 1, 17, 20_001] {
                let x: Vec<f32> = noise(len, 9).iter().map(|x| x * 12.0).collect();
                let out = on_every_level_and_thread_count(len, |level, out| {
                    out.copy_from_slice(&x);
                    slice(level, out);
                });
                assert!(out.iter().zip(&x).all(|(y, &x)| y.to_bits() == scalar(x).to_bits()), "{len} values");
            }
        }
    }
}
