//! The shape of the sources: which file of a package needs which, read from their `use` lines and paths.
//!
//! A file needs another one when it names something that is defined there: through `crate::`, `super::` or a re-export, which is followed to
//! where the thing is. A module needs its children, since it declares them. What stands under `#[cfg(test)]` does not count. The same holds for the
//! folders and files at the top of a package, each taken as one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A module's path within its package, `tick::config`; the root is empty.
type Module = String;

#[derive(Default)]
struct Package {
    /// Tokens of each module's file.
    files: BTreeMap<Module, Vec<String>>,
}

impl Package {
    fn read(source: &Path) -> Self {
        let mut package = Self::default();
        package.read_folder(source, "");
        package
    }

    fn read_folder(&mut self, folder: &Path, module: &str) {
        let mut entries: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        entries.sort();
        for path in entries {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            if path.is_dir() {
                if name != "bin" && name != "tests" {
                    self.read_folder(&path, &child(module, &name));
                }
            } else if path.extension().is_some_and(|extension| extension == "rs") && name != "main" && name != "tests" {
                let module = if ["lib", "mod"].contains(&name.as_str()) { module.to_owned() } else { child(module, &name) };
                self.files.insert(module, tokens(&std::fs::read_to_string(&path).unwrap()));
            }
        }
    }

    /// The modules that each module needs.
    fn needs(&self) -> BTreeMap<&str, BTreeSet<&str>> {
        let mut needs: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (module, tokens) in &self.files {
            let needed = needs.entry(module).or_default();
            for path in paths(tokens) {
                if let Some(home) = self.home(module, &path, 0) {
                    needed.insert(home);
                }
            }
            needed.extend(self.files.keys().filter(|other| parent(other) == Some(module.as_str())).map(String::as_str));
            needed.remove(module.as_str());
        }
        needs
    }

    /// Where the thing is defined that a path names, as it is written in a module.
    fn home(&self, module: &str, path: &[String], depth: u32) -> Option<&str> {
        let (first, rest) = path.split_first()?;
        let (mut at, mut rest) = match first.as_str() {
            "crate" => (String::new(), rest),
            "self" => (module.to_owned(), rest),
            "super" => (parent(module)?.to_owned(), rest),
            // A child, or nothing of this package.
            name => (self.files.contains_key(&child(module, name)).then(|| child(module, name))?, rest),
        };
        while let Some((next, after)) = rest.split_first() {
            at = match next.as_str() {
                "super" => parent(&at)?.to_owned(),
                name if self.files.contains_key(&child(&at, name)) => child(&at, name),
                _ => break,
            };
            rest = after;
        }
        let (home, tokens) = self.files.get_key_value(&at)?;
        // A name that the file itself has from elsewhere.
        if let Some(name) = rest.first()
            && depth < 8
        {
            let is_its_own = |used: &Used| used.path == [name.clone()] && self.files.contains_key(&child(&at, name));
            let from = uses(tokens).into_iter().find(|used| used.name == *name && !is_its_own(used));
            if let Some(used) = from {
                // Nothing, where it is from another package.
                return self.home(&at, &[used.path.as_slice(), &rest[1..]].concat(), depth + 1);
            }
        }
        Some(home)
    }
}

fn child(module: &str, name: &str) -> Module {
    if module.is_empty() { name.to_owned() } else { format!("{module}::{name}") }
}

fn parent(module: &str) -> Option<&str> {
    if module.is_empty() { None } else { Some(module.rsplit_once("::").map_or("", |(parent, _)| parent)) }
}

