//! The session: one thread that owns the rig, carries out orders one after the other, and tells everybody what happens.
//!
//! It never renews anything by itself: see [`Rig::renew`].

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use serde_json::{Value, json};
use tokio::sync::{broadcast, oneshot};

use crate::access::Role;
use crate::audit::Audit;
use crate::client::Client;
use crate::frame;
use crate::lease::{Holder, Lease, VENTED_LENGTH};
use crate::opening::{Opener, Opening};
use crate::recorder::Recorder;
use crate::rig::{Action, Identity, Preview, Problem, Rig, RigState, Sample, Setting};

/// Time between two looks at orders.
const STEP: Duration = Duration::from_millis(4);
/// Samples of so long make a frame.
const FRAME: Duration = Duration::from_millis(20);
/// How often the state is asked for.
const STATE: Duration = Duration::from_millis(200);
/// Samples that a new watcher is shown: a minute at 1,000 samples/s.
const KEPT_SAMPLES: usize = 60_000;
/// Samples of a frame of what is past.
const PAST_FRAME: usize = 4_000;

/// What is told to every watcher.
#[derive(Clone, Debug)]
pub(crate) enum Event {
    /// A frame of samples.
    Samples(Bytes),
    /// JSON: the state.
    State(Arc<str>),
}

/// What a new watcher gets.
pub(crate) struct Watching {
    /// The state and samples so far.
    pub past: Vec<Event>,
    /// What follows them.
    pub events: broadcast::Receiver<Event>,
}

/// Where an answer goes.
pub(crate) type Answer<T> = oneshot::Sender<T>;

/// What the session is asked for.
pub(crate) enum Order {
    Watch(Answer<Watching>),
    Take(Client, Answer<Result<(), Holder>>),
    /// A heartbeat; the answer says whether it was the operator's.
    Renew(u64, Option<Answer<bool>>),
    Release(Client),
    Act(Client, Action, Answer<Result<Value, Problem>>),
    /// A model, and settings that belong to it.
    Upload(Client, Bytes, Vec<(String, Value)>, Answer<Result<Value, Problem>>),
    Settings(Answer<Result<Vec<Setting>, Problem>>),
    Preview(Value, Answer<Result<Preview, Problem>>),
    Reference(Value, Answer<Result<Value, Problem>>),
    Controllers(Answer<Result<Value, Problem>>),
    Calibration(Answer<Result<Value, Problem>>),
    CalibrationPage(Answer<Result<String, Problem>>),
    /// What was done beside the session is written down all the same.
    Note {
        who: String,
        what: String,
        outcome: String,
    },
    State(Answer<Arc<str>>),
    /// The name of the recording that runs.
    Recording(Answer<Option<String>>),
    Samples(usize, Answer<Vec<Sample>>),
    Close(Answer<()>),
}

pub(crate) struct Session {
    opening: Opening,
    orders: Receiver<Order>,
    events: broadcast::Sender<Event>,
    audit: Audit,
    folder: PathBuf,
    rig: Option<Box<dyn Rig>>,
    identity: Identity,
    state: RigState,
    problem: Option<String>,
    lease: Lease,
    recorder: Option<Recorder>,
    /// What a recording ended with by itself.
    remark: Option<String>,
    fresh: Vec<Sample>,
    unsent: Vec<Sample>,
    past: VecDeque<Sample>,
    frames: u32,
    told: Arc<str>,
}

impl Session {
    pub fn new(opener: Opener, orders: Receiver<Order>, events: broadcast::Sender<Event>, audit: Audit, folder: PathBuf) -> Self {
        Self {
            opening: Opening::new(opener),
            orders,
            events,
            audit,
            folder,
            rig: None,
            identity: Identity::default(),
            state: RigState::default(),
            problem: Some("connecting".to_owned()),
            lease: Lease::default(),
            recorder: None,
            remark: None,
            fresh: Vec::new(),
            unsent: Vec::new(),
            past: VecDeque::new(),
            frames: 0,
            told: "{}".into(),
        }
    }

