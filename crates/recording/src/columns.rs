//! The meaning of a file's columns: our own names, or a map for foreign files such as `time=t_s,input=voltage_V,output=displacement_um`.

use super::{RecordingError, Signal};

/// The name of a column and what it measures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnName {
    /// The header as it stands in the file, or without the unit that follows it in parentheses.
    pub header: String,
    /// Quantity and unit.
    pub signal: Signal,
}

/// Which columns of a file play which role.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMap {
    /// The time column; absent where the clock is made from a rate.
    pub time: Option<ColumnName>,
    /// Seconds in one unit of the time column.
    pub time_unit_s: f64,
    /// The rate that the clock is made from where no time column is read.
    pub rate_hz: Option<f64>,
    /// The time column that a rate takes the place of.
    pub unused_time: Option<String>,
    /// The first input.
    pub input: ColumnName,
    /// The inputs beside the first, in order.
    pub more_inputs: Vec<ColumnName>,
    /// The output column.
    pub output: ColumnName,
    /// Columns that are carried along: name of the [`super::ExtraColumn`], column, and what its values are multiplied by.
    pub carried: Vec<(String, ColumnName, f64)>,
    /// A column whose value changes where a new recording starts.
    pub recording: Option<String>,
    /// A column that names the group.
    pub group: Option<String>,
    /// Whether this is our own format, in which every column must be a known one.
    pub own: bool,
}

/// Optional columns of our own files.
pub(super) const OPTIONAL: [&str; 7] =
    ["pressure_measured_bar", "sequence", "temperature_c", "session_time_s", "reference_mm", "estimate_mm", "limited"];

/// The roles that a column can play.
const ROLES: &str = "time, input, input2 to input9, output, measured, temperature, session, recording and group";

impl ColumnMap {
    /// The map of our own files.
    #[must_use]
    pub fn own() -> Self {
        let name = |signal: Signal| ColumnName { header: signal.column(), signal };
        Self {
            time: Some(name(Signal { quantity: "time".into(), unit: "s".into() })),
            time_unit_s: 1.0,
            rate_hz: None,
            unused_time: None,
            input: name(Signal::pressure_bar()),
            more_inputs: Vec::new(),
            output: name(Signal::displacement_mm()),
            carried: Vec::new(),
            recording: None,
            group: None,
            own: true,
        }
    }

    /// Reads a map such as `time=t_s,input=voltage_V,output=displacement_um`. Quantity and unit are the parts of the name before and
    /// after its last `_`, or the unit stands in parentheses; a name without a unit gets one as `input=Voltage:V`. Times may be in `s`,
    /// `ms`, `us` or `min`. Roles beside time, input and output: `input2` to `input9`, `measured` (measured pressure), `temperature`,
    /// `session` (time since the session began), `recording` (a new recording starts where its value changes) and `group`.
    ///
    /// # Errors
    /// When a role is missing, unknown or given twice, or a name has no unit.
    pub fn parse(text: &str) -> Result<Self, RecordingError> {
        let problem = |problem: String| RecordingError::Columns { text: text.to_owned(), problem };
        let mut roles: Vec<(&str, &str)> = Vec::new();
        for part in text.split(',') {
            let (role, header) = part.split_once('=').ok_or_else(|| problem(format!("`{part}` has no `=`")))?;
            let (role, header) = (role.trim(), header.trim());
            let known = matches!(role, "time" | "input" | "output" | "measured" | "temperature" | "session" | "recording" | "group")
                || further_input(role).is_some();
            if !known {
                return Err(problem(format!("`{role}` is none of {ROLES}")));
            }
            if roles.iter().any(|(given, _)| *given == role) {
                return Err(problem(format!("`{role}` is given twice")));
            }
            if header.is_empty() {
                return Err(problem(format!("`{role}` names no column")));
            }
            roles.push((role, header));
        }
        let of = |wanted: &str| roles.iter().find(|(role, _)| *role == wanted).map(|(_, header)| *header);
        let named = |role: &str| of(role).map(|header| column_name(role, header).map_err(problem)).transpose();
        let needed = |role: &str| named(role)?.ok_or_else(|| problem(format!("`{role}` is missing")));
        let (input, output, time) = (needed("input")?, needed("output")?, named("time")?);
        let mut further: Vec<(usize, &str)> =
            roles.iter().filter_map(|(role, _)| further_input(role).map(|number| (number, *role))).collect();
        further.sort_unstable();
        if let Some((place, (_, role))) = further.iter().enumerate().find(|(place, (number, _))| *number != place + 2) {
            return Err(problem(format!("`{role}` is given without `input{}`", place + 2)));
        }
        let more_inputs = further.iter().map(|(_, role)| needed(role)).collect::<Result<Vec<_>, _>>()?;
        let mut map = Self {
            time_unit_s: time.as_ref().map_or(Ok(1.0), |time| time_unit("time", time).map_err(problem))?,
            time,
            rate_hz: None,
            unused_time: None,
            input,
            more_inputs,
            output,
            carried: Vec::new(),
            recording: of("recording").map(str::to_owned),
            group: of("group").map(str::to_owned),
            own: false,
        };
        map.refuse_doubles().map_err(problem)?;
        if let Some(column) = named("measured")? {
            map.carried.push((format!("pressure_measured_{}", column.signal.unit), column, 1.0));
        }
        if let Some(column) = named("temperature")? {
            let unit = column.signal.unit.trim_start_matches("deg").trim_start_matches('°').to_lowercase();
            map.carried.push((format!("temperature_{unit}"), column, 1.0));
        }
        if let Some(column) = named("session")? {
            let unit_s = time_unit("session", &column).map_err(problem)?;
            map.carried.push(("session_time_s".to_owned(), column, unit_s));
        }
        Ok(map)
    }

