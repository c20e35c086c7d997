//! Curves in C.

use std::fmt::Write;

use model_export::schema::Curve;

use super::literal::{constant, floats};
use super::template::fill;

/// A curve as a function of this name, in lower case.
pub fn curve(curve: Option<&Curve>, meaning: &str, name: &str) -> String {
    let Some(curve) = curve else { return String::new() };
    let upper = name.to_uppercase();
    let (mut bends, mut body) = (String::new(), String::new());
    if !curve.bend_points.is_empty() {
        let _ = write!(
            bends,
            "#define {upper}_BENDS {}u\nstatic const float {upper}_POINTS[{upper}_BENDS] = {{\n{}}};\n\
             static const float {upper}_CHANGES[{upper}_BENDS] = {{\n{}}};\n",
            curve.bend_points.len(),
            floats(&curve.bend_points),
            floats(&curve.bends),
        );
        body = fill(include_str!("template/bends.c"), &[("UPPER", &upper)]);
    }
    fill(
        include_str!("template/curve.c"),
        &[
            ("meaning", meaning),
            ("UPPER", &upper),
            ("lower", name),
            ("offset", &constant(curve.offset)),
            ("slope", &constant(curve.slope)),
            ("bends", &bends),
            ("loop", &body),
        ],
    )
}
