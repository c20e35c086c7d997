//! Public items of the two crates that others may take from a registry, counted against the examples in their documentation.
//!
//! How it counts: every `pub` function, method, type, trait, constant and static of a public module is an item, and so is every function of a public
//! trait; fields, variants and what only a private module sees are none. An item has an example when an example of its own file, be it on the module,
//! on the item or on its type, names it. Only examples that are compiled and run count; `cargo test` runs them.

use std::collections::BTreeSet;
use std::path::Path;

/// Share of the items that has an example.
const WANTED: f64 = 0.9;

/// The words of all examples in a file that run.
fn examples(text: &str) -> BTreeSet<String> {
    let mut words = BTreeSet::new();
    // Whether a block is open, and whether it runs.
    let mut open: Option<bool> = None;
    for line in text.lines() {
        let Some(line) = ["//! ", "/// ", "//!", "///"].iter().find_map(|mark| line.trim_start().strip_prefix(mark)) else {
            open = None;
            continue;
        };
        if let Some(language) = line.trim_start().strip_prefix("```") {
            open = if open.is_some() { None } else { Some(["", "rust"].contains(&language.trim())) };
        } else if open == Some(true) {
            let code = line.split("//").next().unwrap_or_default();
            words.extend(code.split(|letter: char| !letter.is_alphanumeric() && letter != '_').map(str::to_owned));
        }
    }
    words
}

/// The public items of a file by their names, in order; what stands behind the first `#[cfg(test)]` or `#[cfg(all(test` at the margin is for tests.
fn items(text: &str) -> Vec<String> {
    let code = ["\n#[cfg(test)]", "\n#[cfg(all(test"].iter().fold(text, |text, mark| text.split(mark).next().unwrap_or_default());
    let mut found = Vec::new();
    let mut in_trait = false;
    for line in code.lines() {
        let trimmed = line.trim_start();
        in_trait |= line.starts_with("pub trait ");
        in_trait &= line != "}";
        let declared = trimmed
            .strip_prefix("pub ")
            .or_else(|| trimmed.strip_prefix("fn ").filter(|_| in_trait && line.starts_with("    fn ")).map(|_| trimmed));
        let mut words =
            declared.unwrap_or_default().split_whitespace().skip_while(|word| ["const", "static"].contains(word) && !is_constant(trimmed));
        let kinds = ["fn", "struct", "enum", "trait", "type", "const", "static"];
        if words.next().is_some_and(|kind| kinds.contains(&kind))
            && let Some(name) = words.next()
        {
            let name: String = name.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect();
            // A macro's placeholder has the names of what is made of it.
            if !name.is_empty() {
                found.push(name);
            }
        }
    }
    found
}

/// `pub const NAME:` and not `pub const fn`.
fn is_constant(line: &str) -> bool {
    !line.contains("const fn ")
}

/// Items without an example and with one, over the files that a package's public modules are.
fn counted(source: &Path) -> (Vec<String>, usize) {
    let (mut without, mut with) = (Vec::new(), 0);
    let mut folders = vec![source.to_owned()];
    while let Some(folder) = folders.pop() {
        let parent = ["lib.rs", "mod.rs"]
            .iter()
            .map(|name| folder.join(name))
            .find(|path| path.exists())
            .unwrap_or_else(|| folder.with_extension("rs"));
        let parent = std::fs::read_to_string(parent).unwrap();
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            let is_public = parent.contains(&format!("pub mod {name};"));
            if path.is_dir() {
                if is_public {
                    folders.push(path);
                }
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let words = examples(&text);
            // Of a private module only what its parent hands on.
            let handed_on = |item: &str| {
                parent.split("pub use ").skip(1).any(|used| {
                    let used = used.split(';').next().unwrap_or_default();
                    used.contains(&format!("{name}::"))
                        && used.split(|letter: char| !letter.is_alphanumeric() && letter != '_').any(|word| word == item)
                })
            };
            let public = is_public || ["lib", "mod"].contains(&name.as_str());
            let mut of_its_type = public;
            for item in items(&text) {
                // A method belongs to the type before it.
                if item.starts_with(char::is_uppercase) {
                    of_its_type = public || handed_on(&item);
                }
                if !of_its_type && !handed_on(&item) {
                    continue;
                }
                if words.contains(&item) {
                    with += 1;
                } else {
                    without.push(format!("{}: {item}", path.display()));
                }
            }
        }
    }
    (without, with)
}

#[test]
fn nine_public_items_of_ten_have_an_example_that_runs() {
    for package in ["hysteresis", "model-export"] {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join(package).join("src");
        let (without, with) = counted(&source);
        let share = with as f64 / (with + without.len()) as f64;
        println!("{package}: {with} of {} public items, {:.0} %", with + without.len(), 100.0 * share);
        assert!(with > 40, "{package}: only {with} items with an example: is the pattern still right?");
        assert!(
            share >= WANTED,
            "{package}: {:.0} % of the public items have an example; these have none:\n{}",
            100.0 * share,
            without.join("\n")
        );
    }
}

#[test]
fn the_count_finds_what_it_looks_for() {
    let text = "//! Text.\n//! ```\n//! let a = Thing::new(3); // hidden_word\n//! ```\n//! ```text\n//! not_code\n//! ```\npub struct Thing;\nimpl Thing {\n    pub const fn new(x: u8) -> Self {\n    }\n    pub fn lost(&self) {}\n    fn own(&self) {}\n}\npub const LIMIT: u8 = 3;\npub trait Able {\n    fn can(&self);\n}\npub(crate) fn inner() {}\n#[cfg(test)]\nmod tests {\n    pub fn helper() {}\n}\n";
    assert_eq!(items(text), ["Thing", "new", "lost", "LIMIT", "Able", "can"]);
    let words = examples(text);
    assert!(words.contains("Thing") && words.contains("new"));
    assert!(!words.contains("hidden_word") && !words.contains("not_code") && !words.contains("lost"));
}
