//! The fixed-point arithmetic of the network, to the bit: whoever implements this gets the same output on every machine.
//!
//! # Notation
//!
//! `Qm.n` is a two's complement integer of `1 + m + n` bits (`i16`, `i32` or `i64`) that stands for its value times `2^-n`; a range of
//! `Q0.15` in the name of a wider type means the value fits there. `>>` is the arithmetic shift (rounds down). `ssat(x, b)` clamps to
//! `-2^(b-1) ..= 2^(b-1) - 1`. `high(p)` is the upper 32 bits of an `i64`, `p >> 32`. `smmulr(a, b) = high(a*b + 2^31)` for two
//! `i32`. All of them are single instructions of the Cortex-M4 (`SSAT`, `SMLAL` and its upper register, `SMMULR`), which is why
//! the formats are what they are.
//!
//! # Formats
//!
//! | quantity | type | format |
//! |---|---|---|
//! | feature | `i16` | Q1.14, saturated |
//! | hidden state of a layer | `i16` | `hidden_fraction` fractional bits, a calibrated power of two, saturated |
//! | weight | `i8` | one scale per row, separate for the input and the recurrent matrix |
//! | accumulator | `i32` | weight times feature or hidden state |
//! | pre-activation `z` | `i32` | Q15.16 |
//! | gates i, f, o, r, u | `i32` | Q0.31 |
//! | activated cell (tanh, hard) | `i32` | Q1.30 |
//! | state, candidate and activated cell (relu) | `i32` | Q1.30 of `2^k`, `k = cell_exponent` |
//! | bias | `i64` | Q15.48 |
//! | dense weight | `i16` | one scale |
//!
//! # One step of a layer, for each unit
//!
//! ```text
//! acc_x = sum_j W_x[r][j] * x[j]        acc_h = sum_j W_h[r][j] * h[j]          exact in i32, any order, old h
//! z_r   = high(bias_r + acc_x * mx_r + acc_h * mh_r)                            for the rows r of every gate; bias_r includes 2^31
//! act(z) = tanh(z) >> k                                                         tanh
//!          ssat(z, 17) << (14 - k)                                              hard
//!          min(max(z, 0), limit >> (14 - k)) << (14 - k)                        relu, limit = cell_limit <= 2^30
//! ```
//!
//! LSTM, with the gates i, f, g, o and `s = hidden_shift`:
//!
//! ```text
//! i, f, o = sigmoid(z)
//! g     = act(z)
//! t     = smmulr(f, c) + smmulr(i, g)                                           Q2.29 of 2^k
//! c     = min(max(t, -limit/2), limit/2 - 1) << 1
//! a     = tanh(c >> (14 - k))                                                   tanh
//!         min(max(c, -2^(30-k)), 2^(30-k) - 1) << k                             hard
//!         max(c, 0)                                                             relu
//! h     = ssat((smmulr(o, a) + 2^(s-1)) >> s, 16)
//! ```
//!
//! GRU, with the gates r, u, n, m. Its hidden state is kept in the wide format of a cell, since 16 bits would swallow the small steps of a
//! slow unit; rows see it in 16:
//!
//! ```text
//! r, u  = sigmoid(z)
//! q     = qadd(z_n, qadd(p, p))        p = smmulr(r, z_m)                       qadd saturates to 32 bits
//! t     = smmulr(u, c) + smmulr(2^31 - 1 - u, act(q))
//! c     = min(max(t, -limit/2), limit/2 - 1) << 1
//! h     = ssat((c + 2^s) >> (s + 1), 16)
//! ```
//!
//! Dense: `h = ssat((act(z) + 2^s) >> (s + 1), 16)`.
//!
//! The next layer's input is this layer's new `h`. The output is `bias + scale * (sum_j w[j] * h[j])`, the sum exact in `i32`, the
//! rest in `f32`.
//!
//! A feature becomes an integer by `x = clamp(feature * 2^14, -32768, 32767)`, then round to nearest, ties to even.
//!
//! # Tables
//!
//! ```text
//! sigmoid: q = ssat(z, 21)   n = (q >> 12) + 256   r = q & 0xfff     -16 to 16 in steps of 1/16
//! tanh:    q = ssat(z, 20)   n = (q >> 11) + 256   r = q & 0x7ff      -8 to  8 in steps of 1/32
//! value = base[n] + ((slope[n] * r) >> 16)
//! ```
//!
//! Between the nodes the curve is a chord, and the nodes are moved by `step^2 / 16` times the second derivative, which halves the
//! largest error of a chord: 2.4e-5 for the sigmoid, 4.7e-5 for the tanh.
//!
//! # Why nothing overflows
//!
//! A row has at most 64 columns, so |acc| <= 64 * 128 * 32768 = 2^28. With |m| <= 2^31 and |bias| <= 2^61 the sum stays below
//! 2^61 + 2 * 2^59 < 2^63, whatever the bytes. f < 1 and |c| <= 2^30 give |t| <= 2^30; so do u and 1 - u. The dense weights satisfy
//! sum |w| <= 65535, so their sum stays below 65535 * 32768 < 2^31. [`crate::blob::decode`] checks what of this depends on the blob.
//!
//! # Example
//! ```
//! use model_export::fixed::{BIAS_FRACTION, BIAS_ROUNDING, CELL_FRACTION, FEATURE_FRACTION, GATE_FRACTION, PRE_ACTIVATION_FRACTION};
//! use model_export::fixed::{MAX_BIAS, MAX_CELL_EXPONENT, MAX_CELL_LIMIT, MAX_DENSE_SUM, MAX_HIDDEN_SHIFT, hidden_fraction};
//! use model_export::fixed::{SEGMENTS, SIGMOID, SIGMOID_STEP_BITS, TANH, TANH_STEP_BITS, Table};
//! use model_export::schema::{Activation, Cell};
//!
//! /// The chord of a table at a pre-activation, as a real number.
//! fn look_up(table: &Table, step_bits: u8, fraction: u8, z: f64) -> f64 {
//!     let z = (z * 2f64.powi(PRE_ACTIVATION_FRACTION.into())) as i32;
//!     let [base, slope] = table[usize::try_from((z >> step_bits) + SEGMENTS as i32 / 2).unwrap()];
//!     let rest = z & ((1 << step_bits) - 1);
//!     f64::from(base + ((i64::from(slope) * i64::from(rest)) >> 16) as i32) * 2f64.powi(-i32::from(fraction))
//! }
//! assert!((look_up(&SIGMOID, SIGMOID_STEP_BITS, GATE_FRACTION, 1.0) - 0.731_059).abs() < 3e-5);
//! assert!((look_up(&TANH, TANH_STEP_BITS, CELL_FRACTION, 0.5) - 0.462_117).abs() < 5e-5);
//!
//! // Feature 2^14, bias 2^48 with the rounding of half a step of 2^-16 in it.
//! assert_eq!((FEATURE_FRACTION, BIAS_FRACTION, BIAS_ROUNDING), (14, 48, 1 << 31));
//! assert!(MAX_BIAS < i64::MAX / 2 && MAX_CELL_LIMIT <= 1 << 30 && i64::from(MAX_DENSE_SUM) * 32_768 < 1 << 31);
//! // A hidden state of tanh with the largest shift is Q0.15; with relu of 2^7 it has seven bits less.
//! assert_eq!(hidden_fraction(Cell::Lstm, Activation::Tanh, 0, MAX_HIDDEN_SHIFT), 15);
//! assert_eq!(hidden_fraction(Cell::Lstm, Activation::Relu, MAX_CELL_EXPONENT, MAX_HIDDEN_SHIFT), 8);
//! ```

