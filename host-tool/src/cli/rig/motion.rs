//! `catheter rig arm|disarm|start|stop|hold|move|jog`: from idle to pressure and back.

use std::cell::RefCell;
use std::io::{BufRead, IsTerminal};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use model_export::link::message::{Quantity, Request, Telemetry};
use model_export::link::settings::SettingValue;
use model_export::link::state::State;
use serde::Serialize;

use super::Which;
use super::reading::{Reading, latest};
use super::state::RecordWritten;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::device_settings;
use crate::energise::{self, Ended, Next};
use crate::experiment;
use crate::interrupt;
use crate::link::{Client, state_name};
use crate::say;

/// How long a simulated rig, whose time passes as fast as the computer allows, is held when nobody says.
const SIMULATED_S: f64 = 2.0;
/// Longest time that may be asked for, s.
const LONGEST_S: f64 = 86_400.0;

/// How long, and from where.
#[derive(Args, Clone, Copy, Debug)]
pub struct While {
    /// Arm first; without it the rig must be armed.
    #[arg(long)]
    arm: bool,
    /// End after this time of the rig; until Ctrl-C when absent (2 s on a simulated rig).
    #[arg(long, value_name = "S", value_parser = seconds)]
    seconds: Option<f64>,
    /// Print a line this often, per second.
    #[arg(long, value_name = "HZ", default_value_t = 2.0, value_parser = rate)]
    rate_hz: f64,
}

/// How long to watch an armed rig.
#[derive(Args, Clone, Copy, Debug)]
pub struct ArmArguments {
    /// Stay for this time of the rig and tell every change of its state.
    #[arg(long, value_name = "S", value_parser = seconds)]
    seconds: Option<f64>,
}

/// A pressure to hold.
#[derive(Args, Clone, Copy, Debug)]
pub struct HoldArguments {
    /// The pressure; never above the device's ceiling.
    #[arg(long, value_name = "BAR")]
    pressure_bar: f32,
    #[command(flatten)]
    time: While,
}

/// A displacement to go to.
#[derive(Args, Clone, Copy, Debug)]
pub struct MoveArguments {
    /// The displacement.
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    displacement_mm: f32,
    /// How fast the set-point goes there.
    #[arg(long, value_name = "MM/S", default_value_t = 5.0)]
    speed_mm_per_s: f32,
    #[command(flatten)]
    time: While,
}

/// Small steps by hand.
#[derive(Args, Clone, Copy, Debug)]
pub struct JogArguments {
    /// A step of the pressure.
    #[arg(long, value_name = "BAR", default_value_t = 0.05)]
    step_bar: f32,
    /// How long each line of a script is held, in s of the rig; from a terminal the keys decide.
    #[arg(long, value_name = "S", default_value_t = 0.5, value_parser = seconds)]
    dwell_s: f64,
    /// Arm first; without it the rig must be armed.
    #[arg(long)]
    arm: bool,
}

pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| *value > 0.0 && *value <= LONGEST_S);
    value.ok_or_else(|| format!("a time above 0 and up to {LONGEST_S} s is wanted"))
}

pub(super) fn rate(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| (0.01..=1000.0).contains(value));
    value.ok_or_else(|| "a rate from 0.01 to 1000 Hz is wanted".to_owned())
}

#[derive(Serialize)]
struct Written {
    ended: &'static str,
    state: &'static str,
    vented: Option<bool>,
    seconds: f64,
    reading: Option<Reading>,
    fault: Option<RecordWritten>,
}

/// Says that a device that ends with this command has no state to keep.
fn say_what_is_kept(which: &Which) {
    if !which.backend.is_board() {
        say!("This rig ends with this command; on a board the state stays.");
    }
}

