//! The report of the demonstration.

use super::results::{Demo, Rig};
use crate::report::chart::{Caption, Panel, Series, bars, loops, panels};
use crate::report::page::{Cell, Page, Width};
use crate::report::text::{count, number};
use crate::report::{primer, sections};

const UNIT: &str = "mm";

/// The whole document.
#[must_use]
pub fn page(demo: &Demo) -> String {
    let mut page = Page::new(
        "Hysteresis, learned and put on a chip",
        "Two simulated pneumatic catheters were excited, identified, learned by networks, quantised for a microcontroller and verified, \
         from nothing, by one command. This page shows what came out and how to read it.",
    );
    summary(&mut page, demo);
    primer::add(&mut page);
    for (index, rig) in demo.rigs.iter().enumerate() {
        page.section(&rig.title);
        page.paragraph(&rig.what);
        page.paragraph(&format!(
            "What is shown is the blob as the microcontroller runs it: {}, {} bytes. It was made from {} recordings with {} samples; none of the \
             recordings below was among them, and their frequencies and decay times do not occur there.",
            describe(rig),
            count(rig.export.bytes),
            count(rig.training_recordings),
            count(rig.training_samples)
        ));
        sections::families(&mut page, &rig.families, UNIT);
        if index == 0 {
            sections::examples_help(&mut page);
        }
        sections::examples(&mut page, &rig.examples);
    }
    ladders(&mut page, demo);
    holds(&mut page, demo);
    quantisation(&mut page, demo);
    acceptance(&mut page, demo);
    how_it_was_made(&mut page, demo);
    page.finish(&format!("Made by catheter {} with seed {}. Every figure on this page is in demo.json beside it.", demo.version, demo.seed))
}

fn describe(rig: &Rig) -> String {
    if rig.hybrid.training.has_network {
        format!("a hybrid of play operators and a small network, {} multiplications a step", count(rig.hybrid.macs_per_step))
    } else {
        format!("play operators alone, {} multiplications a step, because a network had nothing to add", count(rig.hybrid.macs_per_step))
    }
}

fn summary(page: &mut Page, demo: &Demo) {
    let (held, all, missed) = demo.count_of_checks();
    let missed =
        if missed.is_empty() { String::new() } else { format!(" (these do not, and are for comparison only: {})", missed.join(", ")) };
    let mut tiles = vec![(
        if demo.passed { "Verified".to_owned() } else { "Not verified".to_owned() },
        format!("{held} of {all} checks hold, those of the suite among them{missed}; {:.0} s on {} thread(s)", demo.seconds, demo.threads),
        Some(demo.passed),
    )];
    for rig in &demo.rigs {
        tiles.push((
            format!("{} {UNIT}", number(rig.families.iter().map(|family| family.rmse).sum::<f64>() / rig.families.len().max(1) as f64, 2)),
            format!("**{}:** RMSE of the blob, mean of the four families, free running", rig.title),
            None,
        ));
        if let Some(fixed) =
            rig.suites.iter().find_map(|suite| suite.report.fixed_point.as_ref()).filter(|_| rig.hybrid.training.has_network)
        {
            tiles.push((
                format!("{} {UNIT}", number(fixed.rmse, 2)),
                format!("lost by fixed point against f32, over {} steps", count(fixed.n)),
                None,
            ));
        }
    }
    page.tiles(&tiles);
    if demo.quick {
        page.paragraph(
            "**A quick run:** a fraction of the data and of the training. It shows that everything works, not how well it works.",
        );
    }
}

fn ladders(page: &mut Page, demo: &Demo) {
    page.section("The ladder: how simple a model suffices?");
    if let Some(rig) = demo.rigs.first() {
        sections::ladder_help(page, &rig.ladder);
    }
    for rig in &demo.rigs {
        page.heading(&rig.title);
        sections::ladder(page, &rig.ladder, UNIT, &format!("on the four families of: {}", rig.title));
    }
    page.paragraph(
        "The two ladders tell the story together. On the paper\u{2019}s own simulator the truth **is** a Prandtl\u{2013}Ishlinskii model, so a least-squares \
         fit of one is exact up to rounding, in a fraction of a second, and a neural network can only be worse. A published error of a few \
         hundredths on such data says how well a network imitates play operators, not that a network is needed. On a rig with lag, creep and \
         stick-slip play operators alone stop far above the noise, and a network pays for its multiplications.",
    );
}