/// Words and signs of a source, without comments, strings, and what is for tests.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens = Vec::new();
    let (mut marked, mut in_tests) = (false, false);
    for line in text.lines() {
        // A module for tests that stands in the file ends with a brace at the margin.
        in_tests |= marked && line.contains("mod ") && line.ends_with('{');
        marked = ["#[cfg(test)]", "#[cfg(all(test"].iter().any(|mark| line.starts_with(mark));
        if in_tests {
            in_tests = line != "}";
            continue;
        }
        // Quotes of characters and lifetimes do no harm; a string with `//` or a path in it is not code.
        let mut outside = String::new();
        for (nth, piece) in line.split("//").next().unwrap_or_default().split('"').enumerate() {
            if nth % 2 == 0 {
                outside.push_str(piece);
            }
        }
        let mut word = String::new();
        for letter in outside.chars().chain([' ']) {
            if letter.is_alphanumeric() || letter == '_' {
                word.push(letter);
                continue;
            }
            if !word.is_empty() {
                tokens.push(std::mem::take(&mut word));
            }
            if !letter.is_whitespace() {
                tokens.push(letter.to_string());
            }
        }
    }
    tokens
}

/// A name that a `use` item brings, and the path it stands for.
struct Used {
    name: String,
    path: Vec<String>,
}

/// What all `use` items bring.
fn uses(tokens: &[String]) -> Vec<Used> {
    let mut found = Vec::new();
    for (at, token) in tokens.iter().enumerate() {
        if token == "use" {
            tree(tokens, at + 1, &[], &mut found);
        }
    }
    found
}

/// Takes the tree that begins at a token apart; gives the place behind it.
fn tree(tokens: &[String], mut at: usize, before: &[String], found: &mut Vec<Used>) -> usize {
    let mut path = before.to_vec();
    let mut new_name = None;
    while let Some(token) = tokens.get(at) {
        match token.as_str() {
            ":" => at += 1,
            "{" => {
                at += 1;
                while tokens.get(at).is_some_and(|token| token != "}") {
                    at = tree(tokens, at, &path, found);
                    at += usize::from(tokens.get(at).is_some_and(|token| token == ","));
                }
                return at + 1;
            }
            "," | "}" | ";" => break,
            // A module under its own name is the path so far.
            "self" if path.len() > before.len() || !before.is_empty() => at += 1,
            "as" => {
                new_name = tokens.get(at + 1).cloned();
                at += 2;
            }
            word => {
                path.push(word.to_owned());
                at += 1;
            }
        }
    }
    if let Some(name) = new_name.or(path.last().cloned()) {
        found.push(Used { name, path });
    }
    at
}

/// The paths that a file names: those of its `use` items, and those in its code.
fn paths(tokens: &[String]) -> Vec<Vec<String>> {
    let mut found: Vec<Vec<String>> = uses(tokens).into_iter().map(|used| used.path).collect();
    for (at, token) in tokens.iter().enumerate() {
        let begins = ["crate", "super"].contains(&token.as_str()) && (at == 0 || ![":", "$"].contains(&tokens[at - 1].as_str()));
        if begins {
            let mut path = vec![token.clone()];
            let mut next = at + 1;
            while tokens.get(next).is_some_and(|sign| sign == ":") && tokens.get(next + 1).is_some_and(|sign| sign == ":") {
                let Some(word) = tokens.get(next + 2).filter(|word| word.chars().all(|letter| letter.is_alphanumeric() || letter == '_'))
                else {
                    break;
                };
                path.push(word.clone());
                next += 3;
            }
            // A tree goes on: the names in it are among the `use` items.
            if path.len() > 1 && tokens.get(next).is_none_or(|sign| sign != ":") {
                found.push(path);
            }
        }
    }
    found
}

/// Groups of modules of which each needs, in the end, each other.
fn circles<'a>(needs: &BTreeMap<&'a str, BTreeSet<&'a str>>) -> Vec<Vec<&'a str>> {
    let reach = |from: &'a str| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(at) = open.pop() {
            for next in needs.get(at).into_iter().flatten() {
                if seen.insert(*next) {
                    open.push(next);
                }
            }
        }
        seen
    };
    let reached: BTreeMap<&str, BTreeSet<&str>> = needs.keys().map(|module| (*module, reach(module))).collect();
    let mut groups: Vec<Vec<&str>> = Vec::new();
    for module in needs.keys() {
        if reached[module].contains(module) && !groups.iter().flatten().any(|known| known == module) {
            groups.push(needs.keys().copied().filter(|other| reached[module].contains(other) && reached[other].contains(module)).collect());
        }
    }
    groups
}

