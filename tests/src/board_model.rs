//! The flashable image on the model of its chip, with the realistic rig or simple hardware around it.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Instant;

use host_tool::backend::BOARD_MODEL;
use host_tool::excitation::{ExcitationConfig, Limits, Segment, Signal};
use host_tool::experiment::{self, OverTheLink};
use host_tool::link::{BoardModel, BoardModelConfig, Client, FlashMemory, Hardware, LinkError, Lockstep, Observer, TickRecord};
use host_tool::replay_log::{ReplayLog, Tracing, replay};
use host_tool::track::compare::{self, Run};
use host_tool::track::rig::{self, Mover, Truth};
use host_tool::track::{Controller, Reference, SettingValues, run};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// A client of the image.
pub type ModelRig<O = ()> = Client<Lockstep<BoardModel, O>>;

/// Program and image, as the environment names them or where they are built.
///
/// # Panics
/// When they are missing, with the command to type.
#[must_use]
pub fn config() -> BoardModelConfig {
    BoardModelConfig::find(None).unwrap_or_else(|error| panic!("{error}"))
}

/// The same, with the image of another board, which lies beside the first one's.
///
/// # Panics
/// When it is missing.
#[must_use]
pub fn config_of(board: &str) -> BoardModelConfig {
    let image = config().image.with_file_name(format!("rig-{board}"));
    BoardModelConfig::find(Some(&image)).unwrap_or_else(|error| panic!("{error}: `cargo xtask firmware --board {board}`"))
}

/// Time from power until an image answers, ms: the first start of an F405 programs its option bytes, 200 ms.
const UP_MS: u32 = 250;

/// Lets the image come up and meets it.
///
/// # Errors
/// When it does not answer, with what it logged.
pub fn meet<O: Observer>(mut lockstep: Lockstep<BoardModel, O>) -> Result<ModelRig<O>, LinkError> {
    lockstep.advance_for(UP_MS)?;
    Client::connect(lockstep)
}

