//! The demonstration: from nothing to a verified blob and a report, on two simulated rigs.
//!
//! The first rig is the paper's: its simulator, its 24 descending sines, its four test families. There play operators are exact by
//! construction, and an honest demonstration must show that. The second rig has what real ones have besides (dead time, lag,
//! rate-dependent thresholds, creep, a dead zone, saturation, stick-slip) and is trained on the rich set: there the network earns its
//! keep. Every stage uses the code of the command of the same name; the files it leaves can be taken further with these commands.

mod page;
mod plan;
mod results;
mod stages;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};

pub use plan::DemoConfig;
use plan::Plan;
pub use results::{Demo, Exported, Model, Rig, Stage, Trained};

use crate::evaluate::ladder::{self, Entry};
use crate::evaluate::suite::{self, Criterion, KnownPlant, SuiteReport};
use crate::evaluate::{FileErrors, Judging, by_family, judge};
use crate::model::{self, BlobModel, NetworkModel, Predictor};
use crate::plant::dataset::SetKind;
use crate::recording::Recording;
use crate::report::{self, Example};
use crate::{output, say};

const PLANS: [Plan; 2] = [
    Plan {
        name: "paper",
        title: "The paper\u{2019}s simulated rig",
        plant: "pi",
        kind: SetKind::Paper,
        what: "Five play operators and nothing else; trained on the paper\u{2019}s 24 descending sines, with its noise on the input.",
    },
    Plan {
        name: "effects",
        title: "A rig with every effect",
        plant: "all-effects",
        kind: SetKind::Rich,
        what: "The same play operators behind a lag of 0.2 s and a dead time of 60 ms, with rate-dependent thresholds, creep, a dead zone, \
               saturation and a tip that sticks and jumps; trained on rich recordings: all amplitudes, offsets, holds, random histories.",
    },
];

/// Largest error that the demonstration's training must reach on family (a), in mm.
const REACHES_MM: f64 = 0.01;

/// Runs the demonstration, leaving models, recordings, `demo.json` and `report.html` in the folder.
///
/// # Errors
/// When a file cannot be written or a stage fails. A check that does not hold is no error: see [`Demo::passed`].
pub fn run(config: &DemoConfig) -> Result<Demo> {
    let begun = Instant::now();
    let mut clock = stages::Clock::new(6);
    let place = |plan: &Plan| config.folder.join("data").join(plan.name);

    clock.begin("simulate", "two rigs, their training recordings and the paper's four test families");
    let data = PLANS.iter().map(|plan| stages::simulate(plan, config, &place(plan))).collect::<Result<Vec<_>>>()?;

    clock.begin("identify", "play operators by least squares, and the simple models of the ladder");
    let simple = crate::evaluate::for_each(&data, config.threads, |data| stages::identify(data, &config.folder))?;

    clock.begin("train", "an LSTM and a hybrid for each rig");
    let trained = stages::train(&data, config)?;

    clock.begin("quantise", "int8 weights, int16 activations, into a blob each");
    let exports: Vec<stages::Quantised> =
        data.iter().zip(&trained).map(|(data, trained)| stages::quantise(data, trained, &config.folder)).collect::<Result<_>>()?;

    clock.begin("evaluate", "four families, the ladder, holds, 100,000 steps");
    let mut rigs = Vec::new();
    let mut checks = Vec::new();
    for (((data, simple), trained), quantised) in data.into_iter().zip(simple).zip(trained).zip(exports) {
        let (rig, mut found) = evaluate(data, simple, trained, quantised, config)?;
        checks.append(&mut found);
        rigs.push(rig);
    }

    clock.begin("report", "report.html and demo.json");
    let passed = checks.iter().all(|check| check.passed);
    let mut demo = Demo {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        threads: config.threads,
        quick: config.quick,
        seconds: begun.elapsed().as_secs_f64(),
        stages: clock.finish(),
        rigs,
        checks,
        passed,
    };
    demo.seconds = begun.elapsed().as_secs_f64();
    output::write_result(&config.folder.join("demo.json"), &demo)?;
    output::write_atomic(&config.folder.join("report.html"), page::page(&demo).as_bytes())?;
    Ok(demo)
}

