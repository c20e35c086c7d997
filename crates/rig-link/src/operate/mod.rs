//! A rig that people operate through the dashboard: the link's client behind [`dashboard::Rig`].
//!
//! What keeps a running device running leaves only in [`OperatedRig::renew`] and within [`RENEWAL_WINDOW`] of it, so that a device whose operator is
//! silent is silent for the device too. Settings that a session needs (telemetry at the full rate, the control law, the playback's period) are
//! borrowed: never saved, and set back at its end.

mod borrow;
mod pace;
mod play;
mod simulated;
mod words;

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use dashboard::{Account, Action, Identity, Mode, Phase, Playing, Preview, Problem, RENEWAL_WINDOW, Rig, RigState, Sample, Setting};
use model_export::blob;
use model_export::link::fault::Fault;
use model_export::link::message::{Baseline, Quantity, Request, Status};
use model_export::link::settings::SettingValue;
use model_export::link::state::State;
use serde_json::Value;

pub use pace::Line;

use self::borrow::Borrowed;
use self::pace::Paced;
use self::play::Play;
use crate::device_settings;
use crate::experiment;
use crate::link::{Client, LinkError, Transport, refusal_in_words, version};
use simulation::excitation::{self, ExcitationConfig, Limits};

/// Points that the device has before a start: more than a second at 20 ms.
const POINTS_AHEAD: u32 = 128;
/// How long arming may wait for a blocker that passes by itself.
const PASSING: Duration = Duration::from_millis(500);
/// Longest excitation that is drawn and played from the page: what takes longer to sample would keep heartbeats waiting.
const MOST_POINTS: f64 = 100_000.0;
/// Cycles of a tick at 168 MHz.
const CYCLES_PER_TICK: u32 = 168_000;

/// A rig, opened, with what a session knows of it.
pub struct OperatedRig {
    client: Client<Paced>,
    place: String,
    /// What the command line chose to move the tip.
    given_plant: String,
    plant: Option<String>,
    injected: Option<String>,
    borrowed: Borrowed,
    mode: Mode,
    phase: Phase,
    /// Set-point in the mode's unit.
    set_point: f32,
    play: Option<Play>,
    /// Something more may follow the last sign of life until then.
    window_until: Instant,
    limits: KnownLimits,
    unsaved: bool,
    /// Settings as the operator has them: while the rig is energised none can change, and reading all of them takes longer than heartbeats may wait.
    settings: Vec<Setting>,
    supply: (Option<f32>, Option<f32>),
}

/// Settings that the session needs at hand.
#[derive(Clone, Copy)]
struct KnownLimits {
    ceiling_bar: f32,
    slew_bar_per_s: f32,
    host_timeout_ms: u32,
    estimate_bound_mm: f32,
}

/// A problem as the dashboard tells it; what the device refuses is no reason to give the rig up.
fn problem(error: anyhow::Error) -> Problem {
    match error.downcast_ref::<LinkError>() {
        Some(LinkError::Refused(refusal)) => {
            let context = if error.chain().len() > 1 { format!("{error}: ") } else { String::new() };
            Problem::Refused(format!("{context}{}", refusal_in_words(refusal)))
        }
        Some(_) => Problem::Gone(format!("{error:#}")),
        None => Problem::Refused(format!("{error:#}")),
    }
}

fn gone(error: LinkError) -> Problem {
    problem(error.into())
}