fn holds(page: &mut Page, demo: &Demo) {
    page.section("Holding still");
    page.paragraph(
        "A catheter spends most of its time at rest. While the pressure stands still a network keeps computing, and a tiny error in each step \
         adds up. The maps show it for three models of each rig.",
    );
    sections::holds_help(page, true);
    for rig in &demo.rigs {
        page.heading(&rig.title);
        let maps: Vec<_> = rig.suites.iter().map(|suite| (suite.name.as_str(), &suite.report)).collect();
        sections::holds(page, &maps, "bar", UNIT);
    }
}

fn quantisation(page: &mut Page, demo: &Demo) {
    page.section("From f32 to the microcontroller");
    page.paragraph(
        "The blob holds 8-bit weights with a scale for each row; activations and hidden state have 16 bits, the cell state more. The exporter \
         proves that no sum can overflow, carries golden vectors from an f64 reference in the blob, and the microcontroller replays them \
         before it trusts the model. The desktop evaluates blobs with the microcontroller\u{2019}s own code, so what is shown here is what runs there.",
    );
    let row = |rig: &Rig| {
        let fixed = rig.suites.iter().find_map(|suite| suite.report.fixed_point.as_ref());
        vec![
            Cell::Text(rig.title.clone()),
            Cell::Figure(count(rig.export.bytes)),
            Cell::Figure(fixed.map_or_else(String::new, |fixed| number(fixed.rmse, 3))),
            Cell::Figure(fixed.map_or_else(String::new, |fixed| number(fixed.max_abs, 3))),
            Cell::Figure(fixed.map_or_else(String::new, |fixed| number(fixed.growth, 2))),
            Cell::Figure(rig.export.accumulator_headroom.map_or_else(|| "no sums".to_owned(), |room| format!("{}\u{d7}", number(room, 3)))),
        ]
    };
    let rows: Vec<Vec<Cell>> = demo.rigs.iter().map(row).collect();
    page.table(
        "Fixed point against f32 on 100\u{202f}000 steps of random moves and holds, free running.",
        &["rig", "bytes", "RMSE / mm", "largest / mm", "growth / mm", "room in the tightest sum"],
        &rows,
        None,
    );
    for rig in demo.rigs.iter().filter(|rig| rig.hybrid.training.has_network) {
        quantised(page, rig);
    }
    page.heading("What was verified");
    let rows: Vec<Vec<Cell>> = demo
        .checks
        .iter()
        .map(|check| {
            vec![
                Cell::Text(check.name.clone()),
                Cell::Text(check.what.clone()),
                Cell::Figure(number(check.value, 3)),
                Cell::Figure(format!("\u{2264} {}", number(check.limit, 3))),
                Cell::Verdict(check.passed),
            ]
        })
        .collect();
    page.table(
        "The command ends with exit code 1 when one of these does not hold.",
        &["check", "what was measured", "value", "limit", "verdict"],
        &rows,
        None,
    );
}

fn quantised(page: &mut Page, rig: &Rig) {
    page.heading(&rig.title);
    let mut ratios = Vec::new();
    for (number_of_layer, layer) in rig.export.comparison.layers.iter().enumerate() {
        for signal in &layer.signals {
            let name = if rig.export.comparison.layers.len() > 1 {
                format!("{} {}", number_of_layer + 1, signal.name)
            } else {
                signal.name.to_owned()
            };
            ratios.push((name, signal.signal_to_noise_db.unwrap_or(f64::NAN)));
        }
    }
    page.begin_row();
    let plot = bars(
        Caption {
            title: "Signal to quantisation noise inside the network",
            description: "Bars in decibels for each gate, the cell and the hidden state.",
        },
        "signal to quantisation noise / dB",
        560.0,
        &ratios,
    );
    page.figure(
        plot,
        Width::Half,
        "**Inside the network.** Power of each signal over the power of its quantisation error; 6 dB are one bit. The weakest gate tells where bits \
         are missing.",
    );
    if let Some(fixed) = rig.suites.iter().find_map(|suite| suite.report.fixed_point.as_ref()) {
        let times: Vec<f64> =
            (0..fixed.stretches.len()).map(|index| (index as f64 + 0.5) * fixed.n as f64 / fixed.stretches.len() as f64 / 1000.0).collect();
        let plot = panels(
            Caption {
                title: "Fixed point against f32 over time",
                description: "Root mean square difference in ten stretches of a run of 100,000 steps; a level line is no growth.",
            },
            "thousand steps",
            560.0,
            &[Panel {
                label: "RMS difference / mm".to_owned(),
                series: vec![Series::new("fixed point less f32", "error", &times, &fixed.stretches)],
                height: 120.0,
                zero: true,
            }],
        );
        page.figure(
            plot,
            Width::Half,
            "**Over time.** Rounding errors that fed on themselves would make this line rise. It must stay level over 100\u{202f}000 steps, holds included.",
        );
    }
    page.end_row();
}

