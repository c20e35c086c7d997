//! `catheter rig calibrate`: the dialogue around the steps of a calibration.

use std::collections::VecDeque;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail, ensure};
use calibration::step::{Finding, Kind, Step};
use clap::Args;
use model_export::link::message::Request;
use model_export::link::settings::by_name;
use serde::{Deserialize, Serialize};

use super::Which;
use crate::backend::Rig;
use crate::calibrate::{self, Change, Choices, Person, Question};
use crate::cli::Outcome;
use crate::experiment;
use crate::interrupt;
use crate::link::{Client, Hardware, version};
use crate::report::calibration as pages;
use crate::setting_words::shown;
use crate::{output, say};

/// What to calibrate, and who answers.
///
/// Every step says what it will do before it does it, and can be repeated. What it finds is in use for the steps behind it; at the end the changed
/// settings are shown, and saved with --save. On a simulated rig the simulation places the targets and reads the gauge.
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Which steps, in this order: noise, laser, pressure, valve, response; all of them when absent.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = kind)]
    steps: Vec<Kind>,
    /// Distances of the target within the laser's range, mm.
    #[arg(long, value_name = "MM,...", value_delimiter = ',', value_parser = finite)]
    distances_mm: Vec<f64>,
    /// Pressures to compare with the gauge.
    #[arg(long, value_name = "N", default_value_t = Choices::default().pressure_levels as u64, value_parser = clap::value_parser!(u64).range(3..=50))]
    pressure_levels: u64,
    /// How far the pressure may come by the gauge, share of limits.ceiling_bar.
    #[arg(long, value_name = "SHARE", default_value_t = Choices::default().highest_share, value_parser = share)]
    highest_share: f64,
    /// Answers for a script (TOML): `placed_mm` and `gauge_bar`, lists in the order in which they are asked for. Asks nothing else.
    #[arg(long, value_name = "FILE.toml")]
    answers: Option<PathBuf>,
    /// Ask nothing before and after a step.
    #[arg(long)]
    yes: bool,
    /// Write the settings found to the device's flash.
    #[arg(long)]
    save: bool,
    /// Write a page with curves and intervals, to look at and to print.
    #[arg(long, value_name = "FILE.html", value_parser = output::file_argument(".html"))]
    html: Option<PathBuf>,
}

fn kind(text: &str) -> Result<Kind, String> {
    let names: Vec<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
    Kind::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| format!("one of {} is wanted", names.join(", ")))
}

fn finite(text: &str) -> Result<f64, String> {
    text.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| "numbers separated by commas are wanted".to_owned())
}

fn share(text: &str) -> Result<f64, String> {
    finite(text).ok().filter(|share| (0.2..=0.95).contains(share)).ok_or_else(|| "a share from 0.2 to 0.95 is wanted".to_owned())
}

/// Answers from a file.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Answers {
    placed_mm: VecDeque<f64>,
    gauge_bar: VecDeque<f64>,
}

impl Arguments {
    fn choices(&self) -> Choices {
        let default = Choices::default();
        Choices {
            distances_mm: if self.distances_mm.is_empty() { default.distances_mm } else { self.distances_mm.clone() },
            pressure_levels: usize::try_from(self.pressure_levels).unwrap_or(default.pressure_levels),
            highest_share: self.highest_share,
        }
    }

    fn steps(&self) -> Vec<Kind> {
        if self.steps.is_empty() { Kind::ALL.to_vec() } else { self.steps.clone() }
    }

    fn read_answers(&self) -> Result<Option<Answers>> {
        let read = |path: &PathBuf| {
            let text = output::read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
            toml::from_str(&text).with_context(|| path.display().to_string())
        };
        self.answers.as_ref().map(read).transpose()
    }

    /// Checks everything that can be checked without a rig.
    pub fn check(&self, which: &Which) -> Result<()> {
        let outputs: Vec<&Path> = self.html.as_deref().into_iter().chain(which.json.as_deref()).collect();
        let inputs: Vec<PathBuf> = self.answers.iter().chain(&which.flash).chain(&which.hardware).cloned().collect();
        output::refuse_overwriting(&inputs, &outputs)?;
        self.read_answers()?;
        let distances_mm = self.choices().distances_mm;
        ensure!(distances_mm.len() >= 2, "--distances-mm: two distances are wanted at least, three or more for an interval");
        let asks = which.backend.is_board() && self.answers.is_none();
        ensure!(
            !asks || std::io::stdin().is_terminal(),
            "nobody is at the terminal to place targets and read the gauge: --answers FILE.toml"
        );
        Ok(())
    }
}

/// Somebody at the terminal, with a file of answers or a simulation to help.
struct Operator {
    answers: Option<Answers>,
    /// Lines that are typed; nothing where nobody is asked.
    lines: Option<Receiver<String>>,
    /// The question that was asked last.
    asked: Option<Question>,
}