impl OperatedRig {
    /// Meets the device behind a line; `telemetry_ms` is the time from one sample to the next.
    ///
    /// # Errors
    /// When it does not answer, or speaks another protocol.
    pub fn new(line: Line, plant: &str, telemetry_ms: u32) -> Result<Self> {
        let simulated = line.is_simulated();
        let mut client = Client::connect(Paced::new(line))?;
        // A rig that has just been switched on tests itself; one that has run for long is asked once.
        let ready = experiment::settle(&mut client)?;
        let limits = KnownLimits::read(&mut client)?;
        let place = client.transport().place().to_owned();
        let mut rig = Self {
            client,
            place,
            given_plant: plant.to_owned(),
            plant: simulated.then(|| plant.to_owned()),
            injected: None,
            borrowed: Borrowed::default(),
            mode: Mode::default(),
            phase: words::phase(ready.state),
            set_point: 0.0,
            play: None,
            window_until: Instant::now(),
            limits,
            unsaved: false,
            settings: Vec::new(),
            supply: (None, None),
        };
        // Somebody else may have left it armed: then it tells as slowly as it does.
        if !ready.state.is_energised() {
            rig.borrowed.borrow(&mut rig.client, "telemetry.period_ms", SettingValue::Integer(telemetry_ms))?;
            rig.unsaved = rig.borrowed.are_unsaved(&mut rig.client)?;
        }
        rig.settings = rig.borrowed.list(&mut rig.client)?;
        rig.client.begin_account();
        Ok(rig)
    }

    fn send_set_point(&mut self) -> Result<(), LinkError> {
        let quantity = if self.mode == Mode::Displacement { Quantity::Displacement } else { Quantity::Pressure };
        self.client.send(&Request::SetPoint { quantity, value: self.set_point }).map(|_| ())
    }

    fn send_points(&mut self) -> Result<(), LinkError> {
        if let Some(play) = &mut self.play {
            let token = self.client.send(&Request::Playback(play.feed.chunk()))?;
            play.sent(token);
        }
        Ok(())
    }

    fn hear_of_points(&mut self) {
        if let Some(play) = &mut self.play
            && let Some(token) = play.waits_for()
            && let Some(reply) = self.client.take_reply(token)
        {
            play.take(&reply);
        }
    }

    fn listen_to_all(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<(), LinkError> {
        let until = Instant::now() + limit;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if self.client.transport().line().is_simulated() {
                // One nap instead of one for each millisecond.
                std::thread::sleep(left);
                self.client.listen(Duration::ZERO)?;
            } else {
                self.client.listen(left)?;
            }
            self.hear_of_points();
            let more = self.play.as_ref().is_some_and(|play| play.waits_for().is_none() && play.feed.has_room());
            if more && self.phase == Phase::Running && self.mode == Mode::Playback && Instant::now() < self.window_until {
                self.send_points()?;
            }
            while let Some(told) = self.client.take_telemetry() {
                let sample = words::sample(&told);
                self.supply = (told.supply_v, told.chip_celsius);
                let ended = self.phase == Phase::Running && sample.phase == Phase::Armed && self.mode == Mode::Playback;
                self.phase = sample.phase;
                into.push(sample);
                if ended && self.play.as_ref().is_some_and(|play| play.feed.is_sent()) {
                    // The experiment is over.
                    self.client.send(&Request::Disarm)?;
                }
            }
            if Instant::now() >= until {
                return Ok(());
            }
        }
    }

    fn arm(&mut self, mode: Mode) -> Result<()> {
        let status = experiment::status(&mut self.client)?;
        if status.state == State::Idle {
            let law = match mode {
                Mode::Playback => 0,
                Mode::Pressure => 1,
                Mode::Displacement => 2,
            };
            self.borrowed.borrow(&mut self.client, "control.law", SettingValue::Integer(law))?;
            self.mode = mode;
            if mode == Mode::Playback {
                self.send_ahead()?;
            }
            self.wait_for_what_passes()?;
        }
        Ok(self.client.command(&Request::Arm)?)
    }

    /// Sends what the device shall have before the start.
    fn send_ahead(&mut self) -> Result<()> {
        let play = self.play.as_mut().context("load an excitation first")?;
        self.borrowed.borrow(&mut self.client, "playback.period_ms", SettingValue::Integer(play.period_ms))?;
        self.client.command(&Request::PlaybackClear)?;
        play.rewind();
        while play.feed.confirmed() < POINTS_AHEAD.min(play.feed.length()) {
            let reply = self.client.request(&Request::Playback(play.feed.chunk()))?;
            play.take(&reply);
        }
        Ok(())
    }

