//! The replay log itself: header, events, the file, and what writes them.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use firmware::device::DeviceInputs;
use firmware::device::exchange::DeviceOutputs;
use firmware::drivers::RawSample;
use firmware::settings;
use firmware::storage::{Flash, Slot, Store};
use model_export::blob::{self, crc32};
use model_export::link::fault::Fault;
use model_export::link::settings::Settings;
use model_export::link::state::{ResetCause, State};
use serde::{Deserialize, Serialize};

use crate::link::{Boot, Cut, FlashMemory, Hardware, Observer, TickRecord, TracedTick};

const MAGIC: &[u8; 8] = b"CATHJRNL";
/// Version of the format.
pub const VERSION: u16 = 3;
const HEADER_BYTES: usize = 16;

/// What the device started from, and who wrote the replay log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the program that wrote it.
    pub program: String,
    /// Version of the firmware.
    pub firmware: [u16; 3],
    /// Name that the device gave.
    pub board: String,
    /// Where it ran: `virtual`, `qemu` or `serial`.
    pub backend: String,
    /// The simulated plant, as TOML; empty without one.
    pub plant: String,
    /// The flash's four slots (settings A and B, models A and B) without the erased bytes at their ends.
    flash: Vec<Vec<u8>>,
}

/// One thing that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// The processor started.
    Boot {
        /// Why.
        reset_cause: ResetCause,
        /// Bytes its line to the host takes in a tick.
        line_bytes_per_tick: u16,
        /// Number of the fault that crashed it before, 0 for none.
        crash: u8,
    },
    /// It did a tick.
    Tick(Tick),
    /// A tick passed without it.
    Silence,
    /// It began again to be traced; the ticks that follow are [`Event::Traced`].
    Begin {
        /// Ticks since its start.
        time_ms: u64,
        /// Ticks of them that were late or lost.
        late_ticks: u32,
        /// Why it had started.
        reset_cause: ResetCause,
    },
    /// It did a tick, and told it over the link.
    Traced(TracedTick),
    /// What follows did not arrive.
    Cut(Cut),
    /// The recording that was written beside the replay log; new in version 3.
    Recording {
        /// SHA-256 of its file.
        sha256: [u8; 32],
    },
}

/// A tick's inputs and outputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tick {
    /// Laser code.
    pub laser_code: u16,
    /// Pressure code.
    pub pressure_code: u16,
    /// Whether the emergency stop was pressed.
    pub emergency_stop: bool,
    /// Whether the tick before took too long.
    pub overran: bool,
    /// Ticks lost before this one.
    pub lost_ticks: u16,
    /// Bytes from the host before the tick.
    pub from_host: Vec<u8>,
    /// What it did to the hardware.
    pub outputs: Outputs,
}

/// A tick's outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outputs {
    /// Whether the dump valve was energised.
    pub energised: bool,
    /// Whether the watchdog was fed.
    pub feed_watchdog: bool,
    /// The state.
    pub state: State,
    /// The valve's drive.
    pub valve_share: u16,
    /// What that means, in microbar.
    pub output_ubar: i32,
    /// CRC-32 of the bytes for the host, 0 for none.
    pub to_host_crc32: u32,
}

impl Outputs {
    pub(crate) fn new(outputs: &DeviceOutputs, to_host: &[u8]) -> Self {
        Self {
            energised: outputs.energised,
            feed_watchdog: outputs.feed_watchdog,
            state: outputs.state,
            valve_share: outputs.valve_share,
            output_ubar: outputs.output_ubar,
            to_host_crc32: crc32(0, to_host),
        }
    }
}

impl Tick {
    /// What the hardware brought.
    #[must_use]
    pub fn inputs(&self) -> DeviceInputs {
        DeviceInputs {
            sample: RawSample { laser_code: self.laser_code, pressure_code: self.pressure_code },
            emergency_stop: self.emergency_stop,
            overran: self.overran,
            lost_ticks: self.lost_ticks,
        }
    }
}

/// A whole replay log.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayLog {
    /// What the device started from.
    pub header: Header,
    /// What happened, in order.
    pub events: Vec<Event>,
}

impl Header {
    /// The header of a replay log that begins with this flash.
    #[must_use]
    pub fn new(backend: &str, board: &str, plant: String, flash: &FlashMemory) -> Self {
        let trimmed = |bytes: &[u8]| {
            let length = bytes.iter().rposition(|byte| *byte != 0xff).map_or(0, |last| last + 1);
            bytes[..length].to_vec()
        };
        let slots = [&flash.settings, &flash.models].into_iter().flat_map(|pair| Slot::BOTH.map(|slot| trimmed(pair.contents(slot))));
        Self {
            program: env!("CARGO_PKG_VERSION").to_owned(),
            firmware: crate::link::FIRMWARE,
            board: board.to_owned(),
            backend: backend.to_owned(),
            plant,
            flash: slots.collect(),
        }
    }

    /// The flash that the device started with.
    #[must_use]
    pub fn flash(&self) -> FlashMemory {
        let mut flash = FlashMemory::default();
        for (pair, slots) in [&mut flash.settings, &mut flash.models].into_iter().zip(self.flash.chunks(2)) {
            for (slot, bytes) in Slot::BOTH.into_iter().zip(slots) {
                pair.contents_mut(slot).iter_mut().zip(bytes).for_each(|(byte, kept)| *byte = *kept);
            }
        }
        flash
    }