    /// Runs until it is told to close or nobody can give orders any more.
    pub fn run(mut self) {
        let (mut frame_at, mut state_at) = (Instant::now(), Instant::now());
        loop {
            if self.rig.is_none()
                && let Some(opened) = self.opening.poll()
            {
                self.open(opened);
                state_at = Instant::now();
            }
            let mut first = None;
            if self.rig.is_some() {
                self.listen();
            } else {
                match self.orders.recv_timeout(STEP) {
                    Ok(order) => first = Some(order),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return self.close(),
                }
            }
            loop {
                let order = match first.take() {
                    Some(order) => order,
                    None => match self.orders.try_recv() {
                        Ok(order) => order,
                        Err(TryRecvError::Empty) => break,
                        Err(TryRecvError::Disconnected) => return self.close(),
                    },
                };
                if let Order::Close(answer) = order {
                    self.close();
                    let _ = answer.send(());
                    return;
                }
                self.carry_out(order);
            }
            self.watch_the_lease();
            let now = Instant::now();
            if now >= frame_at {
                frame_at = now + FRAME;
                self.send_frame();
            }
            let changed = self.past.back().is_some_and(|sample| sample.phase != self.state.phase);
            if now >= state_at || (changed && self.rig.is_some()) {
                state_at = now + STATE;
                self.ask_state();
                self.tell_state();
            }
        }
    }

    fn open(&mut self, opened: Result<Box<dyn Rig>, Problem>) {
        match opened {
            Ok(rig) => {
                self.identity = rig.identity();
                self.rig = Some(rig);
                self.problem = None;
                self.audit.note("session", "open", &self.identity.place);
            }
            Err(problem) => {
                let problem = problem.to_string();
                if self.problem.as_deref() != Some(&problem) {
                    self.audit.note("session", "open", &problem);
                }
                self.problem = Some(problem);
            }
        }
    }

    /// The rig is gone: it vents by itself; the next attempt to open it comes soon.
    fn lose(&mut self, problem: &Problem) {
        self.audit.note("session", "lost", &problem.to_string());
        self.problem = Some(problem.to_string());
        self.rig = None;
        self.state = RigState::default();
        self.end_recording("the rig is gone");
    }

    fn listen(&mut self) {
        let Some(rig) = &mut self.rig else { return };
        self.fresh.clear();
        if let Err(problem) = rig.listen(STEP, &mut self.fresh) {
            return self.lose(&problem);
        }
        for sample in &self.fresh {
            if self.past.len() == KEPT_SAMPLES {
                self.past.pop_front();
            }
            self.past.push_back(*sample);
            if let Some(recorder) = &mut self.recorder
                && let Err(problem) = recorder.write(sample)
            {
                self.recorder = None;
                self.remark = Some(format!("the recording ended: {problem}"));
            }
        }
        self.unsent.extend_from_slice(&self.fresh);
    }

    fn send_frame(&mut self) {
        if self.unsent.is_empty() {
            return;
        }
        self.frames = self.frames.wrapping_add(1);
        let frame = frame::encode(self.frames, self.state.bound_mm, &self.unsent);
        self.unsent.clear();
        // Nobody watching is no error.
        let _ = self.events.send(Event::Samples(frame.into()));
    }

    fn ask_state(&mut self) {
        let Some(rig) = &mut self.rig else { return };
        match rig.state() {
            Ok(state) => {
                if state.phase != self.state.phase {
                    let faults: Vec<&str> = state.faults.iter().map(|fault| fault.id.as_str()).collect();
                    self.audit.note("device", "state", &format!("{:?} {}", state.phase, faults.join(" ")));
                }
                self.state = state;
            }
            Err(Problem::Refused(_)) => {}
            Err(problem) => self.lose(&problem),
        }
    }

    fn tell_state(&mut self) {
        let value = json!({
            "kind": "state",
            "rig": self.rig.as_ref().map(|_| &self.state),
            "identity": self.identity,
            "problem": self.problem,
            "lease": self.lease.holder(),
            "recording": self.recorder.as_ref().map(Recorder::progress),
            "remark": self.remark,
            "watchers": self.events.receiver_count(),
        });
        let text: Arc<str> = value.to_string().into();
        if text != self.told {
            self.told = text;
            let _ = self.events.send(Event::State(Arc::clone(&self.told)));
        }
    }