    /// Changed settings and a fresh vent make the device ask for a moment.
    fn wait_for_what_passes(&mut self) -> Result<()> {
        let until = Instant::now() + PASSING;
        loop {
            let blockers = experiment::status(&mut self.client)?.blockers;
            if blockers.iter().all(|blocker| !experiment::PASSING.contains(&blocker)) || Instant::now() >= until {
                return Ok(());
            }
            self.client.listen_for(Duration::from_millis(10))?;
        }
    }

    fn start(&mut self, value: Option<f32>) -> Result<()> {
        if self.mode == Mode::Playback {
            return Ok(self.client.command(&Request::Start)?);
        }
        // A set-point of the last run may be far from where the rig is now.
        let value = value.unwrap_or(0.0);
        self.check_set_point(value)?;
        self.client.command(&Request::Start)?;
        self.set_point = value;
        Ok(self.send_set_point()?)
    }

    fn check_set_point(&self, value: f32) -> Result<()> {
        ensure!(value.is_finite(), "the set-point is not a number");
        let ceiling_bar = self.limits.ceiling_bar;
        ensure!(
            self.mode != Mode::Pressure || (0.0..=ceiling_bar).contains(&value),
            "{value} bar is outside of 0 to {ceiling_bar} bar (limits.ceiling_bar)"
        );
        Ok(())
    }

    fn hold(&mut self, value: f32) -> Result<()> {
        ensure!(self.mode != Mode::Playback, "an excitation is loaded; disarm, and arm for a set-point");
        self.check_set_point(value)?;
        self.set_point = value;
        // In force at once; from then on each sign of life repeats it.
        if self.phase == Phase::Running {
            self.send_set_point()?;
        }
        Ok(())
    }

    fn sampled(&self, excitation: &Value) -> Result<(ExcitationConfig, Vec<f64>, Option<String>)> {
        let config: ExcitationConfig = serde_json::from_value(excitation.clone()).context("this is no excitation")?;
        let points = config.segments.iter().map(|segment| segment.duration_s).sum::<f64>() / config.sample_period_s;
        ensure!(
            points <= MOST_POINTS,
            "{points:.0} points are too many for the page, which plays up to {MOST_POINTS:.0}; `catheter rig record` plays more"
        );
        let samples = config.sample()?;
        let checked = limits(&self.limits).check(&samples, &config);
        let period_ms = config.sample_period_s * 1e3;
        let whole = (period_ms - period_ms.round()).abs() < 1e-6 && (1.0..=1000.0).contains(&period_ms.round());
        let not_whole =
            (!whole).then(|| format!("sample_period_s is {}: a rig plays whole milliseconds, 0.001 to 1 s", config.sample_period_s));
        let problem = checked.err().map(|error| error.to_string()).or(not_whole);
        Ok((config, samples.pressure_bar, problem))
    }

    fn load(&mut self, excitation: &Value) -> Result<()> {
        ensure!(!self.phase.is_energised(), "not while the rig is armed: vent first");
        let (config, pressure_bar, problem) = self.sampled(excitation)?;
        if let Some(problem) = problem {
            bail!("{problem}");
        }
        let points = pressure_bar.iter().map(|bar| *bar as f32).collect();
        self.play = Some(Play::new(points, (config.sample_period_s * 1e3).round() as u32));
        Ok(())
    }

    fn inject(&mut self, fault: Option<&str>) -> Result<()> {
        let breakage = fault.map(simulated::breakage).transpose()?;
        let hardware = self.client.transport().line().hardware().context("only a simulated rig can be broken")?;
        hardware.set_breakage(breakage);
        self.injected = fault.map(str::to_owned);
        Ok(())
    }

    fn change_plant(&mut self, name: &str) -> Result<()> {
        ensure!(!self.phase.is_energised(), "not while the rig is armed: vent first");
        let plant = simulated::plant(name, &self.given_plant)?;
        let hardware = self.client.transport().line().hardware().context("only a simulated rig has a plant of choice")?;
        hardware.set_muscle(Box::new(plant.start(0.0)));
        self.plant = Some(name.to_owned());
        Ok(())
    }

