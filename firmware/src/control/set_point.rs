//! Pressure set-point: the host says what pressure, the limiter says how fast.

use model_export::link::fault::NoticeSet;
use model_export::link::message::{Quantity, Refusal};

use super::law::{Accepted, ControlInputs, ControlLaw, ControlOutput, Demand, SetPoint};

/// Follows the latest pressure set-point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PressureSetPoint;

/// The latest set-point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PressureSetPointState {
    target_bar: f32,
}

impl ControlLaw for PressureSetPoint {
    type State = PressureSetPointState;

    fn start(&self, state: &mut PressureSetPointState, inputs: &ControlInputs<'_>) {
        // A set-point from before the start may be hours old.
        state.target_bar = inputs.output_bar;
    }

    fn accept(&self, state: &mut PressureSetPointState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        match set_point {
            SetPoint::Value(Quantity::Pressure, value) if value.is_finite() => {
                state.target_bar = *value;
                Ok(Accepted::InForce)
            }
            SetPoint::Value(Quantity::Pressure, _) => Err(Refusal::NotFinite),
            _ => Err(Refusal::WrongQuantity),
        }
    }

    fn is_ready(&self, _state: &PressureSetPointState) -> bool {
        true
    }

    fn step(&self, state: &mut PressureSetPointState, _inputs: &ControlInputs<'_>) -> ControlOutput {
        ControlOutput {
            demand: Demand::Pressure(state.target_bar),
            set_point: state.target_bar,
            finished: false,
            notices: NoticeSet::EMPTY,
        }
    }
}