use crate::schema::{Activation, Cell};

/// Fractional bits of a feature.
pub const FEATURE_FRACTION: u8 = 14;
/// Fractional bits of a pre-activation.
pub const PRE_ACTIVATION_FRACTION: u8 = 16;
/// Fractional bits of a bias: those of a pre-activation and the 32 below the upper word.
pub const BIAS_FRACTION: u8 = 48;
/// Added to every bias so that taking the upper word rounds to nearest.
pub const BIAS_ROUNDING: i64 = 1 << 31;
/// Largest magnitude of a stored bias.
pub const MAX_BIAS: i64 = 1 << 61;
/// Fractional bits of a gate.
pub const GATE_FRACTION: u8 = 31;
/// Fractional bits of the stored cell state.
pub const CELL_FRACTION: u8 = 30;
/// Largest cell exponent: the cell state stays below 2^7.
pub const MAX_CELL_EXPONENT: u8 = 7;
/// Largest stored cell limit.
pub const MAX_CELL_LIMIT: i32 = 1 << 30;
/// Largest shift to the hidden state.
pub const MAX_HIDDEN_SHIFT: u8 = 14;
/// Largest sum of magnitudes of the dense weights.
pub const MAX_DENSE_SUM: u32 = 65_535;

/// Segments of each table.
pub const SEGMENTS: usize = 512;
/// Fractional bits of `z` below the table index, sigmoid.
pub const SIGMOID_STEP_BITS: u8 = 12;
/// Fractional bits of `z` below the table index, tanh.
pub const TANH_STEP_BITS: u8 = 11;