    fn changed_settings(&mut self) -> Result<()> {
        self.limits = KnownLimits::read(&mut self.client)?;
        self.unsaved = self.borrowed.are_unsaved(&mut self.client)?;
        self.settings = self.borrowed.list(&mut self.client)?;
        Ok(())
    }

    fn carry_out(&mut self, action: &Action) -> Result<()> {
        match action {
            Action::Vent => self.client.command(&Request::Vent)?,
            Action::Arm { mode } => self.arm(*mode)?,
            Action::Disarm => self.client.command(&Request::Disarm)?,
            Action::Start { value } => self.start(*value)?,
            Action::Stop => self.client.command(&Request::Stop)?,
            Action::Hold { value } => self.hold(*value)?,
            Action::Load { excitation } => self.load(excitation)?,
            Action::Acknowledge => self.client.command(&Request::Acknowledge)?,
            Action::Set { name, value } => {
                self.borrowed.set(&mut self.client, name, value)?;
                self.changed_settings()?;
            }
            Action::Save => {
                self.borrowed.without(&mut self.client, |rig| Ok(rig.command(&Request::SettingsSave)?))?;
                self.changed_settings()?;
            }
            Action::Revert { defaults } => {
                let baseline = if *defaults { Baseline::Defaults } else { Baseline::Saved };
                self.borrowed.without(&mut self.client, |rig| Ok(rig.command(&Request::SettingsRevert(baseline))?))?;
                self.changed_settings()?;
            }
            Action::Inject { fault } => self.inject(fault.as_deref())?,
            Action::Plant { name } => self.change_plant(name)?,
            Action::Record { .. } | Action::EndRecord => bail!("recordings are the session's"),
        }
        Ok(())
    }

    fn told(&mut self, status: &Status) -> Result<RigState> {
        self.phase = words::phase(status.state);
        let mut faults: Vec<_> = status.faults.iter().map(|fault| words::explained('E', &fault.explanation())).collect();
        // The first one is what to look at.
        faults.sort_by_key(|fault| fault.number != status.first_fault);
        let fault_record =
            if status.first_fault == 0 { None } else { experiment::fault_record(&mut self.client)?.as_ref().map(words::record) };
        let account = self.client.account();
        let account = Account {
            received: account.received,
            dropped_by_device: account.dropped_by_device,
            lost_on_the_line: account.lost_on_the_line,
            damaged_frames: account.damaged_frames,
        };
        let has_model = self.client.hello().model_id != [0; 8];
        Ok(RigState {
            phase: self.phase,
            faults,
            fault_record,
            blockers: status.blockers.iter().map(|blocker| words::explained('B', &blocker.explanation())).collect(),
            notices: status.notices.iter().map(|notice| words::explained('N', &notice.explanation())).collect(),
            time_ms: status.time_ms,
            late_ticks: status.late_ticks,
            longest_tick_cycles: status.longest_tick_cycles,
            reset_cause: words::reset_cause(status.reset_cause).to_owned(),
            settings_unsaved: self.unsaved,
            mode: self.mode,
            ceiling_bar: self.limits.ceiling_bar,
            host_timeout_ms: self.limits.host_timeout_ms,
            bound_mm: has_model.then_some(self.limits.estimate_bound_mm),
            supply_v: self.supply.0,
            chip_celsius: self.supply.1,
            playing: self.play.as_ref().map(|play| Playing { points: play.feed.length(), sent: play.feed.confirmed() }),
            injected: self.injected.clone(),
            plant: self.plant.clone(),
            account,
            speed: self.client.transport().speed(),
        })
    }
}

