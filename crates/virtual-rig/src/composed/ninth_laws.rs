//! Laws to tune on of a supply that has no more to give, one for every seed: what is reached in a moment, what is neared by a flow, and what is passed by
//! a little.

use super::draw::Draw;
use super::fifth_laws::flow_share;
use super::laws::{Drawn, first_order, map};

/// How many there are.
pub(super) const SUPPLIES: u64 = 5;

/// Atmospheric pressure, bar.
const ATMOSPHERE_BAR: f64 = 1.013;

/// Draws the law that belongs to `seed`.
pub(super) fn supply_saturation(seed: u64, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let drawn = span * draw.even(0.55, 0.85);
    let limit = draw.tell("supply-saturation.limit_bar", drawn);
    let (servo_s, inlet_s) = (draw.even(0.005, 0.02), draw.log(0.04, 0.12));
    match seed % SUPPLIES {
        // Turbulent flow through an orifice goes by the root of what the supply has above the muscle.
        0 => Drawn::Before(first_order(move |command, pressure| {
            let head = (limit - pressure) / limit;
            ((command - pressure) / servo_s).min(limit * head.abs().sqrt() * head.signum() / inlet_s)
        })),
        // The elliptic flow function of ISO 6358 with a critical ratio of 0.4, absolute pressures.
        1 => Drawn::Before(first_order(move |command, pressure| {
            let [supply, muscle] = [limit, pressure.max(0.0)].map(|gauge| gauge + ATMOSPHERE_BAR);
            let flow = if muscle < supply { limit * flow_share(0.4, supply, muscle) } else { limit - pressure };
            ((command - pressure) / servo_s).min(flow / inlet_s)
        })),
        // A long line: laminar flow of a gas goes by the difference of the squares of absolute pressures.
        2 => Drawn::Before(first_order(move |command, pressure| {
            let (full, own) = (limit + ATMOSPHERE_BAR, pressure + ATMOSPHERE_BAR);
            ((command - pressure) / servo_s).min((full * full - own * own) / (2.0 * full * inlet_s))
        })),
        // A relief valve that opens at the limit and lets the pressure rise a little further by what it has to let through.
        3 => {
            let overrides = draw.even(0.03, 0.12);
            Drawn::Before(map(move |command| command.min(limit) + overrides * (command - limit).max(0.0)))
        }
        // A driver that clips softly: as much below the limit as its knee is wide.
        _ => {
            let knee = draw.even(0.03, 0.08) * span;
            Drawn::Before(map(move |command| command - knee * ((command - limit) / knee).exp().ln_1p()))
        }
    }
}