/// A table of chords: base and slope per segment.
pub type Table = [[i32; 2]; SEGMENTS];

/// Sigmoid, base in Q0.31; -16 to 16.
pub static SIGMOID: Table = table(Curve::Sigmoid);
/// Hyperbolic tangent, base in Q1.30; -8 to 8.
pub static TANH: Table = table(Curve::Tanh);

#[derive(Clone, Copy)]
enum Curve {
    Sigmoid,
    Tanh,
}

/// `e^x` for |x| <= 16 to about 1e-13: a short series near zero, squared ten times.
const fn exponential(x: f64) -> f64 {
    let small = x / 1024.0;
    let (mut sum, mut term, mut order) = (1.0, 1.0, 1.0);
    while order < 9.0 {
        term *= small / order;
        sum += term;
        order += 1.0;
    }
    let mut squarings = 0;
    while squarings < 10 {
        sum *= sum;
        squarings += 1;
    }
    sum
}

/// The node at `x`: the curve minus `step^2 / 16` of its second derivative, as an integer.
const fn node(curve: Curve, x: f64) -> i32 {
    let (value, second, step, one) = match curve {
        Curve::Sigmoid => {
            let y = 1.0 / (1.0 + exponential(-x));
            (y, y * (1.0 - y) * (1.0 - 2.0 * y), 1.0 / 16.0, 2_147_483_648.0)
        }
        Curve::Tanh => {
            let e = exponential(2.0 * x);
            let y = (e - 1.0) / (e + 1.0);
            (y, -2.0 * y * (1.0 - y * y), 1.0 / 32.0, 1_073_741_824.0)
        }
    };
    let scaled = (value - step * step / 16.0 * second) * one;
    // Runs in the compiler, never on the device: |scaled| < 2^31 and the cast truncates what the half has rounded.
    if scaled < 0.0 { (scaled - 0.5) as i32 } else { (scaled + 0.5) as i32 }
}

const fn table(curve: Curve) -> Table {
    let (step, slope_bits) = match curve {
        Curve::Sigmoid => (1.0 / 16.0, 16 - SIGMOID_STEP_BITS),
        Curve::Tanh => (1.0 / 32.0, 16 - TANH_STEP_BITS),
    };
    let mut entries = [[0; 2]; SEGMENTS];
    let mut index = 0;
    let mut x = -256.0 * step;
    while index < SEGMENTS {
        let (here, next) = (node(curve, x), node(curve, x + step));
        entries[index] = [here, (next - here) << slope_bits];
        x += step;
        index += 1;
    }
    entries
}

/// Fractional bits of a layer's hidden state.
///
/// The product of output gate (Q0.31) and activated cell (Q1.30, for relu of `2^k`) has 29 after the upper word is taken, half a state
/// (Q1.30 of `2^k`) as many.
#[must_use]
pub const fn hidden_fraction(cell: Cell, activation: Activation, cell_exponent: u8, hidden_shift: u8) -> i32 {
    let exponent = match (cell, activation) {
        (Cell::Lstm, Activation::Tanh | Activation::Hard) => 0,
        (Cell::Lstm, Activation::Relu) | (Cell::Gru | Cell::Dense(_), _) => cell_exponent as i32,
    };
    29 - hidden_shift as i32 - exponent
}