/// Arms, and stays if asked to.
pub fn arm(arguments: ArmArguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    interrupt::watch();
    energise::arm(rig)?;
    let SettingValue::Integer(timeout_s) = device_settings::setting(rig, "arming.timeout_s")? else { bail!("arming.timeout_s is no time") };
    say!("Armed: the dump valve is closed, the output is zero. Without a start it disarms itself after {timeout_s} s.");
    let begun = rig.elapsed();
    let mut last: Option<Reading> = None;
    let until = begun + Duration::from_secs_f64(arguments.seconds.unwrap_or(0.05));
    while rig.elapsed() < until && !interrupt::is_requested() {
        rig.listen(Duration::from_millis(20))?;
        while let Some(sample) = rig.take_telemetry() {
            let reading = Reading::new(&sample, rig.transport());
            let changed = last.as_ref().is_none_or(|last| last.state != reading.state);
            // The first samples may be from before.
            if changed && (last.is_some() || sample.state.is_energised()) {
                say!("{}", reading.line());
            }
            if last.is_some() || sample.state.is_energised() {
                last = Some(reading);
            }
        }
    }
    if interrupt::is_requested() {
        return finish(rig, which, Ended::Interrupted, last, begun);
    }
    let status = experiment::status(rig)?;
    if status.state == State::Armed {
        say_what_is_kept(which);
    } else if status.state == State::Idle {
        say!("Disarmed itself after {timeout_s} s without a start (arming.timeout_s). State `idle`.");
    }
    let fault = if status.state == State::Fault { experiment::fault_record(rig)? } else { None };
    if let Some(record) = &fault {
        say!("{}", RecordWritten::new(record).line());
    }
    let failed = status.state == State::Fault;
    which.write(&Written {
        ended: if failed { "fault" } else { "armed" },
        state: state_name(status.state),
        vented: None,
        seconds: (rig.elapsed() - begun).as_secs_f64(),
        reading: last,
        fault: fault.as_ref().map(RecordWritten::new),
    })?;
    Ok(if failed { Outcome::CheckFailed } else { Outcome::Success })
}

/// One request that leads to another state.
pub fn simple(request: &Request, done: &str, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    rig.command(request)?;
    rig.listen(Duration::from_millis(20))?;
    let status = experiment::status(rig)?;
    say!("{done} State `{}`.", state_name(status.state));
    say_what_is_kept(which);
    which.write(&Written { ended: "done", state: state_name(status.state), vented: None, seconds: 0.0, reading: None, fault: None })?;
    Ok(Outcome::Success)
}

/// Starts with the control law of the settings and keeps the set-point where it is.
pub fn start(time: While, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let quantity = match device_settings::setting(rig, "control.law")? {
        SettingValue::Integer(1) => Quantity::Pressure,
        SettingValue::Integer(2) => Quantity::Displacement,
        _ => bail!(
            "control.law is `playback`, which plays an excitation: `catheter rig ... record` does. `settings set control.law=pressure` is for \
             set-points; `hold` and `move` choose for themselves"
        ),
    };
    let first = match quantity {
        Quantity::Pressure => 0.0,
        // Where the tip is.
        Quantity::Displacement => latest(rig)?.displacement_mm.context("the laser gives no displacement to begin from")?,
    };
    let fixed = move |_: &Telemetry, _: f64| Next::Hold(first);
    run(rig, which, time, &[], (quantity, first), &fixed)
}

/// Holds a pressure.
pub fn hold(arguments: HoldArguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let HoldArguments { pressure_bar, time } = arguments;
    let SettingValue::Float(ceiling_bar) = device_settings::setting(rig, "limits.ceiling_bar")? else {
        bail!("limits.ceiling_bar is no pressure")
    };
    ensure!(
        (0.0..=ceiling_bar).contains(&pressure_bar),
        "--pressure-bar {pressure_bar}: 0 to {ceiling_bar} bar is wanted, the device's ceiling (limits.ceiling_bar)"
    );
    let fixed = move |_: &Telemetry, _: f64| Next::Hold(pressure_bar);
    run(rig, which, time, &[("control.law", SettingValue::Integer(1))], (Quantity::Pressure, pressure_bar), &fixed)
}

/// Goes to a displacement and stays there.
pub fn move_to(arguments: MoveArguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let MoveArguments { displacement_mm, speed_mm_per_s, time } = arguments;
    ensure!(displacement_mm.is_finite(), "--displacement-mm: a number is wanted");
    ensure!(speed_mm_per_s.is_finite() && speed_mm_per_s > 0.0, "--speed-mm-per-s: a speed above zero is wanted");
    let begin_mm =
        latest(rig)?.displacement_mm.context("the laser gives no displacement to begin from; `catheter rig ... status` says why")?;
    let ramp = move |_: &Telemetry, since_s: f64| {
        let way_mm = displacement_mm - begin_mm;
        let gone_mm = (since_s as f32 * speed_mm_per_s).min(way_mm.abs());
        Next::Hold(begin_mm + gone_mm.copysign(way_mm))
    };
    run(rig, which, time, &[("control.law", SettingValue::Integer(2))], (Quantity::Displacement, begin_mm), &ramp)
}