/// The same for whole folders: what the root's modules need of each other.
fn folders<'a>(needs: &BTreeMap<&'a str, BTreeSet<&'a str>>) -> BTreeMap<&'a str, BTreeSet<&'a str>> {
    let top = |module: &'a str| module.split("::").next().unwrap_or_default();
    let mut folders: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (module, needed) in needs.iter().filter(|(module, _)| !module.is_empty()) {
        let others = needed.iter().map(|other| top(other)).filter(|other| *other != top(module));
        folders.entry(top(module)).or_default().extend(others);
    }
    folders
}

fn circles_of(package: &str) -> Vec<String> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(package).join("src");
    let package = Package::read(&source);
    assert!(!package.files.is_empty(), "{}", source.display());
    let needs = package.needs();
    let mut lines = Vec::new();
    for needs in [&needs, &folders(&needs)] {
        for group in circles(needs) {
            for module in &group {
                let within: Vec<&str> = needs[module].iter().copied().filter(|needed| group.contains(needed)).collect();
                lines.push(format!("{module} needs {}", within.join(", ")));
            }
        }
    }
    lines
}

/// Packages in which some files still need each other in a circle: what is left there, and who takes a package off this list is done with it.
const NOT_YET: [&str; 1] = ["tests"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// The folders of all packages: the workspace's members, and the board's model, which is a program of its own.
fn members() -> Vec<String> {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let listed = manifest.split_once("members = [").and_then(|(_, rest)| rest.split_once(']')).expect("the workspace lists its members").0;
    let mut folders = vec!["virtual-board".to_owned()];
    for pattern in listed.split(',').map(|member| member.trim().trim_matches('"')) {
        match pattern.strip_suffix("/*") {
            Some(folder) => {
                let entries = std::fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().file_name());
                folders.extend(entries.map(|name| format!("{folder}/{}", name.to_string_lossy())));
            }
            None => folders.push(pattern.to_owned()),
        }
    }
    folders.retain(|folder| root().join(folder).join("Cargo.toml").exists());
    folders.sort();
    folders
}

#[test]
fn no_file_of_any_package_needs_one_that_needs_it() {
    let members = members();
    assert!(members.len() > 15, "{members:?}");
    let mut lines = Vec::new();
    for package in members.iter().map(String::as_str) {
        let found = circles_of(package);
        if NOT_YET.contains(&package) {
            assert!(!found.is_empty(), "{package} has no circle any more: take it off the list");
        } else {
            lines.extend(found.into_iter().map(|line| format!("{package}: {line}")));
        }
    }
    assert!(lines.is_empty(), "{}", lines.join("\n"));
}

/// Packages from the top to the bottom, as the table of the book's page on the architecture has them.
fn layers() -> Vec<String> {
    let page = std::fs::read_to_string(root().join("docs/development/architecture.md")).unwrap();
    let table = page.split_once("| folder |").and_then(|(_, rest)| rest.split_once("\n\n")).expect("the table of folders").0;
    let first_cells = table.lines().filter_map(|row| row.strip_prefix("| `")?.split_once(" | ").map(|(cell, _)| format!("`{cell}")));
    first_cells
        .flat_map(|cell| cell.split('`').skip(1).step_by(2).map(|name| name.trim_end_matches('/').to_owned()).collect::<Vec<_>>())
        .collect()
}

/// The folders of the packages of ours that a manifest names, those for its tests too.
fn dependencies(manifest: &str, members: &[String]) -> Vec<String> {
    let mut found = Vec::new();
    let mut in_dependencies = false;
    for line in manifest.lines() {
        if line.starts_with('[') {
            in_dependencies = line.trim_end_matches(']').ends_with("dependencies");
        } else if in_dependencies && line.starts_with(|first: char| first.is_ascii_alphabetic()) {
            let name = line.split(['.', ' ', '=']).next().unwrap();
            found.extend(members.iter().filter(|folder| folder.rsplit('/').next() == Some(name)).cloned());
        }
    }
    found
}

