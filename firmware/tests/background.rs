//! Link, self-test and the model in use together: whose turn it is with the flash, and that nothing wanted is forgotten.

use std::cell::Cell;
use std::collections::VecDeque;
use std::num::NonZeroU16;

use firmware::background::{Background, ModelPlace};
use firmware::link::{CommandSink, Link, LinkConfig, Measured};
use firmware::model::{self, ModelFacts};
use firmware::storage::{Flash, Slot, Store};
use firmware::supervisor::Event;
use firmware::tick::{Action, Command, RigFacts};
use model_export::blob::crc32;
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::frame::Decoder;
use model_export::link::message::{MAX_CHUNK_BYTES, Message, Refusal, Reply, ReplyFrame, Request, RequestFrame};
use model_export::link::state::{ResetCause, State};

const FACTS: RigFacts = RigFacts { converter: firmware::calibration::ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };
const GOOD: [u8; 300] = [7; 300];

#[derive(Clone)]
struct Ram {
    slots: [Vec<u8>; 2],
    held: Cell<Option<Slot>>,
}

impl Ram {
    fn new() -> Self {
        Self { slots: [vec![0xff; 4096], vec![0xff; 4096]], held: Cell::new(None) }
    }

    fn with(payload: &[u8]) -> Self {
        let mut store = Store::new(Self::new(), model::STORE_KIND, model::STORE_VERSION);
        store.save(payload).unwrap();
        store.release()
    }

    fn slot(&mut self, slot: Slot) -> &mut [u8] {
        assert_ne!(self.held.get(), Some(slot), "what is in use is changed");
        &mut self.slots[usize::from(slot == Slot::B)]
    }
}

impl Flash for Ram {
    type Error = ();
    fn contents(&self, slot: Slot) -> &[u8] {
        &self.slots[usize::from(slot == Slot::B)]
    }
    fn erase(&mut self, slot: Slot) -> Result<(), ()> {
        self.slot(slot).fill(0xff);
        Ok(())
    }
    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), ()> {
        let bytes = &mut self.slot(slot)[offset as usize..][..4];
        bytes.iter_mut().zip(word.to_le_bytes()).for_each(|(byte, new)| *byte &= new);
        Ok(())
    }
    fn hold(&self, slot: Option<Slot>) {
        self.held.set(slot);
    }
}

/// Takes blobs that begin with a seven.
#[derive(Default)]
struct Place {
    model: Option<Vec<u8>>,
    admissions: usize,
}

impl ModelPlace for Place {
    fn load(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault> {
        self.admissions += 1;
        self.model = None;
        if blob.first() == Some(&6) {
            return Err(Fault::ModelTooSlow);
        }
        if blob.first() != Some(&7) {
            return Err(Fault::GoldenMismatch);
        }
        self.model = Some(blob.to_vec());
        Ok(ModelFacts { period: NonZeroU16::new(20).unwrap(), id: [7; 8] })
    }

    fn forget(&mut self) {
        self.model = None;
    }
}

#[derive(Default)]
struct Queue {
    commands: VecDeque<Command>,
    full: bool,
}

impl CommandSink for Queue {
    fn send(&mut self, command: Command) -> bool {
        if !self.full {
            self.commands.push_back(command);
        }
        !self.full
    }
    fn vent(&mut self) {}
}

impl Queue {
    fn actions(&mut self) -> Vec<Action> {
        self.commands.drain(..).map(|command| command.action).collect()
    }
}

struct Device {
    background: Background<Ram, Ram>,
    place: Place,
    queue: Queue,
    token: u32,
}

impl Device {
    fn new(models: Ram) -> Self {
        let board = heapless::String::try_from("bench").unwrap();
        let config = LinkConfig { firmware: [0, 1, 0], board, reset_cause: ResetCause::PowerOn, previous_record: None, facts: FACTS };
        let mut background = Background::new(Link::new(config, Ram::new(), models));
        background.link_mut().observe(State::Idle, true, Measured::default());
        background.link_mut().take_every_session();
        Self { background, place: Place::default(), queue: Queue::default(), token: 0 }
    }

    fn round(&mut self, faults: FaultSet) {
        self.background.self_test(|| faults, &mut self.place, &mut self.queue);
    }

    fn tested(models: Ram) -> Self {
        let mut device = Self::new(models);
        device.background.want_self_test();
        device.round(FaultSet::EMPTY);
        device.queue.commands.clear();
        device
    }

    fn ask(&mut self, request: Request) -> Reply {
        self.token += 1;
        for byte in (RequestFrame { token: self.token, session: 0, request }).to_wire().unwrap() {
            self.background.receive(byte, &mut self.place, &mut self.queue);
        }
        let wire = self.background.link_mut().transmit().expect("an answer at once").to_vec();
        let mut decoder = Decoder::new();
        let replies = wire.iter().filter_map(|byte| decoder.push(*byte).map(|payload| ReplyFrame::from_payload(payload.unwrap()).unwrap()));
        replies.last().unwrap().reply
    }

