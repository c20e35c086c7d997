//! A rig without firmware: it has states, a time-to-live and something that follows the output, and it tells its tests when it was safe.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dashboard::{Action, Asked, Entry, Explained, Identity, Phase, Preview, Problem, Rig, RigState, Sample, Setting, Task};
use serde_json::{Value, json};

/// Without a sign of life for so long it vents by itself.
pub const HOST_TIMEOUT: Duration = Duration::from_millis(250);

/// What tests may look at, whatever the server does.
#[derive(Debug, Default)]
pub struct Watched {
    /// State and since when.
    pub phases: Vec<(Instant, Phase)>,
    /// Signs of life.
    pub renewals: Vec<Instant>,
    /// Set-points that came.
    pub held: Vec<f32>,
    /// Whether it was left as it should be.
    pub closed: bool,
    /// Whether its line is cut.
    pub cut: bool,
    /// The task that runs by itself, and why the last one ended.
    pub task: Option<String>,
    pub task_ended: Option<String>,
}

impl Watched {
    /// Its state now.
    pub fn phase(&self) -> Phase {
        self.phases.last().map_or(Phase::Boot, |(_, phase)| *phase)
    }
}

/// The rig.
pub struct Fake {
    watched: Arc<Mutex<Watched>>,
    begun: Instant,
    told_ms: u64,
    sequence: u32,
    renewed: Instant,
    phase: Phase,
    fault: Option<u8>,
    set_point: f32,
    pressure_bar: f32,
    slack_mm: f32,
    displacement_mm: f32,
    timeout_ms: u32,
    saved_ms: u32,
    injected: Option<String>,
}

impl Fake {
    pub fn new(watched: Arc<Mutex<Watched>>) -> Self {
        let now = Instant::now();
        watched.lock().unwrap().phases.push((now, Phase::Idle));
        Self {
            watched,
            begun: now,
            told_ms: 0,
            sequence: 0,
            renewed: now,
            phase: Phase::Idle,
            fault: None,
            set_point: 0.0,
            pressure_bar: 0.0,
            slack_mm: 0.4,
            displacement_mm: 0.0,
            timeout_ms: HOST_TIMEOUT.as_millis() as u32,
            saved_ms: HOST_TIMEOUT.as_millis() as u32,
            injected: None,
        }
    }

    fn go(&mut self, phase: Phase) {
        if self.phase != phase {
            self.phase = phase;
            self.watched.lock().unwrap().phases.push((Instant::now(), phase));
        }
    }

    fn end_task(&mut self, why: &str) {
        let mut watched = self.watched.lock().unwrap();
        if watched.task.take().is_some() {
            watched.task_ended = Some(why.to_owned());
        }
    }

    fn strike(&mut self, fault: u8) {
        self.fault = self.fault.or(Some(fault));
        self.go(Phase::Fault);
    }

    fn wants(&self, phase: Phase) -> Result<(), Problem> {
        if self.phase == phase { Ok(()) } else { Err(Problem::Refused(format!("not possible in the state {:?}", self.phase))) }
    }

    fn tick(&mut self) -> Sample {
        if self.phase == Phase::Running && self.renewed.elapsed() > Duration::from_millis(self.timeout_ms.into()) {
            self.strike(28);
        }
        if self.injected.is_some() && self.phase.is_energised() {
            self.strike(16);
        }
        let target_bar = if self.phase == Phase::Running { self.set_point } else { 0.0 };
        self.pressure_bar += (target_bar - self.pressure_bar) / 30.0;
        let response_mm = 4.0 * self.pressure_bar;
        self.displacement_mm = self.displacement_mm.clamp(response_mm - self.slack_mm, response_mm + self.slack_mm);
        self.told_ms += 1;
        self.sequence += 1;
        Sample {
            sequence: self.sequence,
            time_ms: self.told_ms,
            phase: self.phase,
            fault: self.fault.unwrap_or(0),
            command_bar: target_bar,
            output_bar: target_bar,
            set_point: self.set_point,
            pressure_bar: Some(self.pressure_bar),
            displacement_mm: Some(self.displacement_mm),
            laser_code: 2000,
            pressure_code: 1500,
            ..Sample::default()
        }
    }
}

fn explained(id: &str, number: u8, name: &str) -> Explained {
    let (id, name) = (id.to_owned(), name.to_owned());
    Explained { id, number, name, meaning: "What happened.".to_owned(), remedy: "What helps.".to_owned() }
}

impl Rig for Fake {
    fn identity(&self) -> Identity {
        let entry = |name: &str| Entry { name: name.to_owned(), title: name.to_owned() };
        Identity {
            place: "nowhere".to_owned(),
            board: "fake".to_owned(),
            firmware: "0.0.0".to_owned(),
            simulated: true,
            plants: vec![entry("pi")],
            faults: vec![entry("laser-wire")],
            fault_table: vec![explained("E016", 16, "laser-range"), explained("E028", 28, "host-lost")],
            ..Identity::default()
        }
    }