    /// No column plays two of the roles of time, inputs and output.
    fn refuse_doubles(&self) -> Result<(), String> {
        let names: Vec<&str> = self.main_columns().map(|name| name.header.as_str()).collect();
        match names.iter().enumerate().any(|(index, name)| names[..index].contains(name)) {
            true => Err("two roles name the same column".to_owned()),
            false => Ok(()),
        }
    }

    /// Time, inputs and output.
    pub(super) fn main_columns(&self) -> impl Iterator<Item = &ColumnName> {
        self.time.iter().chain([&self.input]).chain(&self.more_inputs).chain([&self.output])
    }
}

/// The number of `input2` to `input9`.
fn further_input(role: &str) -> Option<usize> {
    role.strip_prefix("input")
        .filter(|digits| digits.len() == 1)
        .and_then(|digits| digits.parse().ok())
        .filter(|number| (2..10).contains(number))
}

/// Quantity and unit of a column by its name, as in [`ColumnMap::parse`]; `role` is what a message calls it.
///
/// # Errors
/// When the name has no unit.
pub fn signal(role: &str, header: &str) -> Result<Signal, String> {
    column_name(role, header).map(|name| name.signal)
}

/// The column behind `role=header`, with its unit.
fn column_name(role: &str, header: &str) -> Result<ColumnName, String> {
    let bracketed = super::header::bracketed(header);
    let (header, quantity, unit) = match (header.rsplit_once(':'), bracketed, header.rsplit_once('_')) {
        (Some((name, unit)), _, _) => (name, super::header::bracketed(name).map_or(name, |(plain, _)| plain), unit),
        (None, Some((plain, unit)), _) => (header, plain, unit),
        (None, None, Some((quantity, unit))) => (header, quantity, unit),
        (None, None, None) => return Err(format!("`{header}` has no unit after a `_`; add one as in `{role}={header}:unit`")),
    };
    if quantity.is_empty() || unit.is_empty() {
        return Err(format!("`{header}` lacks a quantity or a unit; say `{role}=name:unit`"));
    }
    let signal = Signal { quantity: quantity.to_owned(), unit: unit.to_owned() };
    Ok(ColumnName { header: header.to_owned(), signal })
}

/// Seconds in the unit of a column of times.
fn time_unit(role: &str, time: &ColumnName) -> Result<f64, String> {
    match time.signal.unit.as_str() {
        "s" | "sec" | "second" | "seconds" => Ok(1.0),
        "ms" => Ok(1e-3),
        "us" => Ok(1e-6),
        "min" => Ok(60.0),
        other => Err(format!("the time unit `{other}` is none of s, ms, us and min; say `{role}={}:s`", time.header)),
    }
}
