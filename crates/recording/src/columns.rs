//! The meaning of a file's columns: our own names, or a map for foreign files such as `time=t_s,input=voltage_V,output=displacement_um`.

use super::scale::{self, Scale};
use super::{Note, RecordingError, Signal, Subject};

/// The name of a column and what it measures.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnName {
    /// The header as it stands in the file, or without the unit that follows it in parentheses.
    pub header: String,
    /// Quantity, and the unit that is worked in.
    pub signal: Signal,
    /// The unit of the column in the file.
    pub unit: String,
    /// From that unit to the one that is worked in.
    pub scale: Scale,
}

impl ColumnName {
    /// A column whose unit is kept.
    #[must_use]
    pub fn kept(header: &str, signal: Signal) -> Self {
        Self { header: header.to_owned(), unit: signal.unit.clone(), signal, scale: Scale::NONE }
    }
}

/// Which columns of a file play which role.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMap {
    /// The time column; absent where the clock is made from a rate.
    pub time: Option<ColumnName>,
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
    /// Columns that are carried along, with the name of their [`super::ExtraColumn`].
    pub carried: Vec<(String, ColumnName)>,
    /// A column whose value changes where a new recording starts.
    pub recording: Option<String>,
    /// A column that names the group.
    pub group: Option<String>,
    /// Whether this is our own format, in which every column must be a known one.
    pub own: bool,
}

/// Optional columns of our own files.
pub(super) const OPTIONAL: [&str; 12] = [
    "pressure_measured_bar",
    "sequence",
    "temperature_c",
    "session_time_s",
    "reference_mm",
    "estimate_mm",
    "limited",
    // What `rig monitor` writes beside these.
    "set_point",
    "output_bar",
    "pressure_code",
    "laser_code",
    "fault",
];

/// A longer map is none.
const LONGEST_MAP: usize = 2000;
/// The map of our own files, where something else is the default.
const OWN: &str = "own";
/// The roles that a column can play.
const ROLES: &str = "time, input, input2 to input9, output, measured, temperature, session, recording and group";

impl ColumnName {
    /// Goes back to the unit of the file.
    fn keep(&mut self) {
        if !matches!(self.scale, Scale::Line { .. }) {
            self.signal.unit.clone_from(&self.unit);
            self.scale = Scale::NONE;
        }
    }
}

