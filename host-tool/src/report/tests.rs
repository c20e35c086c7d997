use std::path::PathBuf;

use super::chart::{Caption, DotRow, HeatMap, Panel, Series, bars, bars_from, colour, decades, dots, heat, loops, panels};
use super::page::{Cell, Width};
use super::*;
use crate::discover::{self, DiscoverConfig};
use crate::evaluate::{Errors, Judged, by_family, ladder};
use crate::recording::{Recording, Signal};
use crate::rig::{self, CaseConfig};

const CAPTION: Caption<'_> = Caption { title: "a < b & \"c\"", description: "d" };

/// Checks that every element is closed in order and every attribute is quoted, and returns the text of all attributes.
fn well_formed(markup: &str) -> Vec<String> {
    // What stands in a script is no markup.
    let markup = &markup.split("<script").map(|part| part.split_once("</script>").map_or(part, |(_, rest)| rest)).collect::<String>();
    let mut open: Vec<String> = Vec::new();
    let mut attributes = Vec::new();
    let mut rest = markup.as_str();
    while let Some(start) = rest.find('<') {
        let text = &rest[..start];
        assert!(!text.contains('>'), "a bare > in {text}");
        let end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        if tag.starts_with('!') {
            continue;
        }
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "closed out of order");
            continue;
        }
        let name = tag.split([' ', '/']).next().unwrap_or_default().to_owned();
        let quotes = tag.matches('"').count();
        assert!(quotes.is_multiple_of(2), "an open quote in {tag}");
        attributes.extend(tag.split('"').skip(1).step_by(2).map(str::to_owned));
        // These HTML elements have no end.
        if !tag.ends_with('/') && !["meta", "br"].contains(&name.as_str()) {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
    attributes
}

fn well_formed_and_finite(svg: Svg) -> String {
    let markup = svg.finish("x");
    for attribute in well_formed(&markup) {
        assert!(!attribute.contains("NaN") && !attribute.contains("inf"), "{attribute}");
    }
    markup
}

/// Series that plots must survive: none, empty, one point, constant, holes, huge, tiny.
fn hostile() -> Vec<Vec<(f64, f64)>> {
    let line = |y: fn(f64) -> f64| (0..50).map(|index| (f64::from(index), y(f64::from(index)))).collect::<Vec<_>>();
    vec![
        vec![],
        vec![(0.0, 0.0)],
        vec![(f64::NAN, f64::INFINITY); 5],
        line(|_| 3.0),
        line(|x| if x == 20.0 { f64::NAN } else { x }),
        line(|x| 1e300 * (x - 25.0)),
        line(|x| 1e-300 * x),
        line(|x| 1e9 + 1e-9 * x),
    ]
}

#[test]
fn every_plot_is_well_formed_and_finite_for_any_series() {
    for points in hostile() {
        let series = vec![Series { name: "<one>".into(), class: "model", points: points.clone() }];
        let panel = |zero| Panel { label: "y < z".into(), series: series.clone(), height: 80.0, zero };
        well_formed_and_finite(panels(CAPTION, "x & y", 500.0, &[panel(false), panel(true)]));
        well_formed_and_finite(loops(CAPTION, "x", "y", (300.0, 300.0), &series));
        well_formed_and_finite(decades(CAPTION, "x", "y", (300.0, 300.0), &series));
        let values: Vec<f64> = points.iter().map(|point| point.1).collect();
        let rows: Vec<(String, f64)> = values.iter().map(|&value| ("<name>".to_owned(), value)).collect();
        well_formed_and_finite(bars(CAPTION, "x", 500.0, &rows));
        let dot_rows: Vec<DotRow> = values
            .iter()
            .map(|&value| DotRow { name: "n".into(), note: "&".into(), value, dots: vec![("a".into(), value)], marked: true })
            .collect();
        well_formed_and_finite(dots(CAPTION, "x", 500.0, 1e-6, &dot_rows));
        let map = HeatMap { heading: "h".into(), columns: vec!["0".into()], rows: vec![("r".into(), values)] };
        well_formed_and_finite(heat(CAPTION, ("x", "y", "mm"), 500.0, (1e-4, 0.1), &[map.clone(), map]));
    }
    well_formed_and_finite(panels(CAPTION, "x", 500.0, &[]));
    well_formed_and_finite(heat(CAPTION, ("x", "y", "mm"), 500.0, (1e-4, 0.1), &[]));
}