/// Runs with a set-point that depends on the sample and the time since the start, s, then vents and sets the settings back.
fn run(
    rig: &mut Client<Rig>,
    which: &Which,
    time: While,
    settings: &[(&str, SettingValue)],
    (quantity, first): (Quantity, f32),
    set_point: &dyn Fn(&Telemetry, f64) -> Next,
) -> Result<Outcome> {
    interrupt::watch();
    let state = experiment::status(rig)?.state;
    if !time.arm && state != State::Armed {
        bail!("the rig is in the state `{}`, not `armed`: `--arm` arms first, `catheter rig ... arm` alone does too", state_name(state));
    }
    let length_s = time.seconds.or_else(|| (!which.backend.is_board()).then_some(SIMULATED_S));
    let borrowed = if state == State::Armed {
        // Settings cannot be changed any more.
        for (name, value) in settings {
            ensure!(
                device_settings::setting(rig, name)? == *value,
                "{name} is another one and cannot be changed while the rig is armed: `catheter rig ... disarm` first, then come with --arm"
            );
        }
        device_settings::Borrowed::default()
    } else {
        device_settings::borrow(rig, settings)?
    };
    let armed = if state == State::Armed { Ok(()) } else { energise::arm(rig) };
    let begun = rig.elapsed();
    let mut last: Option<Reading> = None;
    let mut begin_ms = None;
    let mut printed_s = f64::NEG_INFINITY;
    let mut each = |transport: &mut Rig, sample: &Telemetry| {
        let since_s = sample.time_ms.saturating_sub(*begin_ms.get_or_insert(sample.time_ms)) as f64 * 1e-3;
        let reading = Reading::new(sample, transport);
        if since_s >= printed_s + 1.0 / time.rate_hz - 1e-9 {
            printed_s = since_s;
            say!("{}", reading.line());
        }
        last = Some(reading);
        let over = length_s.is_some_and(|length_s| since_s >= length_s);
        Ok(if over { Next::End } else { set_point(sample, since_s) })
    };
    let ended = armed.and_then(|()| energise::run(rig, quantity, first, &mut each));
    match ended {
        Ok(ended) => {
            let outcome = finish(rig, which, ended, last, begun);
            device_settings::give_back(rig, borrowed)?;
            outcome
        }
        Err(error) => {
            // Whatever went wrong: no pressure, and the settings as they were.
            let _ = energise::vent(rig);
            let _ = device_settings::give_back(rig, borrowed);
            Err(error)
        }
    }
}

/// Vents, says how it ended, writes it.
fn finish(rig: &mut Client<Rig>, which: &Which, ended: Ended, last: Option<Reading>, begun: Duration) -> Result<Outcome> {
    if let Some(reading) = &last {
        say!("{}", reading.line());
    }
    let seconds = (rig.elapsed() - begun).as_secs_f64();
    let (vented, status) = energise::vent(rig)?;
    let fault = match &ended {
        Ended::Fault(record) => Some(RecordWritten::new(record)),
        _ => None,
    };
    let (name, fine) = match &ended {
        Ended::AsAsked => ("done", true),
        // Without a length Ctrl-C is how it ends.
        Ended::Interrupted => ("interrupted", true),
        Ended::Fault(_) => ("fault", false),
        Ended::Left(_) => ("left", false),
    };
    if let Some(record) = &fault {
        say!("{}", record.line());
        say!("`catheter explain` with that number says what to do; on a board, `catheter rig ... explain` shows the last seconds.");
    }
    if let Ended::Left(state) = &ended {
        say!("The device went to the state `{}` by itself.", state_name(*state));
    }
    if vented {
        say!("Vented: the measured pressure is below 0.1 bar. State `{}`.", state_name(status.state));
    } else {
        say!("NOT vented: the measured pressure was not seen below 0.1 bar. Close the supply by hand.");
    }
    which.write(&Written { ended: name, state: state_name(status.state), vented: Some(vented), seconds, reading: last, fault })?;
    Ok(if fine && vented { Outcome::Success } else { Outcome::CheckFailed })
}

/// What a person at the keys, or a script, wants.
enum Wish {
    By(f32),
    To(f32),
    Wait(f64),
    End,
}

/// A line of a script: `+`, `-`, a pressure, `wait S`, `vent`.
fn wish(line: &str) -> Result<Option<Wish>> {
    let line = line.trim();
    Ok(match (line, line.split_once(' ')) {
        ("", _) => None,
        ("+", _) => Some(Wish::By(1.0)),
        ("-", _) => Some(Wish::By(-1.0)),
        ("vent" | "q", _) => Some(Wish::End),
        (_, Some(("wait", time))) => Some(Wish::Wait(seconds(time.trim()).map_err(anyhow::Error::msg)?)),
        (pressure, _) => {
            let value = pressure.parse().ok().filter(|value: &f32| value.is_finite());
            Some(Wish::To(value.with_context(|| format!("{line}: +, -, a pressure in bar, `wait S` or `vent` is wanted"))?))
        }
    })
}