impl Operator {
    fn new(answers: Option<Answers>) -> Self {
        let asks = answers.is_none() && std::io::stdin().is_terminal();
        let lines = asks.then(|| {
            let (sender, receiver) = channel();
            std::thread::spawn(move || {
                for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
            receiver
        });
        Self { answers, lines, asked: None }
    }

    /// What was typed since the last look.
    fn typed(&self) -> Result<Option<String>> {
        match self.lines.as_ref().map(Receiver::try_recv) {
            Some(Ok(line)) => Ok(Some(line.trim().to_owned())),
            Some(Err(TryRecvError::Empty)) => Ok(None),
            Some(Err(TryRecvError::Disconnected)) => bail!("the terminal is gone"),
            None => bail!("nobody is there to be asked; answer with --answers FILE.toml"),
        }
    }

    /// Asks between steps, while the rig is listened to.
    fn choose(&self, prompt: &str, rig: &mut Client<Rig>) -> Result<String> {
        print(prompt);
        loop {
            ensure!(!interrupt::is_requested(), "interrupted");
            if let Some(line) = self.typed()? {
                return Ok(line);
            }
            rig.listen(Duration::from_millis(20))?;
            rig.begin_account();
            if rig.transport().is_simulated() {
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
}

/// A prompt, on standard error: what a command says is its result.
fn print(prompt: &str) {
    let mut stderr = std::io::stderr().lock();
    let _ = write!(stderr, "{prompt} ");
    let _ = stderr.flush();
}

impl Person for Operator {
    fn answer(&mut self, question: &Question, hardware: Option<&mut Hardware>) -> Result<Option<f64>> {
        if let Some(answers) = &mut self.answers {
            let (list, name) = match question {
                Question::Target { .. } => (&mut answers.placed_mm, "placed_mm"),
                Question::Gauge { .. } => (&mut answers.gauge_bar, "gauge_bar"),
            };
            if let Some(answer) = list.pop_front() {
                if let (Question::Target { .. }, Some(hardware)) = (question, hardware) {
                    hardware.place_target(Some(answer));
                }
                return Ok(Some(answer));
            }
            ensure!(hardware.is_some(), "the answers have no more {name}, and another one is asked for: {question:?}");
        }
        if let Some(hardware) = hardware {
            return Ok(Some(match question {
                Question::Target { distance_mm } => {
                    hardware.place_target(Some(*distance_mm));
                    *distance_mm
                }
                // A gauge with three digits.
                Question::Gauge { .. } => (hardware.pressure_bar() * 1e3).round() * 1e-3,
            }));
        }
        if self.asked != Some(*question) {
            self.asked = Some(*question);
            match question {
                Question::Target { distance_mm } => {
                    print(&format!("Place the target at {distance_mm} mm, then Enter; or type the distance it is at, in mm:"));
                }
                Question::Gauge { command_bar } => print(&format!("Asked for {command_bar:.3} bar. Type what the gauge reads, in bar:")),
            }
        }
        let Some(line) = self.typed()? else { return Ok(None) };
        let typed = line.replace(',', ".").parse::<f64>().ok().filter(|value| value.is_finite());
        match (question, typed) {
            (_, Some(value)) => {
                self.asked = None;
                Ok(Some(value))
            }
            (Question::Target { distance_mm }, None) if line.is_empty() => {
                self.asked = None;
                Ok(Some(*distance_mm))
            }
            _ => {
                print("A number is wanted:");
                Ok(None)
            }
        }
    }
}

#[derive(Serialize)]
struct WrittenChange {
    name: &'static str,
    before: String,
    after: String,
}

#[derive(Serialize)]
struct Written<'a> {
    findings: &'a [Finding],
    changes: Vec<WrittenChange>,
    saved: bool,
    /// Highest true pressure of a simulated rig, bar.
    simulated_peak_bar: Option<f64>,
}

/// The dialogue.
pub fn run(arguments: &Arguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    interrupt::watch();
    let mut operator = Operator::new(arguments.read_answers()?);
    let mut findings: Vec<Finding> = Vec::new();
    let mut changes: Vec<Change> = Vec::new();
    let walked = walk(arguments, rig, &mut operator, &mut findings, &mut changes);
    if let Some(hardware) = rig.transport().hardware() {
        hardware.place_target(None);
    }
    changes.retain(|(_, before, after)| before != after);
    let kept = if arguments.save && walked.is_ok() && !changes.is_empty() {
        rig.command(&Request::SettingsSave).context("the settings cannot be saved")?;
        true
    } else {
        set_back(rig, &changes)?;
        false
    };
    walked?;
    finish(arguments, rig, which, &findings, &changes, kept)
}

/// Settings as they were before.
fn set_back(rig: &mut Client<Rig>, changes: &[Change]) -> Result<()> {
    for (name, before, _) in changes.iter().rev() {
        let number = by_name(name).map_or(0, |info| info.number);
        rig.command(&Request::SettingSet { number, value: *before }).context("the settings cannot be set back; `settings revert` does")?;
    }
    Ok(())
}

/// One step after the other.
fn walk(
    arguments: &Arguments,
    rig: &mut Client<Rig>,
    operator: &mut Operator,
    findings: &mut Vec<Finding>,
    changes: &mut Vec<Change>,
) -> Result<()> {
    let asks = operator.lines.is_some() && !arguments.yes;
    let choices = arguments.choices();
    let mut highest_command_bar = None;
    let kinds = arguments.steps();
    for (index, kind) in kinds.iter().enumerate() {
        loop {
            let mut step = Step::new(*kind, &calibrate::plan(rig, &choices, highest_command_bar)?);
            say!("step {} of {}: {}\n{}", index + 1, kinds.len(), kind.name(), step.explanation());
            if asks && operator.choose("[Enter] go, [s] skip:", rig)? == "s" {
                break;
            }
            let found = measure(&mut step, rig, operator).with_context(|| format!("step {}", kind.name()));
            if let Some(hardware) = rig.transport().hardware() {
                hardware.place_target(None);
            }
            let finding = match found {
                Ok(finding) => finding,
                Err(error) if asks && !interrupt::is_requested() => {
                    say!("{error:#}");
                    match operator.choose("[r] repeat, [s] skip, [Enter] end:", rig)?.as_str() {
                        "r" => continue,
                        "s" => break,
                        _ => return Err(error),
                    }
                }
                Err(error) => return Err(error),
            };
            show(&finding);
            if asks {
                match operator.choose("[Enter] take it, [r] repeat, [s] skip:", rig)?.as_str() {
                    "r" => continue,
                    "s" => break,
                    _ => {}
                }
            }
            calibrate::merge(changes, calibrate::apply(rig, &finding)?);
            highest_command_bar = calibrate::highest_command_bar(&step, &finding, highest_command_bar);
            findings.push(finding);
            if asks && *kind == Kind::Laser {
                operator.choose("Take the target away and put the catheter back, then Enter:", rig)?;
            }
            break;
        }
    }
    Ok(())
}

fn measure(step: &mut Step, rig: &mut Client<Rig>, operator: &mut Operator) -> Result<Finding> {
    while let Some(instruction) = step.next() {
        step.take(calibrate::carry_out(rig, &instruction, operator)?)?;
    }
    Ok(step.finding()?)
}

fn show(finding: &Finding) {
    for quantity in &finding.quantities {
        say!("  {:<28} {:>22} {}", quantity.name, pages::figure(&quantity.estimate), quantity.unit);
    }
    finding.warnings.iter().for_each(|warning| say!("  warning: {warning}"));
}

fn finish(
    arguments: &Arguments,
    rig: &mut Client<Rig>,
    which: &Which,
    findings: &[Finding],
    changes: &[Change],
    saved: bool,
) -> Result<Outcome> {
    let text = |name: &str, value| by_name(name).map_or_else(String::new, |info| shown(info, value));
    let changed: Vec<WrittenChange> = changes
        .iter()
        .map(|(name, before, after)| WrittenChange { name, before: text(name, *before), after: text(name, *after) })
        .collect();
    for change in &changed {
        say!("{:<36} {:>12} -> {}", change.name, change.before, change.after);
    }
    if saved {
        which.say_saved();
    } else if !changes.is_empty() {
        say!("Not saved: the settings are as they were. `--save` keeps what is found.");
    }
    let status = experiment::status(rig)?;
    if let Some(path) = &arguments.html {
        let hello = rig.hello();
        let heading = pages::Heading { board: &hello.board, firmware: &version(hello.firmware), date: &today(), saved };
        output::write_atomic(path, pages::page(&heading, findings, changes).as_bytes())?;
        say!("page in {}", path.display());
    }
    let simulated_peak_bar = rig.transport().hardware().map(|hardware| hardware.peak_bar());
    which.write(&Written { findings, changes: changed, saved, simulated_peak_bar })?;
    Ok(if status.first_fault == 0 { Outcome::Success } else { Outcome::CheckFailed })
}

/// The date of the computer's clock, in UTC.
pub(crate) fn today() -> String {
    let seconds = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_secs());
    // Days since 0000-03-01 in eras of 400 years (H. Hinnant, "chrono-compatible low-level date algorithms").
    let days = seconds / 86_400 + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let (month, carry) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    format!("{:04}-{month:02}-{day:02}", year_of_era + era * 400 + carry)
}