/// Judges everything that was made for one rig, and verifies the blob.
fn evaluate(
    data: stages::Data,
    simple: Vec<Entry>,
    trained: stages::TrainedPair,
    quantised: stages::Quantised,
    config: &DemoConfig,
) -> Result<(Rig, Vec<Criterion>)> {
    let stages::Data { plan, plant, train, test } = data;
    let lstm = NetworkModel::new(trained.lstm.model, Path::new("lstm.safetensors"))?;
    let hybrid = NetworkModel::new(trained.hybrid.model, Path::new("hybrid.safetensors"))?;
    let blob = BlobModel::load(&quantised.path)?;
    let golden = blob.replay()?;

    let judging = Judging::default();
    let judged = judge(&blob, &test, judging, config.threads)?;
    let files: Vec<FileErrors> = judged.iter().map(|judged| judged.errors.clone()).collect();
    let families = by_family(&files);
    let by_lstm = judge(&lstm, &test, judging, config.threads)?;
    let mut examples: Vec<Example> = report::examples("hybrid, fixed point", &test, &judged);
    report::add_prediction(&mut examples, "LSTM", &by_lstm);

    let known = KnownPlant { name: plan.plant.to_owned(), plant };
    let examine = |model: &dyn Predictor, reference: Option<&dyn Predictor>, files: &[FileErrors]| -> Result<SuiteReport> {
        suite::run(&suite::Request {
            model,
            reference,
            recordings: &test,
            errors: files,
            judging,
            plant: Some(&known),
            limits: suite::Limits::default(),
            seed: config.seed,
            threads: config.threads,
        })
    };
    let lstm_files: Vec<FileErrors> = by_lstm.into_iter().map(|judged| judged.errors).collect();
    let physics = simple.iter().find(|entry| entry.name == "PI").context("the ladder has no PI")?;
    let physics_files: Vec<FileErrors> =
        judge(&*physics.model, &test, judging, config.threads)?.into_iter().map(|judged| judged.errors).collect();
    let suites = vec![
        ("PI".to_owned(), examine(&*physics.model, None, &physics_files)?),
        ("LSTM".to_owned(), examine(&lstm, None, &lstm_files)?),
        ("hybrid, fixed point".to_owned(), examine(&blob, Some(&hybrid), &files)?),
    ];

    let mut entries = simple;
    let (lstm_description, hybrid_description) = (lstm.description().clone(), hybrid.description().clone());
    entries.push(Entry { name: "LSTM".to_owned(), model: Box::new(lstm) });
    entries.push(Entry { name: "hybrid".to_owned(), model: Box::new(hybrid) });
    entries.push(Entry { name: "hybrid, fixed point".to_owned(), model: Box::new(blob) });
    let ladder = ladder::climb(&entries, &test, judging, config.threads)?;

    let checks = checks(plan, &families, &suites[2].1, golden, config.quick);
    let describe = |description: &model::Description, trained: &Trained| Model {
        kind: description.kind.clone(),
        parameters: description.parameters,
        macs_per_step: description.macs_per_step,
        training: trained.clone(),
    };
    let rig = Rig {
        name: plan.name.to_owned(),
        title: plan.title.to_owned(),
        what: plan.what.to_owned(),
        plant: known.plant.config().clone(),
        training_recordings: train.len(),
        training_samples: train.iter().map(Recording::len).sum(),
        lstm: describe(&lstm_description, &trained.lstm.result),
        hybrid: describe(&hybrid_description, &trained.hybrid.result),
        export: quantised.result,
        families,
        files,
        ladder,
        suites: suites.into_iter().map(|(name, report)| results::NamedSuite { name, report }).collect(),
        examples,
    };
    Ok((rig, checks))
}

/// What decides whether the demonstration passed: the blob is verified, and the training reached what it must.
fn checks(
    plan: &Plan,
    families: &[crate::evaluate::FamilyErrors],
    suite: &SuiteReport,
    golden: firmware::estimator::GoldenReplay,
    quick: bool,
) -> Vec<Criterion> {
    let name = |what: &str| format!("{}: {what}", plan.name);
    let mut checks = vec![Criterion::at_most(
        &name("golden vectors"),
        format!(
            "the blob replays {} golden samples of the f64 reference within its tolerance, with the same bits as at export (0: yes, 1: no)",
            golden.samples
        ),
        if golden.passed() { 0.0 } else { 1.0 },
        0.0,
        "",
    )];
    let of_suite = ["fixed-point", "fixed-point-growth"];
    checks.extend(
        suite
            .criteria
            .iter()
            .filter(|criterion| of_suite.contains(&criterion.name.as_str()))
            .map(|criterion| Criterion { name: name(&criterion.name), ..criterion.clone() }),
    );
    if !quick {
        let reached = families.iter().find(|family| family.family == "a").map_or(f64::NAN, |family| family.rmse);
        let what = "RMSE of the blob on family (a), free running".to_owned();
        checks.push(Criterion::at_most(&name("family a"), what, reached, REACHES_MM, "mm"));
    }
    checks
}

/// Prints the ten lines that sum the demonstration up.
pub fn print_summary(demo: &Demo, folder: &Path) {
    say!();
    for rig in &demo.rigs {
        let each: Vec<String> = rig.families.iter().map(|family| format!("{} {:.4}", family.family, family.rmse)).collect();
        let best = rig.ladder.simplest_sufficient.as_deref().unwrap_or("none");
        let fixed = rig.suites.iter().find_map(|suite| suite.report.fixed_point.as_ref());
        say!("{}:", rig.title.replace('\u{2019}', "'"));
        say!("  blob on the four families, RMSE in mm: {}", each.join(", "));
        say!("  simplest model that suffices: {best}");
        say!(
            "  {} bytes, fixed point against f32: RMSE {:.1e} mm over {} steps",
            rig.export.bytes,
            fixed.map_or(f64::NAN, |comparison| comparison.rmse),
            fixed.map_or(0, |comparison| comparison.n)
        );
    }
    for check in demo.checks.iter().filter(|check| !check.passed) {
        say!("FAILED  {}: {} is {:.3e}, at most {:.3e} is allowed", check.name, check.what, check.value, check.limit);
    }
    let (held, all, missed) = demo.count_of_checks();
    let missed =
        if missed.is_empty() { String::new() } else { format!("; these do not, and are for comparison only: {}", missed.join(", ")) };
    say!("{held} of {all} checks hold{missed}");
    let verdict = if demo.passed { "verified" } else { "NOT verified" };
    say!("{verdict} in {:.0} s: {}", demo.seconds, folder.join("report.html").display());
}