    fn listen(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<(), Problem> {
        std::thread::sleep(limit);
        if self.watched.lock().unwrap().cut {
            return Err(Problem::Gone("the device is gone".to_owned()));
        }
        let now_ms = self.begun.elapsed().as_millis() as u64;
        while self.told_ms < now_ms {
            into.push(self.tick());
        }
        Ok(())
    }

    fn state(&mut self) -> Result<RigState, Problem> {
        Ok(RigState {
            phase: self.phase,
            faults: self.fault.map(|number| explained(&format!("E{number:03}"), number, "struck")).into_iter().collect(),
            time_ms: self.told_ms,
            ceiling_bar: 3.0,
            host_timeout_ms: self.timeout_ms,
            settings_unsaved: self.timeout_ms != self.saved_ms,
            injected: self.injected.clone(),
            task: self.watched.lock().unwrap().task.clone().map(|name| Task {
                kind: "calibrate",
                name,
                does: "waits for you".to_owned(),
                share: 0.5,
                asks: Some(Asked { text: "Where is it?".to_owned(), unit: "mm", value: Some(2.0) }),
            }),
            ..RigState::default()
        })
    }

    fn renew(&mut self) -> Result<(), Problem> {
        self.renewed = Instant::now();
        self.watched.lock().unwrap().renewals.push(self.renewed);
        Ok(())
    }

    fn act(&mut self, action: &Action) -> Result<(), Problem> {
        match action {
            Action::Vent | Action::Disarm if self.phase != Phase::Fault => {
                self.go(Phase::Idle);
                self.end_task("vented");
            }
            Action::Vent | Action::Disarm => {}
            Action::Arm { .. } => {
                self.wants(Phase::Idle)?;
                self.go(Phase::Armed);
            }
            Action::Start { value } => {
                self.wants(Phase::Armed)?;
                self.renewed = Instant::now();
                self.set_point = value.unwrap_or(0.0);
                self.go(Phase::Running);
            }
            Action::Stop => self.go(Phase::Armed),
            Action::Hold { value } => {
                self.set_point = *value;
                self.watched.lock().unwrap().held.push(*value);
            }
            Action::Acknowledge => {
                self.fault = None;
                self.go(Phase::Idle);
            }
            Action::Set { value, .. } => self.timeout_ms = value.as_u64().unwrap_or(250) as u32,
            Action::Save => self.saved_ms = self.timeout_ms,
            Action::Revert { .. } => self.timeout_ms = self.saved_ms,
            Action::Inject { fault } => self.injected.clone_from(fault),
            Action::Calibrate { step } => self.watched.lock().unwrap().task = Some(step.clone()),
            Action::Answer { value } => self.watched.lock().unwrap().held.push(*value as f32),
            Action::Accept | Action::Follow { .. } => {}
            Action::Load { .. } | Action::Plant { .. } | Action::Record { .. } | Action::EndRecord => {}
        }
        Ok(())
    }

    fn settings(&mut self) -> Result<Vec<Setting>, Problem> {
        Ok(vec![Setting {
            name: "limits.host_timeout_ms".to_owned(),
            unit: "ms".to_owned(),
            meaning: "How long without a sign of life.".to_owned(),
            value: json!(self.timeout_ms),
            saved: json!(self.saved_ms),
            default: json!(250),
            minimum: json!(10),
            maximum: json!(5000),
        }])
    }

    fn preview(&mut self, excitation: &Value) -> Result<Preview, Problem> {
        let points = excitation["points"].as_u64().ok_or_else(|| Problem::Refused("this is no excitation".to_owned()))?;
        let pressure_bar = (0..points).map(|point| point as f64 * 0.01).collect();
        Ok(Preview { period_s: 0.02, pressure_bar, ceiling_bar: 3.0, problem: None, file: String::new() })
    }

    fn abandon(&mut self, why: &str) -> Result<(), Problem> {
        self.go(Phase::Idle);
        self.end_task(why);
        Ok(())
    }

    fn calibration(&mut self) -> Result<Value, Problem> {
        Ok(json!({ "steps": [] }))
    }

    fn calibration_page(&mut self) -> Result<String, Problem> {
        Ok("<script>2</script>".to_owned())
    }

    fn controllers(&mut self) -> Result<Value, Problem> {
        Ok(json!({ "controllers": ["pid"], "references": ["a"], "reach": { "offered_mm": [1, 9] } }))
    }

    fn reference(&mut self, reference: &Value) -> Result<Value, Problem> {
        Ok(reference.clone())
    }

    fn upload(&mut self, blob: &[u8]) -> Result<(), Problem> {
        if blob.is_empty() { Err(Problem::Refused("this is no blob".to_owned())) } else { Ok(()) }
    }

    fn close(&mut self) {
        self.go(Phase::Idle);
        self.watched.lock().unwrap().closed = true;
    }
}
