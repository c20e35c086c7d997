//! What the emulated device and the host that plays its hardware say to each other, once a tick: fixed frames on a line of their own.
//!
//! ```text
//! device                                  host
//!   BootRequest  ───────────────────────►          after every reset
//!                ◄───────────────────────  Boot    why it started, how fast the line to the host is
//!                ◄───────────────────────  Inputs  the tick's codes, and how many bytes now wait on the link's line
//!   Outputs      ───────────────────────►          what the pins do, and how many bytes the link's line gets
//! ```
//!
//! All frames have [`FRAME_BYTES`], begin with a kind and are little-endian. Both lines are reliable: they are sockets or short cables.

use model_export::link::fault::Fault;
use model_export::link::state::{ResetCause, State};

use crate::drivers::RawSample;

/// What the hardware brings to a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceInputs {
    /// The sample of both channels.
    pub sample: RawSample,
    /// Whether the emergency stop is pressed.
    pub emergency_stop: bool,
    /// Whether the last tick took too long.
    pub overran: bool,
    /// Ticks lost since the last one.
    pub lost_ticks: u16,
}

/// Length of every frame.
pub const FRAME_BYTES: usize = 12;
/// A frame.
pub type Frame = [u8; FRAME_BYTES];

const BOOT_REQUEST: u8 = 0xb0;
const BOOT: u8 = 0xb1;
const INPUTS: u8 = 0xa0;
const OUTPUTS: u8 = 0xa1;

/// What a test makes the processor do instead of its tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InjectedFault {
    /// Nothing: the tick as ever.
    #[default]
    None,
    /// Hang for ever, interrupts off.
    Hang,
    /// Call itself until the stack is full.
    StackOverflow,
    /// Panic.
    Panic,
}

impl InjectedFault {
    const ALL: [Self; 4] = [Self::None, Self::Hang, Self::StackOverflow, Self::Panic];
}

/// What the host sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromHost {
    /// Begin.
    Boot {
        /// Why the device started: what the reset flags of the real chip tell.
        reset_cause: ResetCause,
        /// See [`super::DeviceConfig::line_bytes_per_tick`].
        line_bytes_per_tick: u16,
    },
    /// Do a tick.
    Inputs {
        /// What the hardware brings.
        inputs: DeviceInputs,
        /// Bytes to read from the link's line before the tick.
        link_bytes: u16,
        /// What to do instead.
        injected: InjectedFault,
    },
}

/// What the device sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromDevice {
    /// It has started and waits for [`FromHost::Boot`].
    BootRequest {
        /// What crashed the run before, if that is why it started.
        crash: Option<Fault>,
    },
    /// It has done a tick.
    Outputs(DeviceOutputs),
}

/// What a tick does to the hardware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceOutputs {
    /// Whether the dump valve is energised (closed).
    pub energised: bool,
    /// Whether the watchdog is fed.
    pub feed_watchdog: bool,
    /// The state after the tick.
    pub state: State,
    /// The valve's drive, share of full scale out of 65535.
    pub valve_share: u16,
    /// What that drive means, in microbar.
    pub output_ubar: i32,
    /// Bytes that the link's line gets after the tick.
    pub link_bytes: u16,
}

impl FromHost {
    /// As a frame.
    pub fn encode(&self) -> Frame {
        match self {
            Self::Boot { reset_cause, line_bytes_per_tick } => {
                let [low, high] = line_bytes_per_tick.to_le_bytes();
                [BOOT, reset_cause.number(), low, high, 0, 0, 0, 0, 0, 0, 0, 0]
            }
            Self::Inputs { inputs, link_bytes, injected } => {
                let flags = u8::from(inputs.emergency_stop) | (u8::from(inputs.overran) << 1);
                let injected =
                    InjectedFault::ALL.iter().zip(0..).find(|(candidate, _)| *candidate == injected).map_or(0, |(_, number)| number);
                let [laser_low, laser_high] = inputs.sample.laser_code.to_le_bytes();
                let [pressure_low, pressure_high] = inputs.sample.pressure_code.to_le_bytes();
                let [lost_low, lost_high] = inputs.lost_ticks.to_le_bytes();
                let [link_low, link_high] = link_bytes.to_le_bytes();
                [INPUTS, flags, laser_low, laser_high, pressure_low, pressure_high, lost_low, lost_high, link_low, link_high, injected, 0]
            }
        }
    }