#[test]
fn a_line_is_interrupted_where_a_value_is_missing() {
    let points = [(0.0, 0.0), (1.0, 1.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, 0.0)];
    let mut svg = Svg::new(10.0, 10.0, "t", "d");
    svg.polyline("model", &points);
    assert!(svg.finish("x").contains("d=\"M0 0L1 1M3 1L4 0\""));
}

#[test]
fn a_logarithmic_axis_has_decades_and_the_numbers_beside_it_are_the_true_ones() {
    let series = [Series::new("validation", "model", &[0.0, 1.0, 2.0], &[0.5, 0.02, 0.003])];
    let mut svg = decades(CAPTION, "optimiser steps", "RMSE / mm", (500.0, 300.0), &series);
    let plots = svg.take_plots();
    assert!(plots[0].logarithmic && plots[0].y == [-3.0, 0.0], "{:?}", plots[0].y);
    assert_eq!(plots[0].series[0].points[2].1, 0.003);
    let markup = well_formed_and_finite(svg);
    for label in ["10\u{207b}\u{b3}", "10\u{207b}\u{b9}", "10\u{2070}"] {
        assert!(markup.contains(&format!(">{label}</text>")), "{label}");
    }
    assert!(!markup.contains("log10"));
}

#[test]
fn an_error_plot_shows_zero_and_the_same_time_axis_as_the_plot_above() {
    let above = Panel { label: "y".into(), series: vec![Series::new("", "model", &[0.0, 10.0], &[0.0, 1.0])], height: 100.0, zero: false };
    let below = Panel { label: "e".into(), series: vec![Series::new("", "error", &[0.0, 5.0], &[0.5, 0.7])], height: 100.0, zero: true };
    let markup = well_formed_and_finite(panels(CAPTION, "t", 580.0, &[above, below]));
    assert!(markup.contains("class=\"zero\""));
    // 500 pixels from 66: ten seconds above end at 566, five below at half of it.
    assert!(markup.contains("L566 ") && markup.contains("L316 "), "{markup}");
}

#[test]
fn figures_in_a_row_share_their_numbers_and_each_plot_finds_its_own() {
    let time: Vec<f64> = (0..50).map(f64::from).collect();
    let (input, output): (Vec<f64>, Vec<f64>) = time.iter().map(|time| ((0.3 * time).sin(), (0.3 * time - 0.5).sin())).unzip();
    let mut page = Page::new("t", "l");
    let panel = |zero| Panel { label: "y / mm".into(), series: vec![Series::new("one", "model", &time, &output)], height: 80.0, zero };
    page.begin_row();
    page.figure(panels(CAPTION, "time / s", 500.0, &[panel(false), panel(true)]), Width::TwoThirds, "");
    page.figure(loops(CAPTION, "u / bar", "y / mm", (300.0, 300.0), &[Series::new("one", "model", &input, &output)]), Width::Third, "");
    page.end_row();
    page.figure(Svg::new(1.0, 1.0, "t", "d"), Width::Full, "");
    let html = page.finish("");
    let numbers: Vec<&str> =
        html.split("<script type=\"application/json\">").skip(1).map(|part| part.split_once("</script>").unwrap().0).collect();
    assert_eq!(numbers.len(), 1, "a drawing without a plot has no numbers");
    let group: serde_json::Value = serde_json::from_str(numbers[0]).unwrap();
    let columns = group["tables"][0].as_array().unwrap();
    assert_eq!(columns.len(), 3, "time, output and input, each once");
    assert_eq!(group["figures"][0]["plots"].as_array().unwrap().len(), 2);
    for figure in group["figures"].as_array().unwrap() {
        let id = figure["id"].as_str().unwrap();
        let (_, drawing) = html.split_once(&format!("<svg id=\"{id}\"")).unwrap();
        let drawing = drawing.split_once("</svg>").unwrap().0;
        let plots = figure["plots"].as_array().unwrap();
        assert_eq!(drawing.matches("<g class=\"plot\"").count(), plots.len());
        assert_eq!(
            drawing.matches("<g class=\"series\"").count(),
            plots.iter().map(|plot| plot["s"].as_array().unwrap().len()).sum::<usize>()
        );
        // Without the script the whole curve is there.
        assert!(drawing.matches("<path class=\"model\"").count() >= plots.len());
    }
}

