//! References that ask for more than a model was made from: what the tip does there nobody has measured.

use model_export::blob;
use serde::Serialize;

use crate::control::Reference;
use crate::evaluate::beyond::{Outside, outside};

/// A reference that leaves the range of displacement that a model was made from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Beyond {
    /// What the model is to the controllers.
    pub model: &'static str,
    /// Smallest and largest displacement that it was made from, mm.
    pub range_mm: [f64; 2],
    /// Smallest and largest displacement that the reference asks for, mm.
    pub reference_mm: [f64; 2],
    /// How much of the reference lies outside, and how far.
    #[serde(flatten)]
    pub outside: Outside,
}

/// Whether a reference leaves the range of a model, a blob with displacement as its output or, of an inverse, as its input; `model` is
/// its name for messages. Nothing for bytes that are no such model: the device tells what is wrong with those.
#[must_use]
pub fn beyond(model: &'static str, bytes: &[u8], reference: &Reference) -> Option<Beyond> {
    let wire = blob::decode(bytes).ok()?.model;
    let displacement = [&wire.output, &wire.input].into_iter().find(|channel| channel.unit == "mm")?;
    let range_mm = [displacement.minimum, displacement.maximum].map(f64::from);
    let points = || reference.points_mm.iter().copied();
    let outside = outside((range_mm[0], range_mm[1]), &reference.points_mm)?;
    let reference_mm = [points().fold(f64::INFINITY, f64::min), points().fold(f64::NEG_INFINITY, f64::max)];
    Some(Beyond { model, range_mm, reference_mm, outside })
}

impl Beyond {
    /// A warning, in one sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self { model, range_mm: [low, high], reference_mm: [from, to], outside } = self;
        format!(
            "The reference goes from {from:.2} to {to:.2} mm, {model} was made from {low:.2} to {high:.2} mm: {:.1} % of the reference lies \
             outside, by up to {:.2} mm, and nothing is known there. Record there and fit again, or take a smaller --reach-mm.",
            100.0 * outside.share,
            outside.by
        )
    }
}

#[cfg(test)]
mod tests {
    use model_export::schema::{Channel, FrontEnd, Model};

    use super::*;

    fn blob(input: (&'static str, f32, f32), output: (&'static str, f32, f32)) -> Vec<u8> {
        let channel = |(unit, minimum, maximum)| Channel { quantity: "", unit, offset: 0.0, scale: 1.0, minimum, maximum };
        let front_end = FrontEnd { lag_coefficient: 1.0, ..FrontEnd::default() };
        let (input, output) = (channel(input), channel(output));
        blob::encode(&Model { sample_period_s: 0.02, input, output, front_end, ..Model::default() }).expect("a blob")
    }

    #[test]
    fn a_reference_beyond_the_models_range_is_told_with_both_ranges() {
        let reference = Reference { name: "levels".into(), points_mm: vec![1.0, 2.0, 3.0, 9.0] };
        for bytes in [blob(("bar", 0.0, 2.0), ("mm", 1.0, 5.0)), blob(("mm", 1.0, 5.0), ("bar", 0.0, 2.0))] {
            let found = beyond("the model", &bytes, &reference).expect("9 mm are beyond 5 mm");
            assert_eq!((found.range_mm, found.reference_mm), ([1.0, 5.0], [1.0, 9.0]));
            assert_eq!((found.outside.share, found.outside.by, found.outside.of_range), (0.25, 4.0, 1.0));
            let said = found.sentence();
            assert!(said.contains("1.00 to 9.00 mm") && said.contains("1.00 to 5.00 mm") && said.contains("25.0 %"), "{said}");
        }
        assert_eq!(beyond("the model", &blob(("bar", 0.0, 2.0), ("mm", 1.0, 9.0)), &reference), None);
        // Displacement, not pressure, is what a reference asks for.
        assert_eq!(beyond("the model", &blob(("bar", 0.0, 2.0), ("mm", 0.0, 20.0)), &reference), None);
        assert_eq!(beyond("the model", b"no blob", &reference), None);
    }
}
