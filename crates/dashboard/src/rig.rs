//! What is operated: samples, state and actions of a rig, without a word of how it is reached.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// State of the device; the order is that of the link's numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum Phase {
    /// Starting; vented.
    #[default]
    Boot,
    /// Checking itself; vented.
    SelfTest,
    /// Ready to be armed; vented.
    Idle,
    /// Dump valve closed, output zero.
    Armed,
    /// The output follows the control law.
    Running,
    /// A fault is latched; vented.
    Fault,
}

impl Phase {
    /// All, in the order of their numbers.
    pub(crate) const ALL: [Self; 6] = [Self::Boot, Self::SelfTest, Self::Idle, Self::Armed, Self::Running, Self::Fault];

    /// Whether there can be pressure.
    #[must_use]
    pub const fn is_energised(self) -> bool {
        matches!(self, Self::Armed | Self::Running)
    }
}

/// One millisecond, or as often as the device tells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Counts samples made, dropped ones included.
    pub sequence: u32,
    /// Device time, ms since its start.
    pub time_ms: u64,
    /// State.
    pub phase: Phase,
    /// Number of the first fault, 0 without one.
    pub fault: u8,
    /// What is limited or degraded, a bit each.
    pub notices: u32,
    /// Laser code as sampled.
    pub laser_code: u16,
    /// Pressure code as sampled.
    pub pressure_code: u16,
    /// What went to the valve, filtered like the measured channels, bar.
    pub command_bar: f32,
    /// What goes to the valve at this moment, bar.
    pub output_bar: f32,
    /// Set-point in force, in the control law's quantity.
    pub set_point: f32,
    /// Measured pressure, bar; `None` while not plausible.
    pub pressure_bar: Option<f32>,
    /// Displacement by the laser, mm; `None` while not plausible.
    pub displacement_mm: Option<f32>,
    /// The model's estimate, mm; `None` without one.
    pub estimate_mm: Option<f32>,
    /// Ticks that came late or were lost since the start.
    pub late_ticks: u32,
    /// Longest tick since the start in processor cycles; 0 if not measured.
    pub longest_tick_cycles: u32,
}

/// Who is there.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Identity {
    /// Where the link leads.
    pub place: String,
    /// Name of the board.
    pub board: String,
    /// Version of its firmware.
    pub firmware: String,
    /// The active model, hexadecimal.
    pub model_id: Option<String>,
    /// Whether its time is simulated.
    pub simulated: bool,
    /// What moves the tip of a simulated rig.
    pub plant: Option<String>,
    /// Plants that a simulated rig can be given.
    pub plants: Vec<Entry>,
    /// Faults that can be injected into a simulated rig.
    pub faults: Vec<Entry>,
    /// Cycles of a tick of 1 ms; 0 where cycles are not measured.
    pub cycles_per_tick: u32,
    /// Names and meanings of the notices, by bit.
    pub notices: Vec<Explained>,
    /// Names and meanings of the faults.
    pub fault_table: Vec<Explained>,
}

/// Something to choose.
#[derive(Clone, Debug, Serialize)]
pub struct Entry {
    /// Name, as actions take it.
    pub name: String,
    /// In words.
    pub title: String,
}

/// A fault, blocker or notice in words.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Explained {
    /// As people look it up, `E017`.
    pub id: String,
    /// Its number in its table.
    pub number: u8,
    /// Name in kebab case.
    pub name: String,
    /// What happened.
    pub meaning: String,
    /// What to do.
    pub remedy: String,
}

/// What arrived of the device's samples and what did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Account {
    /// Samples received.
    pub received: u32,
    /// Samples that the device dropped, since the line was full.
    pub dropped_by_device: u32,
    /// Samples lost on the line.
    pub lost_on_the_line: u32,
    /// Damaged frames received.
    pub damaged_frames: u32,
}

/// How far an excitation has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Playing {
    /// Points it has.
    pub points: u32,
    /// Points that the device has confirmed.
    pub sent: u32,
}