    fn lease_length(&self) -> Duration {
        if self.state.phase.is_energised() { Duration::from_millis(self.state.host_timeout_ms.into()) } else { VENTED_LENGTH }
    }

    fn watch_the_lease(&mut self) {
        if let Some(holder) = self.lease.expire(self.lease_length(), Instant::now()) {
            self.audit.note(&holder.name, "lease", "ran out");
            self.abandon("the operator fell silent");
            self.tell_state();
        }
    }

    /// Not what makes it safe: the device's own time-to-live does that. This is sooner, where something is left to do it.
    fn abandon(&mut self, why: &str) {
        if !self.state.phase.is_energised() && self.state.task.is_none() {
            return;
        }
        if let Some(rig) = &mut self.rig {
            let outcome = rig.abandon(why);
            self.audit.note("session", &format!("vent: {why}"), &in_words(&outcome));
        }
    }

    fn carry_out(&mut self, order: Order) {
        match order {
            Order::Watch(answer) => {
                let _ = answer.send(self.watching());
            }
            Order::Take(client, answer) => {
                let holder = Holder { client: client.number, name: client.name.clone() };
                let taken = if client.role >= Role::Operate {
                    self.lease.take(holder, Instant::now())
                } else {
                    Err(Holder { client: 0, name: "nobody of the role observe".to_owned() })
                };
                self.audit.note(&client.name, "lease", if taken.is_ok() { "taken" } else { "refused" });
                let _ = answer.send(taken);
                self.tell_state();
            }
            Order::Renew(client, answer) => {
                let renewed = self.lease.renew(client, Instant::now());
                if renewed
                    && let Some(rig) = &mut self.rig
                    && let Err(problem @ Problem::Gone(_)) = rig.renew()
                {
                    self.lose(&problem);
                }
                let _ = answer.map(|answer| answer.send(renewed));
            }
            Order::Release(client) => {
                if self.lease.release(client.number) {
                    self.audit.note(&client.name, "lease", "given back");
                    self.abandon("the operator left");
                    self.tell_state();
                }
            }
            Order::Act(client, action, answer) => {
                let outcome = self.act(&client, &action);
                let what = serde_json::to_string(&action).unwrap_or_default();
                self.audit.note(&client.name, &what, &in_words(&outcome));
                if let Err(problem @ Problem::Gone(_)) = &outcome {
                    self.lose(problem);
                }
                let _ = answer.send(outcome);
                self.ask_state();
                self.tell_state();
            }
            Order::Upload(client, blob, settings, answer) => {
                let outcome = self.may(&client, Role::Configure).and_then(|()| self.upload(&blob, &settings));
                self.audit.note(&client.name, &format!("upload of {} bytes", blob.len()), &in_words(&outcome));
                let _ = answer.send(outcome);
            }
            Order::Note { who, what, outcome } => self.audit.note(&who, &what, &outcome),
            Order::Settings(answer) => {
                let _ = answer.send(self.with_rig(|rig| rig.settings()));
            }
            Order::Preview(excitation, answer) => {
                let _ = answer.send(self.with_rig(|rig| rig.preview(&excitation)));
            }
            Order::Reference(reference, answer) => {
                let _ = answer.send(self.with_rig(|rig| rig.reference(&reference)));
            }
            Order::Controllers(answer) => {
                let _ = answer.send(self.with_rig(|rig| rig.controllers()));
            }
            Order::Calibration(answer) => {
                let _ = answer.send(self.with_rig(|rig| rig.calibration()));
            }
            Order::CalibrationPage(answer) => {
                let _ = answer.send(self.with_rig(|rig| rig.calibration_page()));
            }
            Order::State(answer) => {
                self.ask_state();
                self.tell_state();
                let _ = answer.send(Arc::clone(&self.told));
            }
            Order::Recording(answer) => {
                let _ = answer.send(self.recorder.as_ref().map(|recorder| recorder.progress().name.clone()));
            }
            Order::Samples(count, answer) => {
                let skip = self.past.len().saturating_sub(count);
                let _ = answer.send(self.past.iter().skip(skip).copied().collect());
            }
            // Handled where orders are taken.
            Order::Close(_) => {}
        }
    }

