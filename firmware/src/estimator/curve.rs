//! What the front end and its stages share: curves, and how far a signal may lie.

use model_export::schema::Curve;

/// Largest magnitude of the normalised input that is believed.
pub const MAX_NORMALISED: f32 = 1000.0;

/// The curve at `sum`.
#[inline]
pub(super) fn bent(curve: &Curve, sum: f32) -> f32 {
    let straight = curve.offset + curve.slope * sum;
    curve.bend_points.iter().zip(&curve.bends).fold(straight, |value, (point, bend)| {
        // Not `f32::max`: one comparison, and the same answer on every target.
        let beyond = sum - point;
        if beyond > 0.0 { value + bend * beyond } else { value }
    })
}
