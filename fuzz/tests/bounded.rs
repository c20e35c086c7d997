//! Half a minute of changed files for every reader, from a fixed seed; continuous integration takes two, and `cargo xtask fuzz` longer ones.

use std::path::Path;
use std::time::Duration;

#[test]
fn every_changed_file_ends_in_a_result_or_a_clear_refusal() {
    let duration = Duration::from_secs_f64(60.0 * fuzz::minutes(0.5));
    let found = fuzz::parent::run(Path::new(env!("CARGO_BIN_EXE_fuzz-readers")), fuzz::seed(), duration).expect("children start");
    println!("{} inputs, {} of them accepted", found.inputs, found.accepted);
    found.targets.iter().for_each(|(name, (inputs, accepted))| println!("  {name}: {inputs} inputs, {accepted} accepted"));
    assert!(found.wrong.is_empty(), "{} of {} inputs:\n{}", found.wrong.len(), found.inputs, found.wrong.join("\n"));
    // Neither is everything refused at the door, nor is everything accepted.
    assert_eq!(found.targets.len(), fuzz::targets::all().len(), "every reader was reached");
    assert!(found.targets.values().all(|(inputs, accepted)| *accepted > 0 && accepted < inputs), "{:?}", found.targets);
    assert!(found.inputs > 500 && found.accepted * 100 > found.inputs && found.accepted < found.inputs, "{found:?}");
}