impl KnownLimits {
    fn read(rig: &mut Client<Paced>) -> Result<Self> {
        let float = |rig: &mut Client<Paced>, name: &str| match device_settings::setting(rig, name)? {
            SettingValue::Float(value) => Ok(value),
            _ => bail!("{name} is no number"),
        };
        let SettingValue::Integer(host_timeout_ms) = device_settings::setting(rig, "limits.host_timeout_ms")? else {
            bail!("limits.host_timeout_ms is no time");
        };
        Ok(Self {
            ceiling_bar: float(rig, "limits.ceiling_bar")?,
            slew_bar_per_s: float(rig, "limits.slew_up_bar_per_s")?.min(float(rig, "limits.slew_down_bar_per_s")?),
            host_timeout_ms,
            estimate_bound_mm: float(rig, "observer.estimate_bound_mm")?,
        })
    }
}

/// Limits of the device for an excitation.
fn limits(known: &KnownLimits) -> Limits {
    Limits { maximum_bar: known.ceiling_bar.into(), maximum_slew_bar_per_s: known.slew_bar_per_s.into(), ..Limits::default() }
}

impl Rig for OperatedRig {
    fn identity(&self) -> Identity {
        let hello = self.client.hello();
        let simulated = self.plant.is_some();
        let id = hello.model_id;
        Identity {
            place: self.place.clone(),
            board: hello.board.to_string(),
            firmware: version(hello.firmware),
            model_id: (id != [0; 8]).then(|| id.iter().map(|byte| format!("{byte:02x}")).collect()),
            simulated,
            plant: self.plant.clone(),
            plants: if simulated { simulated::plants(&self.given_plant) } else { Vec::new() },
            faults: if simulated { simulated::faults() } else { Vec::new() },
            cycles_per_tick: if hello.build.chip == 0 { 0 } else { CYCLES_PER_TICK },
            notices: words::notice_table(),
            fault_table: words::fault_table(),
        }
    }

    fn listen(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<(), Problem> {
        self.listen_to_all(limit, into).map_err(gone)
    }

    fn state(&mut self) -> Result<RigState, Problem> {
        experiment::status(&mut self.client).map_err(anyhow::Error::from).and_then(|status| self.told(&status)).map_err(problem)
    }

    fn renew(&mut self) -> Result<(), Problem> {
        if self.phase != Phase::Running {
            return Ok(());
        }
        self.window_until = Instant::now() + RENEWAL_WINDOW;
        if self.mode == Mode::Playback { self.send_points() } else { self.send_set_point() }.map_err(gone)
    }

    fn act(&mut self, action: &Action) -> Result<(), Problem> {
        self.carry_out(action).map_err(problem)
    }

    fn settings(&mut self) -> Result<Vec<Setting>, Problem> {
        Ok(self.settings.clone())
    }

    fn preview(&mut self, excitation: &Value) -> Result<Preview, Problem> {
        let (config, pressure_bar, problem) = self.sampled(excitation).map_err(problem)?;
        Ok(Preview {
            period_s: config.sample_period_s,
            pressure_bar,
            ceiling_bar: self.limits.ceiling_bar.into(),
            problem,
            file: excitation::to_toml(&config),
        })
    }

    fn upload(&mut self, bytes: &[u8]) -> Result<(), Problem> {
        let upload = |rig: &mut Client<Paced>| -> Result<()> {
            blob::decode(bytes).map_err(|error| anyhow::anyhow!("this is no blob that this program knows: {error}"))?;
            let id = blob::content_id(bytes).context("this is no blob")?;
            experiment::upload(rig, bytes, &mut |_| {})?;
            rig.command(&Request::ModelActivate { id })?;
            let status = experiment::settle_after_change(rig)?;
            if let Some(fault) = Fault::from_number(status.first_fault) {
                bail!("the device is in the fault state: {} {}", fault.explanation().meaning, fault.explanation().remedy);
            }
            rig.greet_again()?;
            Ok(())
        };
        upload(&mut self.client).map_err(problem)
    }

    fn close(&mut self) {
        // As much as still works: the device vents by itself anyway.
        let _ = self.client.command(&Request::Vent);
        let _ = self.borrowed.give_back(&mut self.client);
    }
}
