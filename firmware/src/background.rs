//! The background: link, self-test and the model in use together, in whatever time the tick leaves.
//!
//! A board calls it round by round from its idle loop, a device in lock step once a tick. Nothing here waits, but a self-test takes as long as
//! its golden vectors do.
//!
//! A model is in use from the self-test that admitted it until something could change it: then it is forgotten first, its slot is free, and
//! the next self-test decides again. So no code that could write flash runs while a model reads it.

use core::borrow::BorrowMut;

use model_export::link::fault::{Fault, FaultSet};

use crate::link::{CommandSink, Event, Link, LinkBuffers};
use crate::model::ModelFacts;
use crate::self_test::Report;
use crate::storage::Flash;
use crate::supervisor;
use crate::tick::{Action, Command};

/// Where the model in use lives, and how it runs.
///
/// The flash holds blobs. A model may go on reading its own: it is taken away before the slot can be rewritten.
pub trait ModelPlace {
    /// Checks a blob of the flash as the self-test does, and makes it the model in use if it passes. The model before is forgotten in any case.
    ///
    /// # Errors
    /// The fault to raise.
    fn load(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault>;

    /// Leaves no model.
    fn forget(&mut self);
}

/// Everything that runs outside of interrupts.
#[derive(Debug)]
pub struct Background<S, M, B = LinkBuffers> {
    link: Link<S, M, B>,
    wanted: bool,
    retest: bool,
    report: Option<Report>,
}

impl<S: Flash, M: Flash, B: BorrowMut<LinkBuffers>> Background<S, M, B> {
    /// A background that has not run yet.
    pub fn new(link: Link<S, M, B>) -> Self {
        Self { link, wanted: false, retest: false, report: None }
    }

    /// The link.
    pub fn link(&self) -> &Link<S, M, B> {
        &self.link
    }

    /// The link.
    pub fn link_mut(&mut self) -> &mut Link<S, M, B> {
        &mut self.link
    }

    /// Takes a byte from the line and does what comes of it.
    pub fn receive(&mut self, byte: u8, place: &mut impl ModelPlace, commands: &mut impl CommandSink) {
        // What follows is not on the stack together with the request.
        let Some(event) = self.link.receive(byte, commands) else { return };
        if event == Event::ModelUploaded {
            let checked = self.link.uploaded_model().map_or(Err(Fault::ModelCorrupt), |blob| place.load(blob));
            self.link.finish_upload(checked.map(|_| ()), commands);
        }
        // At once, before an upload can want the slot of the model before. The self-test puts the active model back.
        self.unload(place);
        self.retest = true;
        self.ask_for_retest(commands);
    }

    /// The tick wants a self-test.
    pub fn want_self_test(&mut self) {
        self.wanted = true;
    }

    /// Tests when that is wanted, and reports as soon as the queue takes the report. `faults` tells what is wrong with program and board.
    pub fn self_test(&mut self, faults: impl FnOnce() -> FaultSet, place: &mut impl ModelPlace, commands: &mut impl CommandSink) {
        self.ask_for_retest(commands);
        if core::mem::take(&mut self.wanted) {
            let faults = faults().union(self.link.standing_faults());
            self.report = Some(self.examine(faults, place));
        }
        if let Some(report) = self.report
            && commands.send(Command { token: None, action: report.action() })
        {
            self.report = None;
        }
    }

    fn ask_for_retest(&mut self, commands: &mut impl CommandSink) {
        if self.retest {
            let retest = Action::Request(supervisor::Event::Retest);
            self.retest = !commands.send(Command { token: None, action: retest });
        }
    }

    fn unload(&mut self, place: &mut impl ModelPlace) {
        place.forget();
        self.link.flash().1.hold(None);
        self.link.set_model(None);
    }

    fn examine(&mut self, faults: FaultSet, place: &mut impl ModelPlace) -> Report {
        self.unload(place);
        let mut report = Report { faults, model: None };
        // A model runs only where everything else is in order: its memory may be missing on what is not the real board.
        if faults.is_empty()
            && let Some(blob) = self.link.model_blob()
        {
            match place.load(blob) {
                Ok(facts) => {
                    self.link.flash().1.hold(self.link.model_slot());
                    report.model = Some(facts);
                }
                Err(fault) => report.faults.insert(fault),
            }
        }
        self.link.set_model(report.model);
        report
    }
}
