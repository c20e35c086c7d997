//! What can be broken on simulated hardware.

/// What is broken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Breakage {
    /// The laser's channel reads this code.
    LaserCode(u16),
    /// The laser's channel keeps the code it had.
    LaserFrozen,
    /// The laser jumps by this, mm.
    LaserOffsetMm(f64),
    /// The same, with noise of 2 codes.
    LaserFrozenWithNoise,
    /// The pressure channel reads this code.
    PressureCode(u16),
    /// The pressure channel keeps the code it had.
    PressureFrozen,
    /// The same, with noise of 2 codes.
    PressureFrozenWithNoise,
    /// The pressure reading jumps by this, bar.
    PressureOffsetBar(f64),
    /// The pressure reading is multiplied by this.
    PressureGain(f64),
    /// The emergency stop is pressed.
    EmergencyStop,
    /// Every tick takes too long.
    EveryTickLate,
    /// This many ticks are lost before each one.
    TicksLost(u16),
    /// The muscle bursts.
    MuscleBursts,
    /// The supply fails.
    SupplyFails,
    /// The supply regulator is at this pressure, bar.
    SupplyBar(f64),
    /// The line leaks: this share of the pressure that the valve puts in is lost.
    LineLeaks(f64),
    /// The line is blocked beside the muscle: no air enters or leaves it.
    LineBlocked,
    /// The valve sticks fully open.
    ValveFullyOpen,
    /// The dump valve sticks closed.
    DumpValveStuckClosed,
    /// The line between device and host is cut.
    LineCut,
}
