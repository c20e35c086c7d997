//! The run: a millisecond at a time as the surroundings ask, with what they break.

use std::io::{Read, Write};

use rigless::emulator::{Driver, Host, Memory, Settled, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::board::RigBoard;
use crate::chip::flash::sector;
use crate::chip::pins::SUPPLY_MV;
use crate::core::nmi;
use crate::line::FarEnd;
use crate::log::Log;
use crate::part::{Change, RigPart};
use crate::protocol::{self, Fault, Request};
use crate::touched::Touched;

const MILLISECOND: u64 = 1_000_000;
/// How long the supply is gone after a cut.
const CUT_MS: u64 = 100;
/// Who drives the run.
#[derive(Debug)]
pub struct Machine<I, O> {
    input: I,
    output: O,
    far_end: FarEnd,
    log: Option<Log>,
    touched: Touched,
    chance: Chance,
    /// Where the tick under way ends.
    tick_end: Option<VirtualNanos>,
    powered_before: bool,
    standing: bool,
    hung_since_reset: Option<usize>,
    operations_to_cut: Option<u32>,
    cut_at: Option<VirtualNanos>,
    power_back: Option<VirtualNanos>,
    groups_before: u64,
    groups: u64,
    /// Why the conversation broke.
    pub broken: Option<std::io::Error>,
}

impl<I: Read, O: Write> Machine<I, O> {
    /// A run that these streams ask for; equal seeds leave equal bits in memory without supply.
    pub fn new(input: I, output: O, far_end: FarEnd, log: Option<Log>, seed: u64) -> Self {
        Self {
            input,
            output,
            far_end,
            log,
            touched: Touched::default(),
            chance: Chance(seed ^ 0x9e37_79b9_7f4a_7c15),
            tick_end: None,
            powered_before: false,
            standing: false,
            hung_since_reset: None,
            operations_to_cut: None,
            cut_at: None,
            power_back: None,
            groups_before: 0,
            groups: 0,
            broken: None,
        }
    }

    /// Flash: the processor stands while it is busy, and the array changes when it is done.
    fn follow_flash<P: RigPart>(&mut self, session: &mut Session<RigBoard<P>>, host: &mut dyn Host, now: VirtualNanos) {
        let part = &mut session.board_mut().part;
        let running = part.flash_running();
        let finished = part.take_flash_changes();
        for change in finished {
            apply(change, host, |_, new| new);
        }
        match (running, self.standing) {
            (Some(change), false) => {
                self.standing = true;
                host.hold(true);
                if let Some(left) = self.operations_to_cut.as_mut() {
                    *left -= 1;
                    if *left == 0 {
                        self.operations_to_cut = None;
                        // Half-way through its typical time.
                        let half = if matches!(change, Change::Erase { .. }) { 500 * MILLISECOND } else { 8_000 };
                        self.cut_at = Some(VirtualNanos(now.0 + half));
                        self.aim(session);
                    }
                }
            }
            (None, true) => {
                self.standing = false;
                if !session.unpowered() && self.hung_since_reset.is_none() {
                    host.hold(false);
                }
            }
            _ => {}
        }
    }

    /// Asks the run to stop where something is due next.
    fn aim<P: RigPart>(&self, session: &mut Session<RigBoard<P>>) {
        if let Some(end) = self.tick_end {
            session.run_until(self.cut_at.map_or(end, |cut| cut.min(end)));
        }
    }

    /// Power goes; an operation on flash stays half done.
    fn cut<P: RigPart>(&mut self, session: &mut Session<RigBoard<P>>, host: &mut dyn Host, now: VirtualNanos) {
        if let Some(change) = session.board().part.flash_running() {
            let chance = &mut self.chance;
            apply(change, host, |old, new| {
                let which = chance.next();
                old & which | new & !which
            });
        }
        session.board_mut().part.set_supply(0, now);
        self.power_back = Some(VirtualNanos(now.0 + CUT_MS * MILLISECOND));
    }

    fn forget<P: RigPart>(&mut self, host: &mut dyn Host) {
        for (start, length) in P::FORGETFUL.iter().copied() {
            for address in (start..start + length).step_by(8) {
                let _ = host.write(address, Width::W64, self.chance.next());
            }
        }
    }

    fn answer_tick<P: RigPart>(&mut self, session: &mut Session<RigBoard<P>>, stop: Stop, host: &mut dyn Host) -> std::io::Result<()> {
        let part = &session.board().part;
        let outputs = part.outputs();
        let groups = part.groups();
        // The part counts from its own reset.
        self.groups += if groups >= self.groups_before { groups - self.groups_before } else { groups };
        self.groups_before = groups;
        let (compare, period) = outputs.pulse.map_or((0, 0), |(compare, reload)| (compare, reload.saturating_add(1)));
        let unpowered = session.unpowered();
        let state = u8::from(outputs.dump_valve) | u8::from(unpowered) << 1 | u8::from(self.standing) << 2;
        // What is sent while the pins are not the serial port's reaches nobody.
        let (speaks, _) = part.line_is_connected();
        let line = self.far_end.with(|wire| std::mem::take(&mut wire.from_part));
        let line = if speaks { line } else { Vec::new() };
        let text = self.log.as_mut().filter(|_| !unpowered).map(|log| log.take(host)).unwrap_or_default();
        let mut body = Vec::with_capacity(48 + line.len() + text.len());
        body.extend(stop.at.0.to_le_bytes());
        body.extend(outputs.drive_code.unwrap_or(u16::MAX).to_le_bytes());
        body.extend(compare.to_le_bytes());
        body.extend(period.to_le_bytes());
        body.push(state);
        body.extend(low(self.groups).to_le_bytes());
        body.extend(low(session.resets().len() as u64).to_le_bytes());
        body.extend(stop.instruction_count.to_le_bytes());
        body.extend(low(line.len() as u64).to_le_bytes());
        body.extend(line);
        body.extend(text.into_bytes());
        protocol::give(&mut self.output, 1, &body)
    }

    fn break_something<P: RigPart>(
        &mut self,
        fault: Fault,
        session: &mut Session<RigBoard<P>>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> Result<(), String> {
        let now = stop.at;
        match fault {
            Fault::Store { address, value } => {
                let (value, problem) = (u64::from(value), |_| format!("{address:#010x} is no memory"));
                host.write(address, Width::W16, value).or_else(|_| host.program(address, Width::W16, value)).map_err(problem)?;
            }
            Fault::Reset => session.reset_by_pin(now, stop.instruction_count, host),
            Fault::Flip { address, bit } => {
                let problem = |_| format!("{address:#010x} is no memory");
                let byte = host.read(address, Width::W8).map_err(problem)? ^ 1 << bit;
                host.write(address, Width::W8, byte).or_else(|_| host.program(address, Width::W8, byte)).map_err(problem)?;
            }
            Fault::Cut(operation) => self.operations_to_cut = Some(operation),
            Fault::Hang => {
                self.hung_since_reset = Some(session.resets().len());
                host.hold(true);
            }
            other => {
                if session.board_mut().part.break_something(other, now)? {
                    host.set_interrupt(nmi(), rigless::device::Level::High);
                }
            }
        }
        Ok(())
    }

    fn converse<P: RigPart>(
        &mut self,
        session: &mut Session<RigBoard<P>>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> std::io::Result<Option<VirtualNanos>> {
        while let Some(request) = protocol::take(&mut self.input)? {
            match request {
                Err(reason) => protocol::give(&mut self.output, protocol::REFUSED, reason.as_bytes())?,
                Ok(Request::Tick { codes, stop: pressed, line }) => {
                    let part = &mut session.board_mut().part;
                    if part.line_is_connected().1 {
                        self.far_end.with(|wire| wire.to_part.extend(line));
                    }
                    part.set_codes(codes);
                    part.press_stop(pressed, stop.at);
                    return Ok(Some(VirtualNanos(stop.at.0 + MILLISECOND)));
                }
                Ok(Request::Fault(fault)) => match self.break_something(fault, session, stop, host) {
                    Ok(()) => protocol::give(&mut self.output, 2, &[])?,
                    Err(reason) => protocol::give(&mut self.output, protocol::REFUSED, reason.as_bytes())?,
                },
                Ok(Request::Read { address, length }) => {
                    let addresses = u64::from(address)..u64::from(address) + u64::from(length);
                    let bytes: Option<Vec<u8>> =
                        addresses.map(|at| host.read(at, Width::W8).ok().and_then(|byte| u8::try_from(byte).ok())).collect();
                    match bytes {
                        Some(bytes) => protocol::give(&mut self.output, 3, &bytes)?,
                        None => protocol::give(&mut self.output, protocol::REFUSED, b"there is no memory")?,
                    }
                }
                Ok(Request::Report) => {
                    let json = self.touched.json(session);
                    protocol::give(&mut self.output, 4, json.as_bytes())?;
                }
            }
        }
        Ok(None)
    }
}

impl<P: RigPart, I: Read + Send, O: Write + Send> Driver<RigBoard<P>> for Machine<I, O> {
    fn on_settled(&mut self, session: &mut Session<RigBoard<P>>, host: &mut dyn Host, settled: Settled) {
        let now = match settled {
            Settled::Access { access, .. } => {
                self.touched.book(&access);
                access.virtual_time
            }
            Settled::Stop(stop) => stop.at,
            _ => return,
        };
        self.follow_flash(session, host, now);
        if self.hung_since_reset.is_some_and(|resets| session.resets().len() > resets) {
            self.hung_since_reset = None;
            host.hold(false);
        }
        let powered = !session.unpowered();
        if !powered && self.powered_before && session.board().part.forgets() {
            self.forget::<P>(host);
        }
        self.powered_before = powered;
    }

    fn on_stop(&mut self, session: &mut Session<RigBoard<P>>, stop: Stop, host: &mut dyn Host) -> Option<VirtualNanos> {
        if self.cut_at.is_some_and(|cut| stop.at >= cut) {
            self.cut_at = None;
            self.cut(session, host, stop.at);
        }
        if let Some(end) = self.tick_end.filter(|end| stop.at < *end) {
            return Some(end);
        }
        if self.tick_end.is_none() {
            self.forget::<P>(host);
        }
        if self.power_back.is_some_and(|back| stop.at >= back) {
            self.power_back = None;
            session.board_mut().part.set_supply(SUPPLY_MV, stop.at);
        }
        let turn = if self.tick_end.is_some() { self.answer_tick(session, stop, host) } else { Ok(()) };
        match turn.and_then(|()| self.converse(session, stop, host)) {
            Ok(Some(end)) => {
                self.tick_end = Some(end);
                Some(self.cut_at.map_or(end, |cut| cut.min(end)))
            }
            Ok(None) => None,
            Err(error) => {
                self.broken = Some(error);
                None
            }
        }
    }
}

/// Changes the array; `mix` decides what a word becomes, from what it was and what it should become.
fn apply(change: Change, host: &mut dyn Host, mut mix: impl FnMut(u64, u64) -> u64) {
    let mut change_word = |host: &mut dyn Memory, address: u64, width: Width, new: &dyn Fn(u64) -> u64| {
        if let Ok(old) = host.read(address, width) {
            let _ = host.program(address, width, mix(old, new(old)) & width.mask());
        }
    };
    match change {
        Change::Program { address, width, value } => change_word(host, address, width, &|old| old & value),
        Change::Erase { sector: number } => {
            for address in sector(number).step_by(8) {
                change_word(host, address, Width::W64, &|_| u64::MAX);
            }
        }
        // A part of their own.
        Change::Options { .. } => {}
    }
}

fn low(number: u64) -> u32 {
    u32::try_from(number & 0xffff_ffff).unwrap_or_default()
}

/// A small generator of bits: equal seeds, equal bits (xorshift64*, Vigna 2016).
#[derive(Debug)]
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
}