    fn with_rig<T>(&mut self, does: impl FnOnce(&mut dyn Rig) -> Result<T, Problem>) -> Result<T, Problem> {
        match &mut self.rig {
            Some(rig) => does(rig.as_mut()),
            None => Err(Problem::Gone(self.problem.clone().unwrap_or_else(|| "there is no rig".to_owned()))),
        }
    }

    /// The samples so far, and what follows them without a hole.
    fn watching(&mut self) -> Watching {
        self.send_frame();
        let events = self.events.subscribe();
        let mut past = vec![Event::State(Arc::clone(&self.told))];
        let bound_mm = self.state.bound_mm;
        // What is past carries the number of the last frame, so that the next one follows it.
        let frames = self.past.make_contiguous().chunks(PAST_FRAME).map(|samples| frame::encode(self.frames, bound_mm, samples));
        past.extend(frames.map(|frame| Event::Samples(frame.into())));
        Watching { past, events }
    }

    fn may(&self, client: &Client, role: Role) -> Result<(), Problem> {
        if client.role < role {
            let problem =
                format!("this needs the role {}, and yours is {}; open the address of that role", role.name(), client.role.name());
            return Err(Problem::Refused(problem));
        }
        if self.lease.is_held_by(client.number) {
            return Ok(());
        }
        Err(Problem::Refused(match self.lease.holder() {
            Some(holder) => format!("{} operates the rig; it has to give control back first", holder.name),
            None => "take control first".to_owned(),
        }))
    }

    fn act(&mut self, client: &Client, action: &Action) -> Result<Value, Problem> {
        if *action != Action::Vent {
            self.may(client, Role::needed(action))?;
        }
        match action {
            Action::Record { name, note } => {
                if self.recorder.is_some() {
                    return Err(Problem::Refused("a recording runs already; end it first".to_owned()));
                }
                self.remark = None;
                self.recorder = Some(Recorder::begin(&self.folder, name, note).map_err(Problem::Refused)?);
                Ok(json!({ "recording": name }))
            }
            Action::EndRecord => match self.recorder.take() {
                Some(recorder) => {
                    let progress = recorder.end(&self.identity).map_err(Problem::Refused)?;
                    Ok(json!({ "recorded": progress }))
                }
                None => Err(Problem::Refused("no recording runs".to_owned())),
            },
            action => {
                self.with_rig(|rig| rig.act(action))?;
                if matches!(action, Action::Plant { .. }) {
                    self.identity = self.rig.as_ref().map(|rig| rig.identity()).unwrap_or_default();
                }
                Ok(json!({ "done": true }))
            }
        }
    }

    fn upload(&mut self, blob: &[u8], settings: &[(String, Value)]) -> Result<Value, Problem> {
        if self.state.phase.is_energised() || self.state.task.is_some() {
            return Err(Problem::Refused("not while the rig is armed: vent first".to_owned()));
        }
        self.with_rig(|rig| {
            rig.upload(blob)?;
            settings.iter().try_for_each(|(name, value)| rig.act(&Action::Set { name: name.clone(), value: value.clone() }))
        })?;
        self.identity = self.rig.as_ref().map(|rig| rig.identity()).unwrap_or_default();
        Ok(json!({ "model_id": self.identity.model_id }))
    }

    fn end_recording(&mut self, why: &str) {
        if let Some(recorder) = self.recorder.take() {
            let outcome = recorder.end(&self.identity);
            self.remark = Some(format!("the recording ended: {}", outcome.map_or_else(|problem| problem, |_| why.to_owned())));
        }
    }

    fn close(&mut self) {
        self.end_recording("the server was closed");
        if let Some(rig) = &mut self.rig {
            rig.close();
        }
        self.audit.note("session", "close", "");
    }
}

fn in_words<T>(outcome: &Result<T, Problem>) -> String {
    match outcome {
        Ok(_) => "done".to_owned(),
        Err(problem) => problem.to_string(),
    }
}
