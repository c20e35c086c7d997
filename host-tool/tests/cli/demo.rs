//! What `catheter demo` leaves behind.

use std::sync::LazyLock;

use crate::support::{Bench, Said};

/// One demonstration for all tests, and what it printed.
static DEMO: LazyLock<(Bench, Said)> = LazyLock::new(|| {
    let bench = Bench::new();
    let said = bench.works("demo --quick --out demo --seed 3 --threads 2");
    (bench, said)
});

#[test]
fn the_report_of_the_demo_needs_nothing_from_outside() {
    let (bench, _) = &*DEMO;
    let report = String::from_utf8(bench.read("demo/report.html")).expect("HTML is text");
    assert!(report.contains("<svg"), "the report shows no plot");
    for outside in ["src=\"http", "src='http", "<script src", "<link ", "@import", "url(http"] {
        assert!(!report.contains(outside), "the report needs something from outside: {outside}");
    }
}

#[test]
fn the_demo_leaves_every_file_it_names_whole_and_usable() {
    let (bench, said) = &*DEMO;
    let demo = bench.json("demo/demo.json");
    assert_eq!((&demo["seed"], &demo["quick"], &demo["passed"]), (&3.into(), &true.into(), &true.into()));
    for stage in ["simulate", "identify", "train", "quantise", "evaluate", "report"] {
        assert!(said.stdout.contains(&format!("{stage}: ")), "no word about {stage}:\n{}", said.stdout);
    }
    assert!(said.stdout.contains("demo/report.html"), "the report is not named:\n{}", said.stdout);
    let rigs = demo["rigs"].as_array().expect("rigs");
    assert_eq!(rigs.len(), 2);
    for rig in rigs {
        let name = rig["name"].as_str().expect("a name");
        let blob = rig["export"]["file"].as_str().expect("a file");
        assert_eq!(bench.read(&format!("demo/{blob}")).len() as u64, rig["export"]["bytes"].as_u64().expect("a size"));
        bench.works(&format!("inspect demo/{blob}"));
        for kind in ["lstm", "hybrid"] {
            let file = rig[kind]["training"]["file"].as_str().expect("a file");
            bench.works(&format!("evaluate --model demo/{file} --data demo/data/{name}/test"));
        }
        // What the report says of the blob is what the command says of it.
        bench.works(&format!("evaluate --model demo/{blob} --data demo/data/{name}/test --json again.json"));
        let (then, now) = (&rig["files"], &bench.json("again.json")["files"]);
        for (then, now) in then.as_array().expect("files").iter().zip(now.as_array().expect("files")) {
            assert_eq!(then["rmse"], now["rmse"], "{}", then["path"]);
        }
    }
    // On the paper's own simulator play operators are exact, and the demonstration says so.
    assert_eq!(rigs[0]["ladder"]["simplest_sufficient"], "PI");
    let leftovers: Vec<_> = std::fs::read_dir(bench.path("demo"))
        .expect("a folder")
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| !["html", "json", "toml", "safetensors", "blob"].iter().any(|ending| name.ends_with(ending)) && name != "data")
        .collect();
    assert!(leftovers.is_empty(), "{leftovers:?}");
}

#[test]
fn the_same_seed_gives_the_same_models() {
    let (bench, _) = &*DEMO;
    bench.works("demo --quick --out again --seed 3 --threads 1");
    // Each network trains on one thread, however many train at the same time.
    for file in ["effects-hybrid.blob", "effects-lstm.safetensors", "paper-physics.toml"] {
        assert!(bench.read(&format!("demo/{file}")) == bench.read(&format!("again/{file}")), "{file} differs");
    }
}