#[test]
fn a_bar_that_is_cut_short_says_its_true_value() {
    let rows = [("bad".to_owned(), -350.0), ("good".to_owned(), 30.0)];
    let markup = well_formed_and_finite(bars_from(CAPTION, "x", 500.0, -20.0, &rows));
    let figures: Vec<&str> = markup.split("class=\"figure\"").skip(1).map(|part| part.split(['<', '>']).nth(1).unwrap()).collect();
    assert_eq!(figures, ["\u{2212}350", "30.0"]);
    assert!(markup.contains("bad: \u{2212}350"));
}

#[test]
fn colours_run_from_dark_to_bright_and_nonsense_is_dark() {
    assert_eq!(colour(0.0), "#440154");
    assert_eq!(colour(1.0), "#fde725");
    assert_eq!(colour(f64::NAN), "#440154");
    assert_eq!(colour(0.125), "#472c7a");
}

#[test]
fn a_page_is_one_document_without_any_outside_resource_and_its_script_is_the_only_one_allowed() {
    let mut page = Page::new("<script>alert(1)</script>", "a & b");
    page.section("one");
    page.paragraph("**bold** <i> and **unclosed");
    page.tiles(&[("1".into(), "two **three**".into(), Some(false))]);
    page.table(
        "c",
        &["x", "y"],
        &[vec![Cell::Text("<td>".into()), Cell::Figure("1".into())], vec![Cell::Text("b".into()), Cell::Verdict(true)]],
        Some(1),
    );
    page.figure(Svg::new(1.0, 1.0, "t", "d"), Width::Full, "caption");
    page.figure(Svg::new(1.0, 1.0, "t", "d"), Width::Half, "");
    page.section("two");
    page.code("a < b");
    let html = page.finish("the end");
    // The style sheet is no markup.
    let (before, after) = html.split_once("<style>").unwrap();
    let (style, after) = after.split_once("</style>").unwrap();
    let attributes = well_formed(&format!("{before}{after}"));
    assert!(!html.contains("<i>") && !html.contains("<link") && !html.contains("<script>alert"));
    let (_, script) = html.split_once("<script>").unwrap();
    let (script, rest) = script.split_once("</script>").unwrap();
    assert_eq!(rest, "</body></html>\n", "nothing stands behind the only script");
    let hash = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, <sha2::Sha256 as sha2::Digest>::digest(script));
    assert!(html.contains(&format!("script-src 'sha256-{hash}'")), "the policy allows this script and no other");
    assert!(!script.contains("fetch(") && !script.contains("XMLHttpRequest") && !script.contains("eval("));
    assert!(!style.contains("url(") && !style.contains("@import"));
    // Namespaces are names, not addresses to fetch from.
    assert!(attributes.iter().all(|value| !value.contains("://") || value == "http://www.w3.org/2000/svg"), "{attributes:?}");
    let mut identifiers: Vec<&String> = attributes.iter().filter(|value| value.starts_with('f') && value.ends_with("-t")).collect();
    identifiers.dedup();
    assert_eq!(identifiers.len(), 2, "each figure has its own name");
    assert_eq!(html.matches("role=\"img\"").count(), 2);
    assert!(html.contains("<li><a href=\"#s2\">two</a></li>"));
}

fn description() -> crate::model::Description {
    crate::model::Description {
        path: PathBuf::from("<model>.blob"),
        kind: "a & b".into(),
        arithmetic: crate::model::Arithmetic::FixedPoint,
        input: Signal::pressure_bar(),
        more_inputs: Vec::new(),
        output: Signal::displacement_mm(),
        input_range: None,
        sample_period_s: Some(0.02),
        parameters: 1,
        macs_per_step: 1,
    }
}

fn judged(name: &str, output: Vec<f64>, predicted: Vec<f64>) -> (Recording, Judged) {
    let time_s = (0..output.len()).map(|index| index as f64).collect();
    let input = output.clone();
    let recording =
        Recording::new(std::path::Path::new(name), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output.clone())
            .unwrap();
    let errors =
        crate::evaluate::FileErrors { path: name.into(), family: recording.family.clone(), errors: Errors::between(&predicted, &output) };
    (recording, Judged { errors, first: 0, predicted })
}

#[test]
fn the_recording_with_the_largest_error_stands_for_its_family() {
    let (recordings, judgements): (Vec<_>, Vec<_>) = [
        judged("a_1.csv", vec![0.0, 1.0], vec![0.0, 1.1]),
        judged("b_1.csv", vec![0.0, 1.0], vec![0.0, 1.0]),
        judged("a_2.csv", vec![0.0, 1.0], vec![0.0, 1.5]),
    ]
    .into_iter()
    .unzip();
    let chosen: Vec<PathBuf> = examples("m", &recordings, &judgements).into_iter().map(|example| example.path).collect();
    assert_eq!(chosen, [PathBuf::from("a_2.csv"), PathBuf::from("b_1.csv")]);
}