/// What the device is and does.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RigState {
    /// State.
    pub phase: Phase,
    /// Faults since the last acknowledgement, the first one first.
    pub faults: Vec<Explained>,
    /// The first fault's circumstances in a sentence.
    pub fault_record: Option<String>,
    /// What would refuse arming now.
    pub blockers: Vec<Explained>,
    /// What is limited or degraded now.
    pub notices: Vec<Explained>,
    /// Device time, ms since its start.
    pub time_ms: u64,
    /// Late or lost ticks since the start.
    pub late_ticks: u32,
    /// Longest tick since the start in cycles; 0 if not measured.
    pub longest_tick_cycles: u32,
    /// Why the device last started.
    pub reset_cause: String,
    /// Whether settings in use differ from the saved ones, those aside that were borrowed for this session.
    pub settings_unsaved: bool,
    /// What the device takes now.
    pub mode: Mode,
    /// Highest pressure that any output asks for, bar.
    pub ceiling_bar: f32,
    /// The device vents when nothing renews its set-point for so long, ms.
    pub host_timeout_ms: u32,
    /// Bound on the error of the estimate, mm.
    pub bound_mm: Option<f32>,
    /// Analogue supply, V.
    pub supply_v: Option<f32>,
    /// Temperature of the chip.
    pub chip_celsius: Option<f32>,
    /// The excitation that is loaded.
    pub playing: Option<Playing>,
    /// What is injected into a simulated rig.
    pub injected: Option<String>,
    /// What moves the tip of a simulated rig.
    pub plant: Option<String>,
    /// Samples that arrived and that did not.
    pub account: Account,
    /// How fast simulated time passes, 1 for real time; `None` on hardware.
    pub speed: Option<f32>,
    /// What runs by itself under the lease.
    pub task: Option<Task>,
    /// Counts what [`Rig::calibration`] and [`Rig::controllers`] would tell anew.
    pub revision: u32,
}

/// What runs by itself under the lease: a step of the calibration, or a reference that is followed. It ends, vented, when the lease does.
#[derive(Clone, Debug, Serialize)]
pub struct Task {
    /// `calibrate` or `follow`.
    pub kind: &'static str,
    /// Which step, or which reference with which controller.
    pub name: String,
    /// What it does now.
    pub does: String,
    /// How far it is, 0 to 1; of a step, how far its present measurement is.
    pub share: f64,
    /// What a person is asked.
    pub asks: Option<Asked>,
}

/// A question to the person at the rig.
#[derive(Clone, Debug, Serialize)]
pub struct Asked {
    /// In words.
    pub text: String,
    /// Unit of the answer.
    pub unit: &'static str,
    /// What the answer is likely to be.
    pub value: Option<f64>,
}

/// What a device is told to follow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// An excitation that is sent ahead.
    Playback,
    /// A pressure, bar.
    #[default]
    Pressure,
    /// A displacement, mm, by the chosen controller.
    Displacement,
}

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Action {
    /// To idle at once, vented; never refused, open to every role.
    Vent,
    /// Idle to armed.
    Arm {
        /// What it shall follow.
        #[serde(default)]
        mode: Mode,
    },
    /// To idle, vented.
    Disarm,
    /// Armed to running.
    Start {
        /// The first set-point; without one that of the last `Hold`. Not for playback.
        #[serde(default)]
        value: Option<f32>,
    },
    /// Running to armed.
    Stop,
    /// Another set-point, bar or mm.
    Hold {
        /// Its value.
        value: f32,
    },
    /// Load an excitation, which `Start` plays.
    Load {
        /// The excitation as its file would have it.
        excitation: Value,
    },
    /// The fault was read and its cause removed.
    Acknowledge,
    /// Change a setting in use.
    Set {
        /// Its name.
        name: String,
        /// Its value.
        value: Value,
    },
    /// Write the settings in use to flash.
    Save,
    /// Go back to the saved settings, or to the defaults.
    Revert {
        /// To the defaults.
        #[serde(default)]
        defaults: bool,
    },
    /// Break something of a simulated rig; nothing mends it.
    Inject {
        /// One of [`Identity::faults`].
        #[serde(default)]
        fault: Option<String>,
    },
    /// Give a simulated rig another plant.
    Plant {
        /// One of [`Identity::plants`].
        name: String,
    },
    /// Begin a step of the calibration, again if it was done.
    Calibrate {
        /// Its name.
        step: String,
    },
    /// Answer what a step asks.
    Answer {
        /// A number in the question's unit.
        value: f64,
    },
    /// Put what the step found into use, unsaved.
    Accept,
    /// Follow a reference from rest, then vent.
    Follow {
        /// Name of a controller.
        controller: String,
        /// As [`Rig::reference`] takes it.
        reference: Value,
    },
    /// Begin a recording.
    Record {
        /// Its name.
        name: String,
        /// What is worth knowing about it.
        #[serde(default)]
        note: String,
    },
    /// End the recording.
    EndRecord,
}

