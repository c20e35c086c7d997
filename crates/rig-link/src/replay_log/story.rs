//! What a rig did and why, out of a replay: its turning points, and everything that was in force at one moment.

use std::collections::BTreeMap;

use firmware::tick::Insight;
use model_export::link::fault::{Fault, Notice, NoticeSet};
use model_export::link::frame::Decoder;
use model_export::link::message::{FaultRecord, Message, Reply, Request, RequestFrame};
use model_export::link::state::{ResetCause, State};
use serde::Serialize;

use super::file::ReplayLog;
use super::replay::{Replay, Step, watch};
use crate::link::{LinkError, fault_in_words, state_name};

/// A whole recording, told.
#[derive(Clone, Debug, Serialize)]
pub struct Story {
    /// Whether it came out as recorded.
    pub replay: Replay,
    /// When the state changed and why.
    pub turnings: Vec<Turning>,
    /// Everything in force at the moment that was asked for.
    pub moment: Option<Moment>,
    /// How long the recording is, s.
    pub duration_s: f64,
}

/// A change of state.
#[derive(Clone, Debug, Serialize)]
pub struct Turning {
    /// When, s since the beginning.
    pub time_s: f64,
    /// From which state.
    pub from: &'static str,
    /// To which state.
    pub to: &'static str,
    /// Why.
    pub cause: Cause,
}

/// Why a state changed.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The host asked for it, by this request.
    Host(String),
    /// A fault struck.
    Fault(String),
    /// The processor started anew.
    Reset(String),
    /// The device did it by itself.
    Own(String),
}

impl Cause {
    /// As the end of a sentence.
    #[must_use]
    pub fn in_words(&self) -> String {
        match self {
            Self::Host(request) => format!("the host sent `{request}`"),
            Self::Fault(fault) => format!("fault {fault}"),
            Self::Reset(cause) => format!("the processor started anew: {cause}"),
            Self::Own(reason) => reason.clone(),
        }
    }
}

/// What was in force at one moment.
#[derive(Clone, Debug, Serialize)]
pub struct Moment {
    /// When, s since the beginning.
    pub time_s: f64,
    /// The state.
    pub state: &'static str,
    /// Since when, s.
    pub state_since_s: f64,
    /// Why the state was that.
    pub state_cause: Option<Cause>,
    /// Whether the dump valve was closed, so that there could be pressure.
    pub energised: bool,
    /// What went to the valve, bar.
    pub output_bar: f64,
    /// What had gone to it 1 ms before, bar.
    pub output_before_bar: f64,
    /// Set-point in force, in the control law's quantity.
    pub set_point: f32,
    /// Where the set-point came from.
    pub set_point_source: String,
    /// Measured pressure, if it was believed.
    pub pressure_bar: Option<f32>,
    /// Measured displacement, if it was believed.
    pub displacement_mm: Option<f32>,
    /// The model's estimate.
    pub estimate_mm: Option<f32>,
    /// What was limited or degraded.
    pub notices: Vec<String>,
    /// First and second fault.
    pub faults: Vec<String>,
    /// The answer in sentences.
    pub why: Vec<String>,
}

/// Runs a replay log again and tells what happened; with a moment in s, what was in force then.
///
/// # Errors
/// When the device cannot be built at all.
pub fn story(replay_log: &ReplayLog, at_s: Option<f64>) -> Result<Story, LinkError> {
    let mut teller = Teller { at_ms: at_s.map(|at_s| (at_s.max(0.0) * 1e3).round() as u64), ..Teller::default() };
    let replay = watch(replay_log, |time_ms, step| teller.see(time_ms, &step))?;
    let duration_s = seconds(teller.time_ms);
    let moment = teller.moment.take();
    Ok(Story { replay, turnings: teller.turnings, moment, duration_s })
}

fn seconds(time_ms: u64) -> f64 {
    time_ms as f64 * 1e-3
}

/// Follows a replay.
#[derive(Default)]
struct Teller {
    at_ms: Option<u64>,
    time_ms: u64,
    decoder: Decoder,
    requests: BTreeMap<u32, (u64, Request)>,
    state: State,
    since_ms: u64,
    cause: Option<Cause>,
    output_ubar: i32,
    set_point: Option<(u64, Request)>,
    /// First index and time of each chunk that was taken.
    chunks: Vec<(u32, u64)>,
    turnings: Vec<Turning>,
    moment: Option<Moment>,
}

