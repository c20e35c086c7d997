//! What hysteresis is, in four drawings: one play operator, its loop, how loops add up, and what the sum remembers.
//!
//! The curves are computed with the operators that the models run on.

use hysteresis::play;

use super::chart::{Caption, Series, loops};
use super::page::{Page, Width};
use super::svg::{Anchor, Svg};

/// Thresholds and weights of the drawings: the default plant's.
const OPERATORS: [(f64, f64); 5] = [(0.0, 0.35), (0.15, 0.25), (0.30, 0.20), (0.45, 0.12), (0.60, 0.08)];
const CLASSES: [&str; 5] = ["four", "two", "five", "one", "three"];

/// Output of one play operator, eq. (2) of the paper.
fn played(threshold: f64, input: &[f64]) -> Vec<f64> {
    let mut state = 0.0;
    input
        .iter()
        .map(|&value| {
            state = play::step(threshold, value, state);
            state
        })
        .collect()
}

/// Up and down between zero and a falling maximum: first the way up, then loops nested in each other.
fn nested(turning_points: &[f64]) -> Vec<f64> {
    let mut input = vec![turning_points[0]];
    for pair in turning_points.windows(2) {
        input.extend((1..=60).map(|step| pair[0] + (pair[1] - pair[0]) * f64::from(step) / 60.0));
    }
    input
}

/// Adds the section to a page.
pub fn add(page: &mut Page) {
    page.section("Hysteresis in four drawings");
    page.paragraph(
        "A system has hysteresis when its output depends on the way the input came, not on its value alone. Raise the pressure of the \
         muscle to 1 bar from below and the catheter tip stands in one place; come down to 1 bar from above and it stands in another. \
         Friction between tube and muscle does this, and no table from pressure to position can describe it. What can is surprisingly simple.",
    );
    page.begin_row();
    page.figure(
        slack(),
        Width::Half,
        "**The play operator.** The input p moves a frame, the frame pushes a cart, and between them there is slack of r on either side. The \
         cart moves only when a wall of the frame pushes it; when the input turns round, the cart rests until the slack is taken up. \
         Where it rests is its memory: it lasts for ever, and it has no notion of time.",
    );
    page.figure(
        one_loop(),
        Width::Half,
        "**Its loop.** Output over input: along the right edge on the way up, along the left edge on the way down, level in between. The \
         loop is 2r wide and does not depend on speed. This is eq. (2) of the paper: H(t) = max{p(t) \u{2212} r, min{p(t) + r, H(t \u{2212} T)}}.",
    );
    page.end_row();
    page.begin_row();
    page.figure(
        superposition(),
        Width::Half,
        "**Many loops make a smooth one.** Play operators of five thresholds, each with its weight, and their sum (dark): a \
         Prandtl\u{2013}Ishlinskii model, eq. (3) of the paper. With every operator that starts to move the curve gets steeper, so loops of \
         real actuators can be fitted by choosing weights, which is a linear least-squares problem.",
    );
    page.figure(
        memory(),
        Width::Half,
        "**What the sum remembers.** Small loops inside large ones. A reversal opens a new branch; when the input passes an earlier \
         turning point again, the small loop closes and is forgotten, and the output goes on along the old branch as if nothing had been. \
         The present output depends on the list of turning points not yet wiped out.",
    );
    page.end_row();
    page.paragraph(
        "A recurrent network such as an LSTM can learn loops from examples without being told of play operators. But its memory is a number \
         that decays or drifts a little at every step, so while the input rests its output creeps away. A **hybrid** puts play operators in \
         front of a small network: the operators remember for ever, and the network learns what they cannot say, such as lag, creep, \
         asymmetry and stick-slip. Where there is nothing of the kind, play operators alone are exact and the network is left out.",
    );
}