fn acceptance(page: &mut Page, demo: &Demo) {
    page.section("The acceptance suite");
    page.paragraph(
        "A small error on recordings like those of the training says little about a model that is to run for hours. The suite asks for more, with new \
         signals whose truth the simulated rig knows. A pure LSTM usually fails it at the holds; that is not a fault of the training.",
    );
    for rig in &demo.rigs {
        if let Some(last) = rig.suites.last() {
            page.heading(&format!("{}: {}", rig.title, last.name));
            sections::suite(page, &last.report);
        }
        let others: Vec<String> = rig
            .suites
            .iter()
            .rev()
            .skip(1)
            .map(|suite| {
                let failed: Vec<&str> =
                    suite.report.criteria.iter().filter(|criterion| !criterion.passed).map(|criterion| criterion.name.as_str()).collect();
                if failed.is_empty() {
                    format!("**{}** passes it", suite.name)
                } else {
                    format!("**{}** fails {}", suite.name, failed.join(", "))
                }
            })
            .collect();
        page.paragraph(&format!("On the same rig {}.", others.join("; ")));
    }
}

fn how_it_was_made(page: &mut Page, demo: &Demo) {
    page.section("How it was made");
    for rig in &demo.rigs {
        let history = &rig.lstm.training.report.history;
        let hybrid = &rig.hybrid.training.report.history;
        if history.is_empty() && hybrid.is_empty() {
            continue;
        }
        page.heading(&format!("{}: training", rig.title));
        let logarithms = |history: &[crate::train::Milestone]| -> (Vec<f64>, Vec<f64>) {
            let steps = history.iter().map(|milestone| milestone.steps as f64).collect();
            (steps, history.iter().map(|milestone| milestone.validation_rmse.log10()).collect())
        };
        let (steps, errors) = logarithms(history);
        let mut series = vec![Series::new("LSTM", "one", &steps, &errors)];
        if !hybrid.is_empty() {
            let (steps, errors) = logarithms(hybrid);
            series.push(Series::new("hybrid", "model", &steps, &errors));
        }
        page.begin_row();
        page.figure(
            loops(
                Caption {
                    title: "Validation error during training",
                    description: "Logarithm of the validation RMSE over optimiser steps.",
                },
                "optimiser steps",
                "log\u{2081}\u{2080}(validation RMSE / mm)",
                (560.0, 260.0),
                &series,
            ),
            Width::Half,
            "Free-running error on recordings kept apart, while the networks learned. One unit down is a tenfold smaller error.",
        );
        let runs = [("LSTM", &rig.lstm), ("hybrid", &rig.hybrid)];
        page.end_row();
        let rows: Vec<Vec<Cell>> = runs
            .into_iter()
            .map(|(name, model)| {
                let report = &model.training.report;
                vec![
                    Cell::Text(name.to_owned()),
                    Cell::Figure(count(model.parameters)),
                    Cell::Figure(number(report.epochs, 3)),
                    Cell::Figure(number(report.seconds, 3)),
                    Cell::Figure(number(report.train_macs_per_second / 1e9, 3)),
                    Cell::Figure(number(report.val_rmse, 3)),
                ]
            })
            .collect();
        page.table(
            "Training, one thread each.",
            &["model", "fitted numbers", "epochs", "seconds", "GMAC/s", "validation RMSE / mm"],
            &rows,
            None,
        );
    }
    let rows: Vec<Vec<Cell>> = demo
        .stages
        .iter()
        .map(|stage| vec![Cell::Text(stage.name.clone()), Cell::Text(stage.what.clone()), Cell::Figure(number(stage.seconds, 2))])
        .collect();
    page.table("Stages.", &["stage", "what it did", "seconds"], &rows, None);
    page.paragraph("Each stage is a command of its own that takes lab recordings just as well:");
    page.code(&format!(
        "catheter simulate rich --plant all-effects --out data --seed {seed}\n\
         catheter identify --data data/train --out physics.toml\n\
         catheter train --data data/train --out model.safetensors --seed {seed}\n\
         catheter export model.safetensors --calibration data/train --out model.blob\n\
         catheter evaluate --model model.blob --reference model.safetensors --data data/test --suite \\\n  \
         --ladder --ladder-train data/train --html evaluation.html",
        seed = demo.seed
    ));
}