impl Teller {
    fn see(&mut self, time_ms: u64, step: &Step<'_>) {
        self.time_ms = time_ms;
        match step {
            Step::Boot { crash, reset_cause } => {
                let cause = match crash {
                    Some(fault) => format!("{} ({})", fault_in_words(fault.number()), fault.explanation().meaning),
                    None => reset_in_words(*reset_cause).to_owned(),
                };
                self.decoder = Decoder::new();
                self.output_ubar = 0;
                self.turn(time_ms, State::Boot, Cause::Reset(cause), time_ms > 0);
            }
            Step::Begin => {
                self.decoder = Decoder::new();
                self.output_ubar = 0;
                let cause = "the trace begins: the device forgot everything but its clock, as at a start".to_owned();
                self.turn(time_ms, State::Boot, Cause::Own(cause), time_ms > 0);
            }
            Step::Silence => {
                if self.wants(time_ms) {
                    self.moment = Some(self.silent_moment(time_ms));
                }
            }
            Step::Tick { from_host, outputs, rig } => {
                let record = rig.supervisor().record();
                from_host.iter().for_each(|byte| self.hear(time_ms, *byte));
                let taken = outputs.answer.as_ref().and_then(|answer| {
                    let request = self.requests.remove(&answer.token)?;
                    Some((request, !matches!(answer.reply, Reply::Refused(_))))
                });
                if let Some((request, true)) = &taken {
                    self.take_set_point(time_ms, request);
                }
                if outputs.state != self.state {
                    let cause = self.cause_of(outputs.state, record, taken.as_ref().map(|((_, request), _)| request));
                    self.turn(time_ms, outputs.state, cause, true);
                }
                if self.wants(time_ms) {
                    let moment = self.moment_of(time_ms, outputs.energised, outputs.output.0, rig.insight(), record);
                    self.moment = Some(moment);
                }
                self.output_ubar = outputs.output.0;
            }
        }
    }

    /// The first step at or after the moment that was asked for.
    fn wants(&self, time_ms: u64) -> bool {
        self.moment.is_none() && self.at_ms.is_some_and(|at_ms| time_ms >= at_ms)
    }

    fn hear(&mut self, time_ms: u64, byte: u8) {
        if let Some(Ok(payload)) = self.decoder.push(byte)
            && let Ok(RequestFrame { token, request, .. }) = RequestFrame::from_payload(payload)
        {
            self.requests.insert(token, (time_ms, request));
        }
    }

    fn take_set_point(&mut self, time_ms: u64, request: &(u64, Request)) {
        match &request.1 {
            Request::SetPoint { .. } => self.set_point = Some(request.clone()),
            Request::Playback(chunk) => {
                if !chunk.values_bar.is_empty() {
                    self.chunks.push((chunk.first_index, time_ms));
                }
                self.set_point = Some(request.clone());
            }
            Request::PlaybackClear => self.chunks.clear(),
            _ => {}
        }
    }

    fn turn(&mut self, time_ms: u64, to: State, cause: Cause, tell: bool) {
        if tell {
            let (from, to) = (state_name(self.state), state_name(to));
            self.turnings.push(Turning { time_s: seconds(time_ms), from, to, cause: cause.clone() });
        }
        self.state = to;
        self.since_ms = time_ms;
        self.cause = Some(cause);
    }

    fn cause_of(&mut self, to: State, record: &FaultRecord, request: Option<&Request>) -> Cause {
        if to == State::Fault {
            return Cause::Fault(fault_in_words(record.first));
        }
        let asked = match request {
            Some(Request::Arm | Request::Disarm | Request::Start | Request::Stop | Request::Acknowledge) => {
                request.map(|r| format!("{r:?}"))
            }
            _ => self.vent_request(to),
        };
        if let Some(request) = asked {
            return Cause::Host(request);
        }
        Cause::Own(
            match (self.state, to) {
                (State::Boot, State::SelfTest) => "the sensors had their time to settle, the self-test began",
                (State::SelfTest, State::Idle) => "the self-test found nothing wrong",
                (State::Idle, State::SelfTest) => "another model was activated and is tested",
                (State::Running, State::Armed) => "the experiment came to its end",
                (State::Armed, State::Idle) => "nobody started in time (arming.timeout_s)",
                _ => "the device did it by itself",
            }
            .to_owned(),
        )
    }

    /// A vent request is answered before the tick that carries it out, so it is found by its kind.
    fn vent_request(&mut self, to: State) -> Option<String> {
        let vented = self.state.is_energised() && !to.is_energised();
        let token = self.requests.iter().find(|(_, (_, request))| *request == Request::Vent).map(|(token, _)| *token)?;
        self.requests.remove(&token);
        vented.then(|| "Vent".to_owned())
    }

    fn silent_moment(&self, time_ms: u64) -> Moment {
        let why = vec![
            "The processor did not do this tick: it hung or had crashed.".to_owned(),
            "Its pins keep their state until the watchdog resets it; in reset they drive nothing, which vents.".to_owned(),
        ];
        Moment {
            time_s: seconds(time_ms),
            state: state_name(self.state),
            state_since_s: seconds(self.since_ms),
            state_cause: self.cause.clone(),
            energised: self.state.is_energised(),
            output_bar: f64::from(self.output_ubar) * 1e-6,
            output_before_bar: f64::from(self.output_ubar) * 1e-6,
            set_point: 0.0,
            set_point_source: "none".to_owned(),
            pressure_bar: None,
            displacement_mm: None,
            estimate_mm: None,
            notices: Vec::new(),
            faults: Vec::new(),
            why,
        }
    }