    /// The settings that the device started with.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let store = Store::new(self.flash().settings, settings::STORE_KIND, settings::STORE_VERSION);
        store.active_payload().map(settings::decode).unwrap_or_default().settings
    }

    /// SHA-256 of the active model's contents in hexadecimal: the blob's identity.
    #[must_use]
    pub fn blob_sha256(&self) -> Option<String> {
        let store = Store::new(self.flash().models, firmware::model::STORE_KIND, firmware::model::STORE_VERSION);
        let hash = blob::decode(store.active_payload()?).ok()?.content_hash;
        Some(hash.iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

impl ReplayLog {
    /// Ticks in it.
    #[must_use]
    pub fn ticks(&self) -> usize {
        self.events.iter().filter(|event| matches!(event, Event::Tick(_) | Event::Silence | Event::Traced(_))).count()
    }

    /// The events as they lie in a file.
    ///
    /// # Errors
    /// Never: every event can be encoded.
    pub fn event_bytes(&self) -> Result<Vec<u8>> {
        self.events.iter().try_fold(Vec::new(), |bytes, event| Ok(postcard::to_extend(event, bytes)?))
    }

    /// As the bytes of a file.
    ///
    /// # Errors
    /// Never: everything in a replay log can be encoded.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let mut body = postcard::to_stdvec(&self.header)?;
        body.append(&mut self.event_bytes()?);
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(&crc32(0, &body).to_le_bytes());
        bytes.append(&mut body);
        Ok(bytes)
    }

    /// From the bytes of a file.
    ///
    /// # Errors
    /// When they are no replay log, a damaged one, or one of a later version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let Some((head, mut body)) = bytes.split_first_chunk::<HEADER_BYTES>() else { bail!("is no replay log: it is too short") };
        ensure!(head.starts_with(MAGIC), "is no replay log; `catheter rig record` leaves one beside its CSV");
        let version = u16::from_le_bytes([head[8], head[9]]);
        ensure!((1..=VERSION).contains(&version), "is a replay log of format version {version}, this program reads up to {VERSION}");
        let checksum = u32::from_le_bytes([head[12], head[13], head[14], head[15]]);
        ensure!(crc32(0, body) == checksum, "is damaged: its checksum is wrong");
        let (header, rest) = postcard::take_from_bytes(body).context("is damaged: its header does not decode")?;
        body = rest;
        let mut events = Vec::new();
        while !body.is_empty() {
            let (event, rest) =
                postcard::take_from_bytes(body).with_context(|| format!("is damaged: event {} does not decode", events.len()))?;
            events.push(event);
            body = rest;
        }
        Ok(Self { header, events })
    }

    /// Reads a file.
    ///
    /// # Errors
    /// As [`ReplayLog::from_bytes`], with the file's name.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        Self::from_bytes(&bytes).with_context(|| path.display().to_string())
    }

    /// Writes a file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        output::write_atomic(path, &self.to_bytes()?)
    }

    /// Writes a file beside a recording that was written before, with the recording's hash.
    ///
    /// # Errors
    /// When the recording cannot be read or the file cannot be written.
    pub fn write_beside(&self, path: &Path, recording: &Path) -> Result<()> {
        let mut replay_log = self.clone();
        replay_log.events.retain(|event| !matches!(event, Event::Recording { .. }));
        replay_log.events.push(Event::Recording { sha256: hash(recording)? });
        replay_log.write(path)
    }

    /// Refuses a recording that the replay log does not belong to; journals before version 3 know none.
    ///
    /// # Errors
    /// When it is another one, or cannot be read.
    pub fn check_recording(&self, recording: &Path) -> Result<()> {
        let known = self.events.iter().find_map(|event| if let Event::Recording { sha256 } = event { Some(sha256) } else { None });
        let Some(known) = known else { return Ok(()) };
        ensure!(
            hash(recording)? == *known,
            "the replay log beside {} belongs to another recording; name the replay log itself to replay it, or record again",
            recording.display()
        );
        Ok(())
    }
}

/// SHA-256 of a file.
fn hash(path: &Path) -> Result<[u8; 32]> {
    use sha2::{Digest, Sha256};
    let bytes = output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    Ok(Sha256::digest(&bytes).into())
}

/// Writes a replay log while a simulated rig runs.
pub struct Recorder {
    replay_log: ReplayLog,
}

impl Recorder {
    /// A replay log that begins with this header.
    #[must_use]
    pub fn new(header: Header) -> Self {
        Self { replay_log: ReplayLog { header, events: Vec::new() } }
    }

    /// The replay log so far.
    #[must_use]
    pub fn replay_log(&self) -> &ReplayLog {
        &self.replay_log
    }
}

impl Observer for Recorder {
    fn see(&mut self, record: &TickRecord<'_>, _hardware: &Hardware) {
        self.replay_log.events.push(match record {
            TickRecord::Boot { boot: Boot { reset_cause, line_bytes_per_tick, .. }, crash } => {
                Event::Boot { reset_cause: *reset_cause, line_bytes_per_tick: *line_bytes_per_tick, crash: crash.map_or(0, Fault::number) }
            }
            TickRecord::Tick { inputs, from_host, outputs, to_host } => Event::Tick(Tick {
                laser_code: inputs.sample.laser_code,
                pressure_code: inputs.sample.pressure_code,
                emergency_stop: inputs.emergency_stop,
                overran: inputs.overran,
                lost_ticks: inputs.lost_ticks,
                from_host: from_host.to_vec(),
                outputs: Outputs::new(outputs, to_host),
            }),
            TickRecord::Silence => Event::Silence,
        });
    }
}
