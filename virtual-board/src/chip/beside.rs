//! A model of the crate with something beside it: what this chip's wiring adds, without a second copy of the model.

use rigless::device::{Device, DeviceContext, RegisterFile, RequestChange};
use rigless::soc::{RegisterSpec, Width};
use rigless::time::{EventId, VirtualNanos};

/// What stands beside a model `M`. Every method defaults to nothing.
pub trait Beside<M: Device> {
    /// What a read answers, from what the model answers.
    fn answer(&self, register: M::Register, value: u64) -> u64 {
        let _ = register;
        value
    }

    /// After the model was written to, heard a request, or had an event.
    fn after(&mut self, model: &mut M, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let _ = (model, registers, context);
    }

    /// Another instance's request, before the model hears it.
    fn request(&mut self, change: RequestChange, model: &mut M, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let _ = (change, model, registers, context);
    }

    /// An event of the model has passed.
    fn event(&mut self, model: &mut M, registers: &mut RegisterFile) {
        let _ = (model, registers);
    }

    /// A reset.
    fn reset(&mut self) {}
}

/// The model and what is beside it.
#[derive(Debug)]
pub struct With<M, B> {
    /// The model.
    pub model: M,
    /// What is beside it.
    pub beside: B,
}

impl<M: Device, B: Beside<M>> Device for With<M, B>
where
    M::Register: Copy,
{
    type Register = M::Register;

    fn layout(&self) -> &'static [RegisterSpec] {
        self.model.layout()
    }

    fn read(&mut self, register: M::Register, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        let value = self.model.read(register, registers, context);
        self.beside.after(&mut self.model, registers, context);
        let held = value.unwrap_or_else(|| registers.get(register));
        let answer = self.beside.answer(register, held);
        // The file's own answer has read actions; it stays unless something beside the model changes it.
        if value.is_none() && answer == held { None } else { Some(answer) }
    }

    fn peek(&self, register: M::Register, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        self.model.peek(register, registers, now)
    }

    fn write(&mut self, register: M::Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.write(register, value, registers, context);
        self.beside.after(&mut self.model, registers, context);
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.on_event(event, registers, context);
        self.beside.event(&mut self.model, registers);
        self.beside.after(&mut self.model, registers, context);
    }

    fn on_request(&mut self, change: RequestChange, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.beside.request(change, &mut self.model, registers, context);
        self.model.on_request(change, registers, context);
        self.beside.after(&mut self.model, registers, context);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.on_clock(hz, registers, context);
    }

    fn on_access(&mut self, token: u64, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.on_access(token, value, registers, context);
    }

    fn on_refused(&mut self, token: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.on_refused(token, registers, context);
    }

    fn write_region(
        &mut self,
        address: u64,
        width: Width,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        self.model.write_region(address, width, value, registers, context)
    }

    fn poll(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.poll(registers, context);
    }

    fn reset(&mut self) {
        self.model.reset();
        self.beside.reset();
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.model.reset_line(registers, context);
        self.beside.reset();
    }
}