fn slack() -> Svg {
    let mut svg = Svg::new(
        520.0,
        340.0,
        "The play operator as a cart with slack in a frame",
        "Three stages. The frame moves right and its left wall pushes the cart. The frame turns back and the cart rests in the slack. The \
         frame's right wall reaches the cart and pushes it left.",
    );
    // Middle of the frame, place of the cart, direction of the motion: the cart rests from the first stage to the second.
    let stages = [
        ("1   the input rises: the rear wall pushes", 330.0, 266.0, 1.0),
        ("2   the input turns round: the cart rests", 266.0, 266.0, -1.0),
        ("3   slack taken up: the front wall pushes", 160.0, 224.0, -1.0),
    ];
    let cart = 26.0;
    let wall = 90.0;
    svg.line("zero", (266.0, 84.0), (266.0, 190.0));
    for (index, (text, middle, at, direction)) in stages.into_iter().enumerate() {
        let top = 16.0 + 106.0 * index as f64;
        let floor = top + 88.0;
        svg.text("legend", (20.0, top + 4.0), Anchor::Start, text);
        svg.line("axis", (20.0, floor), (500.0, floor));
        // The frame is open below: walls and a beam.
        let (left, right) = (middle - wall, middle + wall);
        svg.polyline("slot", &[(left, floor - 4.0), (left, floor - 46.0), (right, floor - 46.0), (right, floor - 4.0)]);
        svg.rectangle("shape", (at - cart, floor - 30.0), (2.0 * cart, 26.0), None, "");
        svg.text("name", (at, floor - 12.0), Anchor::Middle, "H");
        svg.line("slot", (middle, floor - 46.0), (middle, floor - 52.0));
        svg.text("name", (middle, floor - 56.0), Anchor::Middle, "p");
        let from = middle + direction * (wall + 14.0);
        let to = from + direction * 36.0;
        svg.line("arrow", (from, floor - 26.0), (to, floor - 26.0));
        svg.polygon("head", &[(to + direction * 9.0, floor - 26.0), (to, floor - 31.0), (to, floor - 21.0)]);
        // The slack between cart and walls: r on either side when the cart is in the middle, 2r when it touches a wall.
        for (gap, slack) in [(at - cart - left, 0.5 * (left + at - cart)), (right - at - cart, 0.5 * (right + at + cart))] {
            if gap > 1.0 {
                svg.text("note", (slack, floor - 13.0), Anchor::Middle, if gap > 100.0 { "2r" } else { "r" });
            }
        }
    }
    svg
}

fn one_loop() -> Svg {
    let input = nested(&[0.0, 2.0, 0.0, 2.0]);
    let output = played(0.45, &input);
    let line = Series::new("play operator, r = 0.45 bar", "model", &input, &output);
    let none = Series::new("input itself, r = 0", "zero", &[0.0, 2.0], &[0.0, 2.0]);
    loops(
        Caption {
            title: "Loop of one play operator",
            description: "A parallelogram: rising along the right edge, level at the turning points, falling along the left edge.",
        },
        "input p / bar",
        "output H / bar",
        (520.0, 340.0),
        &[none, line],
    )
}

fn superposition() -> Svg {
    let input = nested(&[0.0, 2.0, 0.0, 2.0]);
    let mut sum = vec![0.0; input.len()];
    let mut series = Vec::new();
    for ((threshold, weight), class) in OPERATORS.into_iter().zip(CLASSES) {
        let part: Vec<f64> = played(threshold, &input).into_iter().map(|value| weight * value).collect();
        sum.iter_mut().zip(&part).for_each(|(sum, part)| *sum += part);
        series.push(Series::new(&format!("{threshold:.2}"), class, &input, &part));
    }
    series.push(Series::new("sum", "strong", &input, &sum));
    loops(
        Caption {
            title: "Five play operators and their sum",
            description: "Five weighted parallelogram loops of growing width, and their sum: one smooth lens-shaped loop.",
        },
        "input p / bar (legend: thresholds in bar)",
        "weighted outputs and their sum / mm",
        (520.0, 360.0),
        &series,
    )
}

fn memory() -> Svg {
    let turns = [0.0, 2.0, 0.3, 1.5, 0.7, 1.2, 0.5, 1.7, 0.1, 2.0];
    let input = nested(&turns);
    let mut sum = vec![0.0; input.len()];
    for (threshold, weight) in OPERATORS {
        sum.iter_mut().zip(played(threshold, &input)).for_each(|(sum, part)| *sum += weight * part);
    }
    let first = 60 + 1;
    let loops_of = [
        Series::new("way from rest", "two", &input[..first], &sum[..first]),
        Series::new("loops within loops", "model", &input[first - 1..], &sum[first - 1..]),
    ];
    loops(
        Caption {
            title: "Nested loops of the sum",
            description: "Starting at rest the output rises to the corner; after that smaller loops nest in the large one and close at their turning points.",
        },
        "input p / bar",
        "output d / mm",
        (520.0, 360.0),
        &loops_of,
    )
}