impl ColumnMap {
    /// The map of our own files.
    #[must_use]
    pub fn own() -> Self {
        let name = |signal: Signal| ColumnName::kept(&signal.column(), signal.clone());
        Self {
            time: Some(name(Signal { quantity: "time".into(), unit: "s".into() })),
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
    /// after its last `_`, or the unit stands in parentheses, and that unit is kept. A unit behind a colon is converted into bar, mm or s
    /// where it is one of pressure, length or time: `input=P:kPa`. A calibration stands there too: `output=laser:mA@4..20=0..50mm`. Times
    /// may be in `s`, `ms`, `us`, `ns` or `min`. Roles beside time, input and output: `input2` to `input9`, `measured` (measured pressure), `temperature`,
    /// `session` (time since the session began), `recording` (a new recording starts where its value changes) and `group`. The word `own` is
    /// the map of our own files.
    ///
    /// # Errors
    /// When a role is missing, unknown or given twice, or a name has no unit.
    pub fn parse(text: &str) -> Result<Self, RecordingError> {
        if text.trim() == OWN {
            return Ok(Self::own());
        }
        let problem = |problem: String| RecordingError::Columns { text: text.to_owned(), problem };
        if text.len() > LONGEST_MAP {
            let begin = text.chars().take(40).collect();
            let problem = format!("it goes on for {} bytes, {LONGEST_MAP} are enough for all roles", text.len());
            return Err(RecordingError::Columns { text: begin, problem });
        }
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
            time: time.map(|time| in_seconds("time", time)).transpose().map_err(problem)?,
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
            map.carried.push((format!("pressure_measured_{}", column.signal.unit), column));
        }
        if let Some(column) = named("temperature")? {
            let unit = column.signal.unit.trim_start_matches("deg").trim_start_matches('°').to_lowercase();
            map.carried.push((format!("temperature_{unit}"), column));
        }
        if let Some(column) = named("session")? {
            let column = in_seconds("session", column).map_err(problem)?;
            map.carried.push(("session_time_s".to_owned(), column));
        }
        Ok(map)
    }

    /// The same with every unit but that of time as it is in the file; calibrations stay.
    #[must_use]
    pub fn keeping_units(mut self) -> Self {
        let carried = self.carried.iter_mut().filter(|(name, _)| name != "session_time_s");
        for (name, column) in carried {
            if let Some(quantity) = name.strip_suffix(&format!("_{}", column.signal.unit)) {
                *name = format!("{quantity}_{}", column.unit);
            }
            column.keep();
        }
        [&mut self.input, &mut self.output].into_iter().chain(&mut self.more_inputs).for_each(ColumnName::keep);
        self
    }

    /// Our own format with the columns of a file that has other units of time, pressure or length, such as `time_ms,pressure_kPa`.
    pub(super) fn with_own_units(&self, headers: &[String]) -> Self {
        let mut map = self.clone();
        if !self.own {
            return map;
        }
        let columns = map.time.iter_mut().chain([&mut map.input]).chain(&mut map.more_inputs).chain([&mut map.output]);
        for column in columns.filter(|column| !headers.contains(&column.header)) {
            let other = headers.iter().filter_map(|header| {
                let unit = header.strip_prefix(&format!("{}_", column.signal.quantity))?;
                let (into, scale) = scale::conversion(unit)?;
                (into == column.signal.unit).then(|| (header.clone(), unit.to_owned(), scale))
            });
            let mut other = other.collect::<Vec<_>>();
            // Of two columns of one quantity neither is the one.
            if other.len() == 1
                && let Some((header, unit, scale)) = other.pop()
            {
                (column.header, column.unit, column.scale) = (header, unit, scale);
            }
        }
        map
    }

    /// What is converted, in words.
    pub(super) fn conversions(&self) -> Vec<Note> {
        let carried = self.carried.iter().map(|(_, column)| column);
        let converted = self.main_columns().chain(carried).filter(|column| column.scale != Scale::NONE);
        let note = |column: &ColumnName| {
            let by = if let Scale::Line { from, to } = column.scale {
                format!(" by a calibration: {} {} are {} {}, {} are {}", from[0], column.unit, to[0], column.signal.unit, from[1], to[1])
            } else {
                String::new()
            };
            let text = format!("`{}` is converted from {} into {}{by}.", column.header, column.unit, column.signal.unit);
            Note::new(Subject::Converted, text)
        };
        converted.map(note).collect()
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

/// Quantity and unit of a column by its name, as in [`ColumnMap::parse`]; `role` is what a message calls it. The unit is kept.
///
/// # Errors
/// When the name has no unit.
pub fn signal(role: &str, header: &str) -> Result<Signal, String> {
    column_name(role, header).map(|name| Signal { unit: name.unit, ..name.signal })
}

/// The column behind `role=header`, with its unit.
fn column_name(role: &str, header: &str) -> Result<ColumnName, String> {
    let bracketed = super::header::bracketed(header);
    let colon = header.rsplit_once(':');
    let (header, quantity, unit) = match (colon, bracketed, header.rsplit_once('_')) {
        (Some((name, unit)), _, _) => (name, super::header::bracketed(name).map_or(name, |(plain, _)| plain), unit),
        (None, Some((plain, unit)), _) => (header, plain, unit),
        (None, None, Some((quantity, unit))) => (header, quantity, unit),
        (None, None, None) => return Err(format!("`{header}` has no unit after a `_`; add one as in `{role}={header}:unit`")),
    };
    if quantity.is_empty() || unit.is_empty() {
        return Err(format!("`{header}` lacks a quantity or a unit; say `{role}=name:unit`"));
    }
    if let Some(known) = scale::differs_in_case(unit) {
        return Err(format!(
            "the unit `{unit}` of `{header}` differs from `{known}` in small and capital letters only; say `{role}={header}:{known}`"
        ));
    }
    let kept = ColumnName::kept(header, Signal { quantity: quantity.to_owned(), unit: unit.to_owned() });
    if colon.is_none() {
        return Ok(kept);
    }
    if let Some((own, _)) = unit.split_once('@') {
        let (into, scale) = scale::calibration(unit)?;
        return Ok(ColumnName { unit: own.to_owned(), signal: Signal { unit: into, ..kept.signal }, scale, ..kept });
    }
    // A quantity that is named with its unit loses it: `laser_um:um` becomes `laser` in mm.
    Ok(match scale::conversion(unit).filter(|(into, _)| *into != unit && *into != "s") {
        Some((into, scale)) => {
            let bare = quantity.strip_suffix(unit).and_then(|bare| bare.strip_suffix('_')).filter(|bare| !bare.is_empty());
            let signal = Signal { quantity: bare.unwrap_or(quantity).to_owned(), unit: into.to_owned() };
            ColumnName { signal, scale, ..kept }
        }
        None => kept,
    })
}

/// A column of times, in seconds.
fn in_seconds(role: &str, time: ColumnName) -> Result<ColumnName, String> {
    let unit = time.unit.clone();
    let scale = scale::time(&unit)
        .ok_or_else(|| format!("the time unit `{unit}` is none of s, ms, us, ns, min and h; correct it after `{role}={}:`", time.header))?;
    Ok(ColumnName { signal: Signal { unit: "s".to_owned(), ..time.signal }, scale, ..time })
}
