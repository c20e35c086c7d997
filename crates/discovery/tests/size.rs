//! How large discovery is: lines of code, and numbers set by hand in selection and verdict. `DISCOVERY_SRC` measures another tree.

use std::fs;
use std::path::{Path, PathBuf};

/// Ceilings: lower them when it shrinks.
const MOST_LINES: usize = 12_031;

const MOST_NUMBERS: usize = 40;

const MOST_SETTINGS: usize = 15;

/// Every source file below a folder but those of tests.
fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()) {
        if entry.is_dir() {
            files(&entry, found);
        } else if entry.extension().is_some_and(|extension| extension == "rs") && entry.file_name().is_some_and(|name| name != "tests.rs") {
            found.push(entry);
        }
    }
}

/// The lines of code of a file: no tests, no blank lines, no comments.
fn code(file: &Path) -> Vec<String> {
    let text = fs::read_to_string(file).expect("a file");
    let mut lines: Vec<&str> = text.lines().collect();
    // Tests inside a file come last.
    if let Some(tests) = lines.windows(2).position(|pair| pair[0] == "#[cfg(test)]" && pair[1].starts_with("mod ")) {
        lines.truncate(tests);
    }
    lines.into_iter().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("//")).map(str::to_owned).collect()
}

/// Whether a line declares a number, or some.
fn sets_a_number(line: &str) -> bool {
    let declared = line.trim_start_matches("pub ").strip_prefix("const ").and_then(|line| line.split_once(": "));
    declared.is_some_and(|(_, kind)| ["f64", "usize", "u32", "i32", "[f64", "[usize"].iter().any(|number| kind.starts_with(number)))
}

#[test]
fn discovery_does_not_grow() {
    let root = std::env::var_os("DISCOVERY_SRC").map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), PathBuf::from);
    let mut all = Vec::new();
    files(&root, &mut all);
    let lines: usize = all.iter().map(|file| code(file).len()).sum();
    let numbers = |which: &dyn Fn(&Path) -> bool| -> Vec<String> {
        all.iter().filter(|file| which(file)).flat_map(|file| code(file)).filter(|line| sets_a_number(line)).collect()
    };
    let selecting = numbers(&|file| file.starts_with(root.join("selection")) || file.ends_with("finding.rs"));
    let settings = numbers(&|file| file.ends_with("selection/settings.rs")).len();
    println!("{lines} lines of code, {} numbers set by hand in selection and verdict, {settings} of them settings", selecting.len());
    assert!(lines <= MOST_LINES, "{lines} lines of code");
    assert!(selecting.len() <= MOST_NUMBERS, "{}: {selecting:#?}", selecting.len());
    assert!(settings <= MOST_SETTINGS, "{settings} settings");
}
