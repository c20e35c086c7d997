//! The meaning of a file's columns: our own names, or a map for foreign files such as `time=t_s,input=voltage_V,output=displacement_um`.

use super::{RecordingError, Signal};

/// The name of a column and what it measures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnName {
    /// The header as it stands in the file.
    pub header: String,
    /// Quantity and unit.
    pub signal: Signal,
}

/// Which columns of a file are time, input and output.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMap {
    /// The time column.
    pub time: ColumnName,
    /// Seconds in one unit of the time column.
    pub time_unit_s: f64,
    /// The input column.
    pub input: ColumnName,
    /// The output column.
    pub output: ColumnName,
    /// Whether this is our own format, in which every column must be a known one.
    pub own: bool,
}

/// Optional columns of our own files.
pub(super) const OPTIONAL: [&str; 7] =
    ["pressure_measured_bar", "sequence", "temperature_c", "session_time_s", "reference_mm", "estimate_mm", "limited"];

impl ColumnMap {
    /// The map of our own files.
    #[must_use]
    pub fn own() -> Self {
        let name = |signal: Signal| ColumnName { header: signal.column(), signal };
        Self {
            time: name(Signal { quantity: "time".into(), unit: "s".into() }),
            time_unit_s: 1.0,
            input: name(Signal::pressure_bar()),
            output: name(Signal::displacement_mm()),
            own: true,
        }
    }

    /// Reads a map such as `time=t_s,input=voltage_V,output=displacement_um`. Quantity and unit are the parts of the name before and
    /// after its last `_`; a name without a unit gets one as `input=Voltage:V`. Times may be in `s`, `ms`, `us` or `min`.
    ///
    /// # Errors
    /// When a role is missing, unknown or given twice, or a name has no unit.
    pub fn parse(text: &str) -> Result<Self, RecordingError> {
        let problem = |problem: String| RecordingError::Columns { text: text.to_owned(), problem };
        let mut roles: [(&str, Option<ColumnName>); 3] = [("time", None), ("input", None), ("output", None)];
        for part in text.split(',') {
            let (role, header) = part.split_once('=').ok_or_else(|| problem(format!("`{part}` has no `=`")))?;
            let (role, header) = (role.trim(), header.trim());
            let Some((_, slot)) = roles.iter_mut().find(|(name, _)| *name == role) else {
                return Err(problem(format!("`{role}` is none of time, input and output")));
            };
            if slot.is_some() {
                return Err(problem(format!("`{role}` is given twice")));
            }
            let (header, quantity, unit) = match (header.rsplit_once(':'), header.rsplit_once('_')) {
                (Some((name, unit)), _) => (name, name, unit),
                (None, Some((quantity, unit))) => (header, quantity, unit),
                (None, None) => return Err(problem(format!("`{header}` has no unit after a `_`; add one as in `{role}={header}:unit`"))),
            };
            if quantity.is_empty() || unit.is_empty() {
                return Err(problem(format!("`{header}` lacks a quantity or a unit; say `{role}=name:unit`")));
            }
            let signal = Signal { quantity: quantity.to_owned(), unit: unit.to_owned() };
            *slot = Some(ColumnName { header: header.to_owned(), signal });
        }
        let mut take = |index: usize| {
            let (role, slot) = &mut roles[index];
            slot.take().ok_or_else(|| problem(format!("`{role}` is missing")))
        };
        let (time, input, output) = (take(0)?, take(1)?, take(2)?);
        if time.header == input.header || time.header == output.header || input.header == output.header {
            return Err(problem("two roles name the same column".to_owned()));
        }
        let time_unit_s = match time.signal.unit.as_str() {
            "s" => 1.0,
            "ms" => 1e-3,
            "us" => 1e-6,
            "min" => 60.0,
            other => return Err(problem(format!("the time unit `{other}` is none of s, ms, us and min; say `time={}:s`", time.header))),
        };
        Ok(Self { time, time_unit_s, input, output, own: false })
    }
}