    fn upload(&mut self, blob: &[u8]) -> Reply {
        assert_eq!(self.ask(Request::ModelBegin { length: blob.len() as u32, crc32: crc32(0, blob) }), Reply::Done);
        for (index, piece) in blob.chunks(MAX_CHUNK_BYTES).enumerate() {
            let bytes = heapless::Vec::from_slice(piece).unwrap();
            let offset = (index * MAX_CHUNK_BYTES) as u32;
            assert_eq!(self.ask(Request::ModelChunk { offset, bytes }), Reply::Uploaded(offset + piece.len() as u32));
        }
        self.ask(Request::ModelFinish)
    }

    fn held(&self) -> Option<Slot> {
        self.background.link().flash().1.held.get()
    }
}

#[test]
fn a_model_that_passes_is_in_use_and_its_slot_is_held() {
    let mut device = Device::new(Ram::with(&GOOD));
    device.round(FaultSet::EMPTY);
    assert_eq!((device.queue.actions().len(), device.held()), (0, None), "nobody wanted a test");
    device.background.want_self_test();
    device.round(FaultSet::EMPTY);
    let period = NonZeroU16::new(20);
    assert_eq!(device.queue.actions(), [Action::SelfTestReport { faults: FaultSet::EMPTY, model_period: period }]);
    assert_eq!((device.place.model.as_deref(), device.held()), (Some(&GOOD[..]), Some(Slot::A)));
    device.round(FaultSet::EMPTY);
    assert_eq!(device.queue.actions(), [], "one report for one test");
}

#[test]
fn a_model_that_fails_is_a_fault_and_neither_used_nor_held() {
    let mut device = Device::new(Ram::with(&[8; 300]));
    device.background.want_self_test();
    device.round(FaultSet::EMPTY);
    let faults = [Fault::GoldenMismatch].into_iter().collect();
    assert_eq!(device.queue.actions(), [Action::SelfTestReport { faults, model_period: None }]);
    assert_eq!((device.place.model.as_deref(), device.held()), (None, None));
}

#[test]
fn no_model_is_touched_while_anything_else_is_wrong() {
    let mut device = Device::new(Ram::with(&GOOD));
    let faults: FaultSet = [Fault::ClockFailed].into_iter().collect();
    device.background.want_self_test();
    device.round(faults);
    assert_eq!(device.queue.actions(), [Action::SelfTestReport { faults, model_period: None }]);
    assert_eq!((device.place.admissions, device.held()), (0, None));
}

#[test]
fn the_check_of_an_upload_takes_the_model_in_use_away_until_the_next_test() {
    let too_slow = Reply::Refused(Refusal::ModelTooSlow);
    for (blob, outcome) in [([7, 7, 7, 9], Reply::Done), ([9; 4], Reply::Refused(Refusal::NotAModel)), ([6; 4], too_slow)] {
        let mut device = Device::tested(Ram::with(&GOOD));
        assert_eq!(device.upload(&blob), outcome);
        assert_eq!(device.place.admissions, 2);
        assert_eq!((device.place.model.as_deref(), device.held()), (None, None));
        assert_eq!(device.queue.actions(), [Action::Request(Event::Retest)]);
        device.background.want_self_test();
        device.round(FaultSet::EMPTY);
        assert_eq!((device.place.model.as_deref(), device.held()), (Some(&GOOD[..]), Some(Slot::A)), "the active one comes back");
    }
}

#[test]
fn an_activated_model_comes_with_the_next_test_and_the_one_before_can_be_overwritten() {
    let mut other = [7; 32];
    other[20..28].copy_from_slice(&[9; 8]);
    let mut device = Device::tested(Ram::with(&GOOD));
    assert_eq!(device.upload(&other), Reply::Done);
    assert_eq!(device.ask(Request::ModelActivate { id: [9; 8] }), Reply::Done);
    device.background.want_self_test();
    device.round(FaultSet::EMPTY);
    assert_eq!((device.place.model.as_deref(), device.held()), (Some(&other[..]), Some(Slot::B)));
    // Into the slot of the first; the flash of this test refuses the other one.
    assert_eq!(device.upload(&GOOD), Reply::Done);
}

#[test]
fn a_full_queue_delays_retest_and_report_and_loses_neither() {
    let mut device = Device::tested(Ram::with(&GOOD));
    device.queue.full = true;
    assert_eq!(device.upload(&GOOD), Reply::Done);
    device.round(FaultSet::EMPTY);
    assert_eq!(device.queue.actions(), []);
    device.queue.full = false;
    device.round(FaultSet::EMPTY);
    assert_eq!(device.queue.actions(), [Action::Request(Event::Retest)]);
    device.queue.full = true;
    device.background.want_self_test();
    device.round(FaultSet::EMPTY);
    device.queue.full = false;
    device.round(FaultSet::EMPTY);
    assert_eq!(device.queue.actions().len(), 1);
}