    fn moment_of(&self, time_ms: u64, energised: bool, output_ubar: i32, insight: Insight, record: &FaultRecord) -> Moment {
        let source = self.source(time_ms, &insight);
        let faults = [record.first, record.second].into_iter().filter(|number| *number != 0).map(fault_in_words).collect();
        Moment {
            time_s: seconds(time_ms),
            state: state_name(self.state),
            state_since_s: seconds(self.since_ms),
            state_cause: self.cause.clone(),
            energised,
            output_bar: f64::from(output_ubar) * 1e-6,
            output_before_bar: f64::from(self.output_ubar) * 1e-6,
            set_point: insight.set_point,
            why: self.sentences(energised, output_ubar, &insight, record, &source),
            set_point_source: source,
            pressure_bar: insight.pressure_bar,
            displacement_mm: insight.displacement_mm,
            estimate_mm: insight.estimate_mm,
            notices: insight.notices.iter().map(|notice| notice.explanation().name.to_owned()).collect(),
            faults,
        }
    }

    /// Where the set-point in force came from.
    fn source(&self, time_ms: u64, insight: &Insight) -> String {
        if self.state != State::Running {
            return "none: not running".to_owned();
        }
        match &self.set_point {
            Some((_, Request::SetPoint { quantity, value })) => {
                let age_ms = insight.host_age_ms;
                format!("the host's set-point {value} ({quantity:?}), {age_ms} ms old")
            }
            Some((_, Request::Playback(_))) if insight.playback_index > 0 => {
                let index = insight.playback_index - 1;
                let chunk = self.chunks.iter().rev().find(|(first, _)| *first <= index);
                match chunk {
                    Some((first, taken_ms)) => {
                        let ago_ms = time_ms - taken_ms;
                        format!("point {index} of the playback, sent with the points from {first} on, {ago_ms} ms before")
                    }
                    None => format!("point {index} of the playback"),
                }
            }
            _ => "the output at the start, held until the first set-point".to_owned(),
        }
    }

    fn sentences(&self, energised: bool, output_ubar: i32, insight: &Insight, record: &FaultRecord, source: &str) -> Vec<String> {
        let mut why = Vec::new();
        let since = seconds(self.since_ms);
        let cause = self.cause.as_ref().map_or_else(|| "the recording began so".to_owned(), Cause::in_words);
        let state = state_name(self.state);
        if energised {
            why.push(format!("The dump valve was closed: `{state}` since {since:.3} s, because {cause}."));
        } else {
            why.push(format!("It was vented: `{state}` since {since:.3} s, because {cause}."));
        }
        if let Some(fault) = Fault::from_number(record.first) {
            let explanation = fault.explanation();
            why.push(format!("{} {}", explanation.meaning, explanation.remedy));
            why.push(format!(
                "When it struck: {:.3} bar measured, {:.3} mm measured, {:.3} bar to the valve.",
                record.pressure_bar,
                record.displacement_mm,
                f64::from(record.output_ubar) * 1e-6
            ));
        }
        if self.state == State::Running {
            let change_ubar = output_ubar - self.output_ubar;
            let verb = match change_ubar {
                1.. => format!("rose by {change_ubar} microbar to"),
                0 => "stayed at".to_owned(),
                _ => format!("fell by {} microbar to", -change_ubar),
            };
            why.push(format!(
                "The output {verb} {:.6} bar; the set-point {} came from {source}.",
                f64::from(output_ubar) * 1e-6,
                insight.set_point
            ));
            if let Some(correction_mm) = insight.correction_mm {
                why.push(format!(
                    "It is the pressure that the feed-forward asks for to bring the tip there; the feedback added {correction_mm:.4} mm."
                ));
            }
            for notice in limiting(insight.notices) {
                why.push(format!("{} {}", notice.explanation().meaning, notice.explanation().remedy));
            }
        }
        why
    }
}

/// What of the notices tells why the output is not what was asked for.
fn limiting(notices: NoticeSet) -> impl Iterator<Item = Notice> {
    notices.iter().filter(|notice| *notice != Notice::EstimateMissing)
}

fn reset_in_words(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::PowerOn => "power came up",
        ResetCause::Pin => "the reset pin was pulled",
        ResetCause::Software => "the firmware asked for it",
        ResetCause::Watchdog => "the watchdog ran out",
        ResetCause::BrownOut => "the supply voltage fell below its limit",
        ResetCause::Unknown | ResetCause::Other(_) => "the hardware does not say why",
    }
}
