//! What single effects of a file do to a signal, for whoever takes the model to another program.

use crate::chain::columns::{AHEAD, Columns, Rows};
use crate::chain::form::OperatorLaw;
use crate::data::session::Run;
use crate::files::file::DiscoveredModel;
use crate::model::structure::Slot;

impl DiscoveredModel {
    /// The effects with the forms, parameters and weights that the model runs with, whatever version of the file they are from.
    ///
    /// # Errors
    /// When an effect is not known.
    pub fn slots(&self) -> Result<Vec<Slot>, String> {
        Ok(self.build()?.slots)
    }

    /// What the effect of this number makes of a signal, normalised: of the input on its way to the operators, or of their sum without the
    /// constant on its way to the sensor. The recording begins where the session ended, with its input at rest.
    ///
    /// # Errors
    /// When the effect is not known.
    pub fn respond(&self, effect: usize, signal: &[f64]) -> Result<Vec<f64>, String> {
        let slot = self.slots()?.into_iter().nth(effect).ok_or_else(|| format!("it has no effect of the number {effect}"))?;
        let still = vec![0.0; signal.len()];
        let run = Run { input: still.clone(), ..self.run(&vec![signal; 1 + self.others.len()])? };
        let mut answer = signal.to_vec();
        if slot.form.leads_operators() {
            slot.form.input(&slot.parameters, &run, &mut answer);
            return Ok(answer);
        }
        let mut columns = Columns::default();
        columns.begin(1, &still, |Rows { values, stride, .. }| {
            values.chunks_exact_mut(*stride).zip(signal).for_each(|(row, value)| row[AHEAD] = *value);
        });
        slot.form.output(&slot.parameters, &run, signal, &mut columns);
        answer.fill(0.0);
        columns.weigh(&[&[0.0, 1.0], &slot.weights[..]].concat(), 0, &mut answer);
        Ok(answer)
    }

    /// How all effects together let the operators deviate from plain ones, normalised.
    ///
    /// # Errors
    /// When an effect is not known.
    pub fn operator_law(&self) -> Result<OperatorLaw, String> {
        Ok(self.build()?.operator_law())
    }
}