#[test]
fn an_evaluation_report_is_a_whole_document_even_for_hostile_names_and_outputs() {
    let (recording, one) = judged("<img src=x>.csv", vec![1.0; 5], vec![1.0; 5]);
    let (other, of_other) = judged("a_1.csv", vec![0.0, 1e12, -1e12], vec![0.0; 3]);
    let judgements = [one, of_other];
    let families = by_family(judgements.iter().map(|judged| &judged.errors));
    let chosen = examples("<m>", &[recording, other], &judgements);
    let ladder = ladder::ladder(Vec::new(), 0.0);
    let html = evaluation_page(&description(), &chosen, &families, Some(&ladder), None);
    let (before, after) = html.split_once("<style>").unwrap();
    let attributes = well_formed(&format!("{before}{}", after.split_once("</style>").unwrap().1));
    assert!(attributes.iter().all(|value| !value.contains("NaN")));
    assert!(!html.contains("<img"));
    assert!(html.contains("&lt;img src=x&gt;"));
}

#[test]
fn a_model_that_recordings_kept_out_speak_against_comes_with_a_warning() {
    let config = CaseConfig { effects: vec!["dead-time".to_owned()], seed: 520, ..CaseConfig::default() };
    let case = rig::hide(&config).expect("a case");
    let mut finding = discover::discover(&case.recordings[..8], &case.kept_out, &DiscoverConfig::default()).expect("a finding");
    let said = |finding: &discover::Finding| {
        let page = discovery::page(finding, &Signal::pressure_bar(), &Signal::displacement_mm());
        discovery::warning(&finding.discovery).map(|warning| page.contains(&warning))
    };
    assert!(finding.discovery.rmse_after < finding.discovery.rmse_before);
    assert_eq!(said(&finding), None);
    finding.discovery.rmse_after = 1.01 * finding.discovery.rmse_before;
    assert_eq!(said(&finding), Some(true));
    // Where only they err, and where they go beyond, that is said as well.
    let found = &mut finding.discovery;
    (found.verdict, found.errs_kept_out_only, found.beyond_range) = (discover::Verdict::None, true, vec!["far.csv".to_owned()]);
    (found.rmse_after, found.noise_floor) = (0.3, 0.1);
    assert!(discovery::headline(found).contains("does not follow those that were kept out"), "{}", discovery::headline(found));
    assert_eq!(
        discovery::warning(found).as_deref(),
        Some(
            "There it errs by 3.0 times the noise, and no choice may look at them: give such recordings to the search as well. \
             far.csv goes beyond the input of all others: there a model extrapolates."
        )
    );
    assert_eq!(said(&finding), Some(true));
    let found = &mut finding.discovery;
    (found.verdict, found.errs_kept_out_only) = (discover::Verdict::Named, false);
    // What is named is as sure as it is said to be, and a few strokes are said to be few.
    let found = &mut finding.discovery;
    assert_eq!(discovery::headline(found), "Missing is dead-time.");
    found.effects[0].confidence = 0.5;
    assert_eq!(discovery::headline(found), "What is missing looks like dead-time, but that is not sure.");
    let beside = discover::Effect { name: "creep".to_owned(), confidence: 0.9, ..found.effects[0].clone() };
    found.effects.push(beside);
    assert_eq!(discovery::headline(found), "Missing is creep; dead-time beside it is not sure.");
    (found.verdict, found.strokes, found.unlike_strokes, found.few_strokes) = (discover::Verdict::Ambiguous, 20, 4, true);
    found.effects.truncate(1);
    assert_eq!(
        discovery::headline(found),
        "What is missing looks like dead-time, but so few different strokes do not confirm it (20 in all, 4 different): record others."
    );
    found.effects[0].confidence = 0.0;
    assert_eq!(discovery::headline(found), "What is missing looks like dead-time, but recordings that it has not seen speak against it.");
    found.effects[0].confidence = 0.5;
    found.unexplained = 0.2;
    let by_another = "What is missing looks like dead-time, by another law than the catalogue's or with something else: 20\u{202f}% of it stays unexplained.";
    assert_eq!(discovery::headline(found), by_another);
}
