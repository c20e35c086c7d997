//! How far one explanation can play another's part on a recording.

use recording::Recording;

use crate::data::session::{Role, Session, SessionError};
use crate::files::file::DiscoveredModel;
use crate::model::initial_state::InitialState;
use crate::model::structure::{Model, Scope};
use crate::search::forms::polish;

/// Evaluations for each parameter.
const EVALUATIONS: usize = 25;

/// What the model leaves of a recording when its parameters and weights are fitted to it anew, root mean square in output units; inside,
/// what is wrong with the model.
///
/// # Errors
/// When there is too little to learn from.
pub fn left_over(pupil: &DiscoveredModel, recording: Recording) -> Result<Result<f64, String>, SessionError> {
    let mut session = Session::new(&[recording], &[])?;
    for run in &mut session.runs {
        run.role.fill(Role::Fit);
    }
    let slots = match pupil.slots_in(&session) {
        Ok(slots) => slots,
        Err(problem) => return Ok(Err(problem)),
    };
    let model = Model { slots, ..Model::baseline(InitialState::Fresh, pupil.stops) };
    let mut fitted = polish(&model, &session, Scope::Fit, EVALUATIONS).model;
    let (square, _) = fitted.fit(&session, Scope::Fit);
    Ok(Ok(square.sqrt() * session.output_scale.abs()))
}
