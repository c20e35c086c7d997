//! Which registers the image touches, and which of them no model answers for.

use std::collections::BTreeMap;

use rigless::emulator::{Access, AccessKind};
use rigless::mcu::Mcu;
use rigless::session::Session;
use rigless::soc::Bus;

use crate::board::RigBoard;

/// Reads and writes, by address.
#[derive(Debug, Default)]
pub struct Touched(BTreeMap<u64, [u64; 2]>);

impl Touched {
    /// Books an access of the core's.
    pub fn book(&mut self, access: &Access) {
        if access.program_counter.is_some() {
            let counts = self.0.entry(access.address & !3).or_default();
            counts[usize::from(access.kind == AccessKind::Write)] += 1;
        }
    }

    /// The report: `registers` with their counts, `without_model` (answered by a register file alone, or not at all), `refused` (a clock
    /// that was off, a bus error), `told` (what a model found forbidden).
    pub fn json(&self, session: &mut Session<RigBoard>) -> String {
        let mut without_model: Vec<String> = session
            .unimplemented()
            .iter()
            .map(|(address, found)| format!("{}.{} at {address:#010x}", found.instance, found.register))
            .chain(session.unmapped().iter().map(|unmapped| unmapped.to_string()))
            .collect();
        without_model.sort();
        let refused: Vec<String> = session.refused().values().map(|fault| fault.to_string()).collect();
        let told: Vec<String> = session.told().map(|told| format!("{}.{}: {}", told.instance, told.register, told.reason)).collect();
        let bus = session.board_mut().part.bus();
        let registers: Vec<String> = self
            .0
            .iter()
            .filter_map(|(address, [reads, writes])| {
                Some(format!("{{\"register\":\"{}\",\"reads\":{reads},\"writes\":{writes}}}", name(bus, *address)?))
            })
            .collect();
        let list = |texts: &[String]| texts.iter().map(|text| format!("{text:?}")).collect::<Vec<_>>().join(",");
        format!(
            "{{\"registers\":[{}],\"without_model\":[{}],\"refused\":[{}],\"told\":[{}]}}",
            registers.join(","),
            list(&without_model),
            list(&refused),
            list(&told)
        )
    }
}

fn name(bus: &Bus, address: u64) -> Option<String> {
    let peripheral = bus.slots()[bus.slot_at(address)?].peripheral();
    let offset = address - peripheral.base;
    let register = peripheral.registers.iter().find(|register| u64::from(register.offset) == offset)?;
    Some(format!("{}.{}", peripheral.name, register.name))
}
