//! The page of a calibration: what was measured, the lines through it, the intervals, and the settings that follow. Made to be printed.

use calibration::Estimate;
use calibration::step::{Curve, Finding, Kind};
use model_export::link::settings::by_name;

use super::chart::{Caption, Panel, Series, panels};
use super::page::{Cell, Page, Width};
use crate::calibrate::Change;
use crate::setting_words::shown;

/// Who was calibrated, and how it ended.
pub struct Heading<'a> {
    /// Name of the board, its number where it has one.
    pub board: &'a str,
    /// Firmware version.
    pub firmware: &'a str,
    /// When, as the computer's clock says.
    pub date: &'a str,
    /// Whether the settings were saved.
    pub saved: bool,
}

/// A value with its interval, as many digits as the interval is worth.
#[must_use]
pub fn figure(estimate: &Estimate) -> String {
    let digits = |size: f64| if size > 0.0 { (1.0 - size.log10().floor()).clamp(0.0, 6.0) as usize } else { 4 };
    match estimate.half_width {
        Some(half) if half > 0.0 => {
            let digits = digits(half);
            format!("{:.digits$} \u{b1} {half:.digits$}", estimate.value)
        }
        _ => format!("{:.*}", digits(estimate.value.abs()) + 2, estimate.value),
    }
}

fn section(kind: Kind) -> &'static str {
    match kind {
        Kind::Noise => "Noise at rest",
        Kind::Laser => "Laser: zero and span",
        Kind::Pressure => "Pressure sensor: zero and span",
        Kind::Valve => "Valve: dead band, hysteresis, full scale",
        Kind::Response => "Response: fill, vent, delay to the laser",
    }
}

fn draw(page: &mut Page, curve: &Curve) {
    let line = |name: &str, class, points: &[(f64, f64)]| Series { name: name.to_owned(), class, points: points.to_vec() };
    let plots = [
        Panel {
            label: curve.vertical.to_owned(),
            series: vec![line("measured", "measured", &curve.measured), line("fitted", "model", &curve.fitted)],
            height: 180.0,
            zero: false,
        },
        Panel { label: "residual".to_owned(), series: vec![line("", "error", &curve.residuals)], height: 80.0, zero: true },
    ];
    let description =
        format!("{}: {} over {}, measured and fitted, and the difference below.", curve.title, curve.vertical, curve.horizontal);
    let caption = Caption { title: curve.title, description: &description };
    page.figure(panels(caption, curve.horizontal, 720.0, &plots), Width::Half, curve.title);
}

/// The whole document.
#[must_use]
pub fn page(heading: &Heading<'_>, findings: &[Finding], changes: &[Change]) -> String {
    let lead = format!("Board {}, firmware {}, {}. Intervals are 95 % intervals.", heading.board, heading.firmware, heading.date);
    let mut page = Page::new("Calibration", &lead);
    page.section("Settings");
    if changes.is_empty() {
        page.paragraph("Nothing was changed.");
    } else {
        let rows: Vec<Vec<Cell>> = changes
            .iter()
            .filter_map(|(name, before, after)| {
                let info = by_name(name)?;
                Some(vec![
                    Cell::Text((*name).to_owned()),
                    Cell::Figure(shown(info, *before)),
                    Cell::Figure(shown(info, *after)),
                    Cell::Text(info.unit.to_owned()),
                ])
            })
            .collect();
        let caption =
            if heading.saved { "Saved: the device starts with them." } else { "**Not saved**: the device has its old settings again." };
        page.table(caption, &["setting", "before", "after", "unit"], &rows, None);
    }
    for finding in findings {
        page.section(section(finding.kind));
        finding.warnings.iter().for_each(|warning| page.paragraph(&format!("**{warning}**")));
        let rows: Vec<Vec<Cell>> = finding
            .quantities
            .iter()
            .map(|quantity| {
                vec![Cell::Text(quantity.name.to_owned()), Cell::Figure(figure(&quantity.estimate)), Cell::Text(quantity.unit.to_owned())]
            })
            .collect();
        page.table("", &["figure", "value", "unit"], &rows, None);
        page.begin_row();
        finding.curves.iter().for_each(|curve| draw(&mut page, curve));
        page.end_row();
    }
    page.finish("Made by `catheter rig calibrate`. A sensor's zero and span are what it read before, with the settings of before.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_has_as_many_digits_as_its_interval_is_worth() {
        let text = |value, half_width| figure(&Estimate { value, half_width });
        assert_eq!(text(0.412_345, Some(0.003_1)), "0.4123 \u{b1} 0.0031");
        assert_eq!(text(14.2, Some(0.5)), "14.20 \u{b1} 0.50");
        assert_eq!(text(0.000_123, None), "0.0001230");
    }
}