/// A setting, as the page shows it.
#[derive(Clone, Debug, Serialize)]
pub struct Setting {
    /// Dotted name.
    pub name: String,
    /// Unit, empty for flags, counts and choices.
    pub unit: String,
    /// What it does.
    pub meaning: String,
    /// In use.
    pub value: Value,
    /// Saved in flash.
    pub saved: Value,
    /// Of a device nobody has set up.
    pub default: Value,
    /// Smallest allowed.
    pub minimum: Value,
    /// Largest allowed.
    pub maximum: Value,
}

/// What an excitation would play.
#[derive(Clone, Debug, Serialize)]
pub struct Preview {
    /// Sample period, s.
    pub period_s: f64,
    /// Pressures, bar.
    pub pressure_bar: Vec<f64>,
    /// Highest pressure allowed, bar.
    pub ceiling_bar: f64,
    /// Why it may not be played.
    pub problem: Option<String>,
    /// The excitation as a file has it.
    pub file: String,
}

/// Why something was not done.
#[derive(Clone, Debug, thiserror::Error)]
pub enum Problem {
    /// The rig, or what stands before it, said no; the reason with its remedy.
    #[error("{0}")]
    Refused(String),
    /// The rig is gone.
    #[error("{0}")]
    Gone(String),
}

/// A rig that is operated. Every call is made from the session's thread and must return within some milliseconds, unless it says otherwise.
pub trait Rig: Send {
    /// Who is there.
    fn identity(&self) -> Identity;

    /// Lets about `limit` of real time pass and adds the samples that came.
    ///
    /// # Errors
    /// [`Problem::Gone`].
    fn listen(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<(), Problem>;

    /// What the device is and does.
    ///
    /// # Errors
    /// [`Problem::Gone`].
    fn state(&mut self) -> Result<RigState, Problem>;

    /// The operator gave a sign of life: renews the set-point or sends the next points. Nothing else may renew what keeps the device running, except
    /// within [`RENEWAL_WINDOW`] of this call.
    ///
    /// # Errors
    /// [`Problem::Gone`].
    fn renew(&mut self) -> Result<(), Problem>;

    /// Does something; what belongs to recordings never arrives here.
    ///
    /// # Errors
    /// Why not.
    fn act(&mut self, action: &Action) -> Result<(), Problem>;

    /// Every setting.
    ///
    /// # Errors
    /// [`Problem::Gone`].
    fn settings(&mut self) -> Result<Vec<Setting>, Problem>;

    /// What an excitation would play.
    ///
    /// # Errors
    /// When it makes no sense; one beyond the limits has its reason in the preview.
    fn preview(&mut self, excitation: &Value) -> Result<Preview, Problem>;

    /// The operator is gone: vents if there can be pressure, and ends what runs by itself.
    ///
    /// # Errors
    /// [`Problem::Gone`]; then the device vents by itself.
    fn abandon(&mut self, why: &str) -> Result<(), Problem>;

    /// The steps of the calibration: what each will do or has found, and which settings changed.
    ///
    /// # Errors
    /// Why not.
    fn calibration(&mut self) -> Result<Value, Problem>;

    /// The calibration as a page to be printed.
    ///
    /// # Errors
    /// When no step is done.
    fn calibration_page(&mut self) -> Result<String, Problem>;

    /// The controllers and references there are, how far the tip goes, and how the last reference was followed.
    ///
    /// # Errors
    /// Why not.
    fn controllers(&mut self) -> Result<Value, Problem>;

    /// Where the tip would have to go: `period_s` and `points_mm` of a reference, and a `note` of how far it goes.
    ///
    /// # Errors
    /// When there is none like this, or the tip does not get there.
    fn reference(&mut self, reference: &Value) -> Result<Value, Problem>;

    /// Uploads a model and activates it; takes as long as it takes, and is only called while the device is vented.
    ///
    /// # Errors
    /// Why not.
    fn upload(&mut self, blob: &[u8]) -> Result<(), Problem>;

    /// Leaves the rig vented and with its settings as they were.
    fn close(&mut self);
}

/// How long after a sign of life further points may follow it: with this, a device is safe within its time-to-live and 50 ms.
pub const RENEWAL_WINDOW: Duration = Duration::from_millis(40);