#[test]
fn arrows_between_packages_go_downwards_only() {
    let (layers, members) = (layers(), members());
    let missing: Vec<_> = members.iter().filter(|folder| !layers.contains(folder)).collect();
    assert!(missing.is_empty(), "not in the table of docs/development/architecture.md: {missing:?}");
    let place = |folder: &str| layers.iter().position(|layer| layer == folder).unwrap();
    let (mut arrows, mut upwards) = (0, Vec::new());
    for folder in &members {
        let manifest = std::fs::read_to_string(root().join(folder).join("Cargo.toml")).unwrap();
        for below in dependencies(&manifest, &members) {
            arrows += 1;
            if place(&below) <= place(folder) {
                upwards.push(format!("{folder} -> {below}"));
            }
        }
    }
    assert!(arrows > 40, "only {arrows} arrows found: is the pattern still right?");
    assert!(upwards.is_empty(), "upwards in the table of docs/development/architecture.md: {upwards:?}");
}

#[test]
fn the_rule_reads_every_kind_of_dependency() {
    let members = ["crates/recording", "crates/output", "hysteresis", "firmware"].map(str::to_owned);
    let manifest = "[package]\nname = \"hysteresis\"\n[dependencies]\nrecording.workspace = true\n# output = 1\nserde = { features = [\"x\"] }\n\
                    [target.'cfg(unix)'.dependencies]\nfirmware = { workspace = true }\n[dev-dependencies]\noutput = { path = \"../output\" }\n[features]\nhysteresis = []\n";
    assert_eq!(dependencies(manifest, &members), ["crates/recording", "firmware", "crates/output"]);
}

/// Longest file, in lines.
const LONGEST: usize = 500;

fn lengths(folder: &Path, found: &mut BTreeMap<String, usize>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !name.starts_with('.') && !["target", "vendor"].contains(&name) {
                lengths(&path, found);
            }
        } else if [".rs", ".js"].iter().any(|ending| name.ends_with(ending)) {
            found.insert(path.display().to_string(), std::fs::read_to_string(&path).unwrap().lines().count());
        }
    }
}

#[test]
fn no_file_is_longer_than_may_be_read_at_once() {
    let root = root();
    let mut found = BTreeMap::new();
    lengths(root, &mut found);
    let found: BTreeMap<_, _> =
        found.iter().map(|(path, lines)| (path[root.display().to_string().len() + 1..].replace('\\', "/"), *lines)).collect();
    assert!(found.len() > 300, "only {} files found", found.len());
    let over: Vec<_> = found.iter().filter(|(_, lines)| **lines > LONGEST).collect();
    assert!(over.is_empty(), "{over:?}");
}

#[test]
fn the_rule_finds_a_circle() {
    let mut package = Package::default();
    let mut file = |module: &str, text: &str| {
        package.files.insert(module.to_owned(), tokens(text));
    };
    file("", "pub mod limiter; pub mod tick;");
    file("limiter", "use crate::tick::{self, PERIOD};\n// use crate::nothing::X;");
    file("tick", "mod config; pub use config::{Config, PERIOD};");
    file("tick::config", "pub const PERIOD: u32 = 1; pub struct Config(super::super::number::Word);");
    file("number", "fn text() -> &'static str { \"crate::tick::Config\" }\n#[cfg(test)]\nmod tests {\n    use crate::tick::Config;\n}");
    let needed = |package: &Package, module: &str| package.needs()[module].iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    assert_eq!(needed(&package, "limiter"), ["tick", "tick::config"]);
    assert_eq!(needed(&package, "tick::config"), ["number"]);
    assert_eq!(circles(&package.needs()), Vec::<Vec<&str>>::new());
    package.files.insert("number".to_owned(), tokens("fn limit() { crate::limiter::limit() }"));
    assert_eq!(circles(&package.needs()), [["limiter", "number", "tick", "tick::config"]]);
}
