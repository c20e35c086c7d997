//! Names and comments in the field's words: the list of words that only this project used is `tests/words.txt`.
//!
//! A word counts where it is a part of an identifier (`seat_mm`, `SeatState`) or a word of a comment. Strings are left out: they hold the wire's and
//! JSON's names and what is said to people, which the book's own test reads through the generated pages. What a package still has stands in the
//! list as a number of different identifiers and of comment lines, and may only fall.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What a package has of a word: identifiers, and lines of comments.
#[derive(Default, Debug, PartialEq)]
struct Found {
    identifiers: BTreeSet<String>,
    comments: Vec<String>,
}

/// Code and comment of a line; strings are left out of the code.
fn parts(line: &str) -> (String, &str) {
    let (code, comment) = line.split_once("//").unwrap_or((line, ""));
    (code.split('"').step_by(2).collect::<Vec<_>>().join(" "), comment)
}

/// The words of an identifier in lower case: `LuGreTip`, `tip_mm`.
fn words_of(identifier: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = '_';
    for letter in identifier.chars() {
        if letter == '_' || (letter.is_uppercase() && !before.is_uppercase()) {
            words.push(String::new());
        }
        if letter != '_' {
            words.last_mut().expect("one at least").extend(letter.to_lowercase());
        }
        before = letter;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Adds what a source has of the words, but for the identifiers that are allowed.
fn search(text: &str, words: &BTreeSet<String>, rules: &Rules, found: &mut BTreeMap<String, Found>) {
    for line in text.lines() {
        let (code, comment) = parts(line);
        for identifier in
            code.split(|letter: char| !letter.is_alphanumeric() && letter != '_').filter(|name| !rules.allowed.contains(*name))
        {
            for word in words_of(identifier).into_iter().filter(|word| words.contains(word)) {
                found.entry(word).or_default().identifiers.insert(identifier.to_owned());
            }
        }
        // A name in code marks is that of an identifier.
        let mut prose: String = comment.split('`').step_by(2).collect::<Vec<_>>().join(" ").to_lowercase();
        rules.phrases.iter().for_each(|phrase| prose = prose.replace(phrase.as_str(), ""));
        let said: BTreeSet<&str> = prose.split(|letter: char| !letter.is_alphanumeric()).collect();
        for word in words.iter().filter(|word| said.contains(word.as_str())) {
            found.entry(word.clone()).or_default().comments.push(line.trim().to_owned());
        }
    }
}

fn sources(folder: &Path, texts: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !name.starts_with('.') && !["target", "vendor"].contains(&name) {
                sources(&path, texts);
            }
        } else if name.ends_with(".rs") && name != "words.rs" {
            texts.push(std::fs::read_to_string(&path).unwrap());
        }
    }
}

/// The folders of all packages.
fn packages(root: &Path) -> Vec<String> {
    let below = |folder: &str| {
        let entries = std::fs::read_dir(root.join(folder)).unwrap().map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
        let prefix = if folder.is_empty() { String::new() } else { format!("{folder}/") };
        entries.map(move |name| format!("{prefix}{name}")).collect::<Vec<_>>()
    };
    let mut folders = [below(""), below("crates")].concat();
    folders.retain(|folder| root.join(folder).join("Cargo.toml").exists());
    folders.sort();
    folders
}

struct Rules {
    /// Word, and the field's term.
    words: BTreeMap<String, String>,
    /// Identifiers with an ordinary use.
    allowed: BTreeSet<String>,
    /// Ordinary uses in comments.
    phrases: Vec<String>,
    /// Identifiers and lines of comments by package and word.
    left: BTreeMap<(String, String), (usize, usize)>,
}

fn rules(text: &str) -> Rules {
    let mut rules = Rules { words: BTreeMap::new(), allowed: BTreeSet::new(), phrases: Vec::new(), left: BTreeMap::new() };
    for line in text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#')) {
        let (kind, rest) = line.split_once(' ').expect("a kind and what follows");
        let (first, second) = rest.split_once(" | ").unwrap_or((rest, ""));
        match kind {
            "word" => drop(rules.words.insert(first.to_owned(), second.to_owned())),
            "allowed" => drop(rules.allowed.insert(first.to_owned())),
            "phrase" => rules.phrases.push(first.to_owned()),
            "left" => {
                let fields: Vec<&str> = rest.split_whitespace().collect();
                let [package, word, identifiers, comments] = fields[..] else { panic!("tests/words.txt: {line}") };
                let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("tests/words.txt: {line}"));
                rules.left.insert((package.to_owned(), word.to_owned()), (number(identifiers), number(comments)));
            }
            other => panic!("tests/words.txt: `{other}` is no kind of line"),
        }
    }
    rules
}

#[test]
fn names_and_comments_use_the_fields_words() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let rules = rules(&std::fs::read_to_string(root.join("tests/words.txt")).unwrap());
    let words: BTreeSet<String> = rules.words.keys().cloned().collect();
    let (mut problems, mut files) = (Vec::new(), 0);
    for package in packages(root) {
        let mut texts = Vec::new();
        sources(&root.join(&package), &mut texts);
        files += texts.len();
        let mut found = BTreeMap::new();
        texts.iter().for_each(|text| search(text, &words, &rules, &mut found));
        for (word, found) in found {
            let (identifiers, comments) = rules.left.get(&(package.clone(), word.clone())).copied().unwrap_or_default();
            if found.identifiers.len() > identifiers || found.comments.len() > comments {
                problems.push(format!(
                    "left {package} {word} {} {}    (listed {identifiers} {comments}; say: {}): {:?} {:?}",
                    found.identifiers.len(),
                    found.comments.len(),
                    rules.words[&word],
                    found.identifiers,
                    found.comments.first()
                ));
            }
        }
    }
    assert!(files > 300, "only {files} files found");
    assert!(problems.is_empty(), "{} problems:\n{}", problems.len(), problems.join("\n"));
}

#[test]
fn the_check_finds_what_it_looks_for() {
    let words: BTreeSet<String> = ["seat", "seal"].map(str::to_owned).into();
    let allowed = rules("allowed Sealed | x\nallowed seal_fast | y\nphrase in the seat of power | z\n");
    let mut found = BTreeMap::new();
    search(
        "let seat_mm = TipSeat::new(\"seal\"); // where the seat is\n// In the seat of power.\n// A `seal` in marks, and seated people.\nfn seal_fast() {}\nreseat();",
        &words,
        &allowed,
        &mut found,
    );
    assert_eq!(found.len(), 1);
    assert_eq!(found["seat"].identifiers, ["TipSeat".to_owned(), "seat_mm".to_owned()].into());
    assert_eq!(found["seat"].comments.len(), 1);
    assert_eq!(words_of("LuGreTip_mm"), ["lu", "gre", "tip", "mm"]);
    assert_eq!(rules("word seat | stick position\nleft crates/x seat 1 2\n").left[&("crates/x".to_owned(), "seat".to_owned())], (1, 2));
}