/// Keys as they are pressed, or lines as they come; ends with the input.
fn wishes(from_keys: bool) -> Receiver<Result<Wish>> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        if from_keys {
            let terminal = console::Term::stderr();
            while let Ok(key) = terminal.read_key() {
                let wish = match key {
                    console::Key::ArrowUp | console::Key::Char('+') => Wish::By(1.0),
                    console::Key::ArrowDown | console::Key::Char('-') => Wish::By(-1.0),
                    console::Key::PageUp => Wish::By(5.0),
                    console::Key::PageDown => Wish::By(-5.0),
                    console::Key::Char('0') => Wish::To(0.0),
                    console::Key::Escape | console::Key::Char('q' | ' ') => Wish::End,
                    _ => continue,
                };
                if sender.send(Ok(wish)).is_err() {
                    return;
                }
            }
        } else {
            for line in std::io::stdin().lock().lines() {
                let wish = line.context("standard input cannot be read").and_then(|line| wish(&line)).transpose();
                if let Some(wish) = wish
                    && sender.send(wish).is_err()
                {
                    return;
                }
            }
        }
    });
    receiver
}

/// Where jogging is.
struct Jog {
    set_point_bar: f32,
    /// The next wish is taken at this time since the start, s.
    until_s: f64,
    begun: Instant,
    wrong: Option<anyhow::Error>,
}

/// Small steps by hand.
pub fn jog(arguments: JogArguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let JogArguments { step_bar, dwell_s, arm } = arguments;
    let SettingValue::Float(ceiling_bar) = device_settings::setting(rig, "limits.ceiling_bar")? else {
        bail!("limits.ceiling_bar is no pressure")
    };
    ensure!(step_bar > 0.0 && step_bar <= ceiling_bar, "--step-bar {step_bar}: above 0, and up to {ceiling_bar} bar");
    let from_keys = std::io::stdin().is_terminal();
    let paced = !which.backend.is_board() && from_keys;
    if from_keys {
        say!("Up, down: {step_bar} bar. Page up, page down: five steps. 0: no pressure. Space, Esc, q or Ctrl-C: vent and end.");
    } else {
        say!("Lines: +, -, a pressure in bar, wait S, vent.");
    }
    let waits = !from_keys && !which.backend.is_board();
    let wishes = wishes(from_keys);
    let state = RefCell::new(Jog { set_point_bar: 0.0, until_s: 0.0, begun: Instant::now(), wrong: None });
    let next = |_: &Telemetry, since_s: f64| {
        let mut state = state.borrow_mut();
        if paced {
            // A simulated rig at a person's pace.
            let ahead = Duration::from_secs_f64(since_s).saturating_sub(state.begun.elapsed());
            std::thread::sleep(ahead.min(Duration::from_millis(100)));
        }
        if since_s < state.until_s {
            return Next::Hold(state.set_point_bar);
        }
        // On a simulated rig a script is read in the rig's time, so that it gives the same every time. A board must not wait for a reader.
        let wish = if waits { wishes.recv().map_err(|_| TryRecvError::Disconnected) } else { wishes.try_recv() };
        let wanted_bar = match wish {
            Ok(Ok(Wish::By(steps))) => (state.set_point_bar + steps * step_bar).clamp(0.0, ceiling_bar),
            Ok(Ok(Wish::To(bar))) if (0.0..=ceiling_bar).contains(&bar) => bar,
            Ok(Ok(Wish::To(bar))) => {
                state.wrong = Some(anyhow::anyhow!("{bar} bar: 0 to {ceiling_bar} bar is wanted, the device's ceiling"));
                return Next::End;
            }
            Ok(Ok(Wish::Wait(seconds))) => {
                state.until_s = since_s + seconds;
                return Next::Hold(state.set_point_bar);
            }
            Ok(Err(error)) => {
                state.wrong = Some(error);
                return Next::End;
            }
            Ok(Ok(Wish::End)) | Err(TryRecvError::Disconnected) => return Next::End,
            Err(TryRecvError::Empty) => return Next::Hold(state.set_point_bar),
        };
        state.set_point_bar = wanted_bar;
        state.until_s = since_s + if from_keys { 0.0 } else { dwell_s };
        say!("set-point {wanted_bar:.3} bar");
        Next::Hold(wanted_bar)
    };
    let time = While { arm, seconds: Some(LONGEST_S), rate_hz: 2.0 };
    let outcome = run(rig, which, time, &[("control.law", SettingValue::Integer(1))], (Quantity::Pressure, 0.0), &next);
    match state.into_inner().wrong {
        Some(error) => Err(error),
        None => outcome,
    }
}
