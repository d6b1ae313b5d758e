use super::{FeedForward, block};
use crate::Level;
use crate::gemm::{Epilogue, Precision, Weights, linear};
use crate::norm::{self, Norm};
use crate::testing::{bits, noise, on_every_level_and_thread_count};

#[test]
fn it_is_norm_and_two_products_to_the_bit() {
    // Few rows, and enough for a task to run all stages on its rows; widths that are multiples of no block size.
    for (m, d, width) in [(0, 8, 8), (1, 5, 7), (30, 33, 70), (131, 48, 131), (300, 33, 70)] {
        let (x, w1, w2) = (noise(m * d, 1), noise(width * d, 2), noise(d * width, 3));
        let (scale, shift, b1, b2, gamma) = (noise(d, 4), noise(d, 5), noise(width, 6), noise(d, 7), noise(d, 8));
        for precision in [Precision::F32, Precision::Bf16, Precision::Int8] {
            let expand = Weights::pack_as(Level::detect(), precision, &w1, width, d);
            let contract = Weights::pack_as(Level::detect(), precision, &w2, d, width);
            for (norm, hidden, residual) in [
                (Norm::rms(&scale, 1e-5), Epilogue::new().silu(), Epilogue::new().residual()),
                (
                    Norm::layer(&scale, &shift, 1e-6),
                    Epilogue::new().bias(&b1).gelu(),
                    Epilogue::new().bias(&b2).gamma(&gamma).residual(),
                ),
            ] {
                let layer = FeedForward { norm, expand: &expand, hidden, contract: &contract, residual };
                let out = on_every_level_and_thread_count(m * d, |level, out| {
                    out.copy_from_slice(&x);
                    layer.accumulate(level, out);
                });
                let (level, mut expected) = (Level::detect(), x.clone());
                let (mut normed, mut inner) = (vec![0.0; m * d], vec![0.0; m * width]);
                norm::rows(level, &x, &mut normed, norm);
                linear(level, &normed, m, &expand, &hidden, &mut inner);
                linear(level, &inner, m, &contract, &residual, &mut expected);
                assert!(bits(&out) == bits(&expected), "{m}x{d}x{width}, {precision:?}");
            }
        }
    }
}

#[test]
fn the_sizes_of_the_test_take_both_ways() {
    assert!(30_usize.div_ceil(block(30, 70)) < super::FEWEST);
    assert!(131_usize.div_ceil(block(131, 131)) >= super::FEWEST);
}

#[test]
#[should_panic(expected = "W₂ gives 3 values, expected d = 4")]
fn weights_that_do_not_fit_are_refused() {
    let (expand, contract) =
        (Weights::pack(Level::detect(), &[0.0; 8], 2, 4), Weights::pack(Level::detect(), &[0.0; 6], 3, 2));
    let (hidden, residual) = (Epilogue::new().silu(), Epilogue::new().residual());
    let layer =
        FeedForward { norm: Norm::rms(&[1.0; 4], 1e-5), expand: &expand, hidden, contract: &contract, residual };
    layer.accumulate(Level::detect(), &mut [0.0; 8]);
}