/// SHA-256 of the image, in hexadecimal.
///
/// # Panics
/// When it cannot be read.
#[must_use]
pub fn image_sha256(image: &Path) -> String {
    let bytes = std::fs::read(image).unwrap_or_else(|error| panic!("{}: {error}", image.display()));
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Names of the registers that the image touched and no model answered for.
///
/// # Panics
/// When the program is gone.
pub fn unmodelled<O: Observer>(client: &mut ModelRig<O>) -> Vec<String> {
    let report = client.transport().processor().report().expect("a report");
    let report: Value = serde_json::from_str(&report).expect("a report in JSON");
    let names = |key: &str| report[key].as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect::<Vec<_>>();
    [names("without_model"), names("refused")].concat()
}

/// What a closed loop gave.
#[derive(Clone, Debug)]
pub struct Slice {
    /// Virtual time, s.
    pub virtual_s: f64,
    /// Time on the wall, s.
    pub wall_s: f64,
    /// Registers that no model answered for.
    pub unmodelled: Vec<String>,
    /// Ticks of the replay log.
    pub ticks: u64,
    /// Whether the library in this process gives the same outputs, tick by tick, to the bit.
    pub bit_equal: bool,
    /// What differs first, or why the replay log ends too early.
    pub difference: Option<String>,
    /// What was logged.
    pub log: String,
}

impl Slice {
    fn of<O: Observer>(client: &mut ModelRig<O>, replay_log: &ReplayLog, begun: Instant) -> Self {
        let replay = replay(replay_log).expect("a replay log that can be run again");
        let unmodelled = unmodelled(client);
        let processor = client.transport().processor();
        Self {
            virtual_s: processor.pins().time_ns as f64 * 1e-9,
            wall_s: begun.elapsed().as_secs_f64(),
            unmodelled,
            ticks: replay.ticks,
            bit_equal: replay.is_identical() && replay.cut.is_none(),
            difference: replay.first_difference.map(|first| format!("{first:?}")).or(replay.cut.map(|cut| cut.in_words())),
            log: processor.log().to_owned(),
        }
    }
}

/// Plays decaying sines with the realistic rig around the image and this model on it.
///
/// # Panics
/// When the experiment cannot be done.
#[must_use]
pub fn played(blob: &[u8], seconds: f64, seed: u64) -> Slice {
    played_on(&config(), blob, seconds, seed)
}

/// As [`played`], with this board's image.
///
/// # Panics
/// When the experiment cannot be done.
#[must_use]
pub fn played_on(config: &BoardModelConfig, blob: &[u8], seconds: f64, seed: u64) -> Slice {
    let begun = Instant::now();
    let settings = model_export::link::settings::Settings { mismatch_displacement_mm: 0.0, ..Default::default() };
    let flash = FlashMemory::with_model(blob).and_then(|flash| flash.with_settings(&settings)).expect("flash");
    let (hardware, _) = Mover::Realistic.hardware(seed, 1);
    let processor = BoardModel::start(config.clone(), &flash).unwrap_or_else(|error| panic!("{error}"));
    let lockstep = Lockstep::new(processor, hardware, (), "the board's model", BOARD_MODEL).expect("a start");
    let mut client = meet(lockstep).unwrap_or_else(|error| panic!("{error}"));
    let signal = Signal::DescendingSine { amplitude_bar: 1.4, frequency_hz: 0.5, decay_per_s: 0.05, offset_bar: 0.0 };
    let segments = vec![Segment { duration_s: seconds, signal }];
    let excitation = ExcitationConfig { sample_period_s: 0.02, noise_bar: 0.0, seed: 1, segments };
    let wanted = OverTheLink { backend: BOARD_MODEL, blob: Some(blob) };
    let outcome = experiment::record(&mut client, &excitation, &Limits::default(), Some(wanted)).expect("an experiment");
    assert!(outcome.fault.is_none(), "{:?}", outcome.fault);
    Slice::of(&mut client, &outcome.replay_log.expect("a replay log"), begun)
}

/// Lets a controller follow a reference on the realistic rig around the image.
///
/// # Panics
/// When the run cannot be done.
#[must_use]
pub fn followed(settings: &SettingValues, blob: &[u8], controller: Controller, reference: &Reference, seed: u64) -> (Slice, Run) {
    let begun = Instant::now();
    let processor = BoardModel::start(config(), &FlashMemory::default()).unwrap_or_else(|error| panic!("{error}"));
    let (mut client, truth): (_, Truth) =
        rig::connect(processor, Mover::Realistic.hardware(seed, 1), "the board's model", None).expect("a connection");
    run::prepare(&mut client, settings, Some(blob)).expect("a prepared rig");
    let tracing = Tracing::begin(&mut client, BOARD_MODEL, Some(blob)).expect("a trace");
    let run = compare::follow(&mut client, &truth, controller, reference).unwrap_or_else(|error| {
        let status = experiment::status(&mut client);
        let account = client.account().clone();
        panic!("{}: {error}; {status:?}; {account:?}; {:?}", controller.name, client.transport().processor().pins())
    });
    let replay_log = tracing.end(&mut client);
    (Slice::of(&mut client, &replay_log, begun), run)
}

/// A tick as the surroundings saw it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Whether the dump valve was energised.
    pub energised: bool,
    /// The valve's drive.
    pub valve_share: u16,
    /// True pressure before the tick, bar.
    pub pressure_bar: f64,
}

/// Writes every tick down.
#[derive(Clone, Debug, Default)]
pub struct Watch(Rc<RefCell<Vec<Moment>>>);

impl Watch {
    /// Ticks so far.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.borrow().len()
    }

    /// Whether there was none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The ticks from this one on.
    #[must_use]
    pub fn since(&self, tick: usize) -> Vec<Moment> {
        self.0.borrow().get(tick..).unwrap_or_default().to_vec()
    }
}

impl Observer for Watch {
    fn see(&mut self, record: &TickRecord<'_>, hardware: &Hardware) {
        let moment = |energised, valve_share| Moment { energised, valve_share, pressure_bar: hardware.pressure_bar() };
        match record {
            TickRecord::Tick { outputs, .. } => self.0.borrow_mut().push(moment(outputs.energised, outputs.valve_share)),
            TickRecord::Silence => self.0.borrow_mut().push(moment(false, 0)),
            TickRecord::Boot { .. } => {}
        }
    }
}

/// Where the built image lies, for messages.
#[must_use]
pub fn image() -> PathBuf {
    config().image
}