    /// From a frame; `None` if it is none of these.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let [kind, flags, a, b, c, d, e, f, g, h, injected, _] = *frame;
        match kind {
            BOOT => Some(Self::Boot { reset_cause: ResetCause::from_number(flags), line_bytes_per_tick: u16::from_le_bytes([a, b]) }),
            INPUTS => Some(Self::Inputs {
                inputs: DeviceInputs {
                    sample: RawSample { laser_code: u16::from_le_bytes([a, b]), pressure_code: u16::from_le_bytes([c, d]) },
                    emergency_stop: flags & 1 != 0,
                    overran: flags & 2 != 0,
                    lost_ticks: u16::from_le_bytes([e, f]),
                },
                link_bytes: u16::from_le_bytes([g, h]),
                injected: InjectedFault::ALL.get(usize::from(injected)).copied()?,
            }),
            _ => None,
        }
    }
}

impl FromDevice {
    /// As a frame.
    pub fn encode(&self) -> Frame {
        match self {
            Self::BootRequest { crash } => [BOOT_REQUEST, crash.map_or(0, Fault::number), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            Self::Outputs(outputs) => {
                let state = State::ALL.iter().zip(0u8..).find(|(state, _)| **state == outputs.state).map_or(0, |(_, number)| number);
                let flags = u8::from(outputs.energised) | (u8::from(outputs.feed_watchdog) << 1);
                let [share_low, share_high] = outputs.valve_share.to_le_bytes();
                let [a, b, c, d] = outputs.output_ubar.to_le_bytes();
                let [link_low, link_high] = outputs.link_bytes.to_le_bytes();
                [OUTPUTS, flags, state, share_low, share_high, a, b, c, d, link_low, link_high, 0]
            }
        }
    }

    /// From a frame; `None` if it is none of these.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let [kind, flags, state, share_low, share_high, a, b, c, d, link_low, link_high, _] = *frame;
        match kind {
            BOOT_REQUEST => Some(Self::BootRequest { crash: Fault::from_number(flags) }),
            OUTPUTS => Some(Self::Outputs(DeviceOutputs {
                energised: flags & 1 != 0,
                feed_watchdog: flags & 2 != 0,
                state: State::ALL.get(usize::from(state)).copied()?,
                valve_share: u16::from_le_bytes([share_low, share_high]),
                output_ubar: i32::from_le_bytes([a, b, c, d]),
                link_bytes: u16::from_le_bytes([link_low, link_high]),
            })),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_comes_back_as_it_was_sent() {
        let inputs = DeviceInputs {
            sample: RawSample { laser_code: 0x1234, pressure_code: 0xfedc },
            emergency_stop: true,
            overran: false,
            lost_ticks: 0x0102,
        };
        for injected in InjectedFault::ALL {
            let sent =
                FromHost::Inputs { inputs: DeviceInputs { overran: injected == InjectedFault::Hang, ..inputs }, link_bytes: 777, injected };
            assert_eq!(FromHost::decode(&sent.encode()), Some(sent));
        }
        let boot = FromHost::Boot { reset_cause: ResetCause::Watchdog, line_bytes_per_tick: 92 };
        assert_eq!(FromHost::decode(&boot.encode()), Some(boot));
        for state in State::ALL {
            let outputs = DeviceOutputs {
                energised: state.is_energised(),
                feed_watchdog: state == State::Boot,
                state,
                valve_share: 0xabcd,
                output_ubar: -2_000_001,
                link_bytes: 919,
            };
            let sent = FromDevice::Outputs(outputs);
            assert_eq!(FromDevice::decode(&sent.encode()), Some(sent));
        }
        for crash in [None, Some(Fault::HardFault)] {
            let sent = FromDevice::BootRequest { crash };
            assert_eq!(FromDevice::decode(&sent.encode()), Some(sent));
        }
    }

    #[test]
    fn frames_of_one_side_are_none_of_the_other() {
        assert_eq!(FromHost::decode(&FromDevice::BootRequest { crash: None }.encode()), None);
        assert_eq!(FromDevice::decode(&FromHost::Boot { reset_cause: ResetCause::Pin, line_bytes_per_tick: 1 }.encode()), None);
    }
}
