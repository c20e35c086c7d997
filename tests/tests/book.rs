//! The README and the book: they point only to what exists, are short, and use the field's words.
//!
//! The limits and the list of words are `tests/book.txt`. What counts as running prose stands at [`prose`].

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The Markdown files below a folder, their paths relative to it.
fn markdown(folder: &Path) -> Vec<String> {
    fn visit(folder: &Path, prefix: &str, into: &mut Vec<String>) {
        for entry in std::fs::read_dir(folder).expect("a folder of the book") {
            let entry = entry.expect("an entry of a folder");
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                visit(&entry.path(), &format!("{name}/"), into);
            } else if name.ends_with(".md") {
                into.push(name);
            }
        }
    }
    let mut names = Vec::new();
    visit(folder, "", &mut names);
    names.sort();
    names
}

/// Every page of the book by its path in `docs/`.
fn book() -> BTreeMap<String, String> {
    let docs = root().join("docs");
    markdown(&docs).into_iter().map(|name| (name.clone(), read(&docs.join(name)))).collect()
}

/// The targets of Markdown links and images in `text`, code left out.
fn links(text: &str) -> Vec<String> {
    let text = without_code(text);
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')').map(|(target, _)| target.to_owned())).collect()
}

/// The text without fenced blocks; inline code stays as one word, `CODE`.
fn without_code(text: &str) -> String {
    let (mut kept, mut fenced) = (String::new(), false);
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            let parts = line.split('`').enumerate().map(|(index, part)| if index % 2 == 0 { part } else { "CODE" });
            kept.extend(parts);
        }
        kept.push('\n');
    }
    kept
}

/// The anchors that headings of a page make, as mdBook and code hosts make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut fenced = false;
    let mut found = BTreeSet::new();
    for line in text.lines() {
        fenced ^= line.trim_start().starts_with("```");
        if !fenced && line.starts_with('#') {
            let title = line.trim_start_matches('#').trim().to_lowercase();
            let kept = title.chars().filter(|letter| letter.is_alphanumeric() || " -_".contains(*letter));
            found.insert(kept.map(|letter| if letter == ' ' { '-' } else { letter }).collect());
        }
    }
    found
}

#[test]
fn every_link_leads_somewhere() {
    let mut seen = 0;
    let mut pages: BTreeMap<PathBuf, String> = book().into_iter().map(|(name, text)| (root().join("docs").join(name), text)).collect();
    for name in ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "NOTICE.md"] {
        pages.insert(root().join(name), read(&root().join(name)));
    }
    for (page, text) in &pages {
        for target in links(text).iter().filter(|target| !target.starts_with("https://")) {
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            let place = if file.is_empty() { page.clone() } else { page.parent().expect("a page lies in a folder").join(file) };
            assert!(place.exists(), "{}: the link to {target} leads nowhere", page.display());
            if !anchor.is_empty() {
                assert!(anchors(&read(&place)).contains(anchor), "{}: {file} has no heading #{anchor}", page.display());
            }
            let docs = root().join("docs").canonicalize().expect("the book");
            let leaves = page.starts_with(root().join("docs")) && !place.canonicalize().expect("it exists").starts_with(docs);
            assert!(!leaves, "{}: {target} is not in the built book; name the path as code", page.display());
            seen += 1;
        }
    }
    assert!(seen > 100, "only {seen} links found: is the pattern still right?");
}

#[test]
fn every_page_is_in_the_summary_and_every_picture_is_used() {
    let book = book();
    let listed: BTreeSet<String> = links(&book["SUMMARY.md"]).into_iter().collect();
    for name in book.keys().filter(|name| *name != "SUMMARY.md") {
        assert!(listed.contains(name), "{name} is not in docs/SUMMARY.md");
    }
    let used: BTreeSet<String> =
        book.values().flat_map(|text| links(text)).filter_map(|target| Some(target.rsplit_once("images/")?.1.into())).collect();
    for entry in std::fs::read_dir(root().join("docs/images")).expect("the pictures") {
        let name = entry.expect("an entry of a folder").file_name().to_string_lossy().into_owned();
        let made_for_review = ["dashboard-dark.png", "dashboard-settings.png"].contains(&name.as_str());
        assert!(used.contains(&name) || made_for_review, "docs/images/{name} is on no page");
    }
}

#[test]
fn every_folder_of_the_tree_in_the_readme_exists() {
    let readme = read(&root().join("README.md"));
    let tree = readme.split("## The tree").nth(1).and_then(|rest| rest.split("\n## ").next()).expect("the README shows the tree");
    let names: Vec<&str> = tree.lines().filter_map(|line| line.strip_prefix("| `")?.split_once('`').map(|(name, _)| name)).collect();
    assert!(names.len() >= 8, "{names:?}");
    for name in names {
        assert!(root().join(name).exists(), "{name} is in the README's tree and not in the project");
    }
}

/// The running prose of a page as paragraphs: no code blocks, tables, equations, comments, pictures; a link counts by its text, inline
/// code as one word. Pages that a program writes (`<!-- generated`) and the summary count nothing.
fn prose(text: &str) -> Vec<String> {
    let mut paragraphs = vec![String::new()];
    let mut equation = false;
    if text.contains("<!-- generated") {
        return Vec::new();
    }
    for line in without_code(text).lines() {
        let line = line.trim();
        if line == "$$" {
            equation = !equation;
        }
        let item = line.starts_with("* ") || line.split_once(". ").is_some_and(|(number, _)| number.parse::<u32>().is_ok());
        let left_out = equation
            || line == "$$"
            || line.starts_with('|')
            || line.starts_with("<!--")
            || line.starts_with("![")
            || line.starts_with("{{");
        if line.is_empty() || left_out || item || line.starts_with('#') {
            paragraphs.push(String::new());
        }
        if !left_out {
            let line = line.trim_start_matches(['#', '*', ' ']);
            let line = if item {
                line.split_once(". ").filter(|(number, _)| number.parse::<u32>().is_ok()).map_or(line, |(_, rest)| rest)
            } else {
                line
            };
            let last = paragraphs.last_mut().expect("one paragraph at least");
            last.push(' ');
            last.push_str(line);
        }
    }
    paragraphs.iter().map(|text| link_texts(text)).filter(|text| text.split_whitespace().next().is_some()).collect()
}

/// Links by their texts.
fn link_texts(text: &str) -> String {
    let mut parts = text.split("](");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        out.push_str("] ");
        out.push_str(part.split_once(')').map_or(part, |(_, rest)| rest));
    }
    out.replace(['[', ']'], "")
}

/// Words: what has a letter or a digit in it.
fn words(text: &str) -> usize {
    text.split_whitespace().filter(|word| word.chars().any(char::is_alphanumeric)).count()
}

/// Sentences end with a full stop, a colon at the end of a paragraph, a question or exclamation mark before a space; a semicolon ends none.
fn sentences(paragraph: &str) -> Vec<String> {
    let text = paragraph.replace("**", "").replace(". ", ".\n").replace("? ", "?\n").replace("! ", "!\n");
    text.lines().filter(|line| words(line) > 0).map(str::to_owned).collect()
}

struct Rules {
    words: usize,
    mean: f64,
    longest: usize,
    forbidden: Vec<(String, String)>,
}

fn rules() -> Rules {
    let text = read(&root().join("tests/book.txt"));
    let number = |name: &str| -> usize {
        let line = text.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_else(|| panic!("tests/book.txt lacks {name}"));
        line.trim().parse().expect("a number")
    };
    let forbidden = text.lines().filter_map(|line| line.strip_prefix("forbidden ")?.split_once(" | "));
    Rules {
        words: number("words "),
        mean: number("mean-sentence ") as f64,
        longest: number("longest-sentence "),
        forbidden: forbidden.map(|(term, instead)| (term.to_owned(), instead.to_owned())).collect(),
    }
}

/// Pages that count: all but the summary.
fn hand_written() -> Vec<(String, Vec<String>)> {
    book().into_iter().filter(|(name, _)| name != "SUMMARY.md").map(|(name, text)| (name, prose(&text))).collect()
}

#[test]
fn the_book_is_short_and_its_sentences_are() {
    let rules = rules();
    let (mut parts, mut all, mut in_sentences, mut count) = (BTreeMap::<String, usize>::new(), 0, 0, 0);
    let mut problems = Vec::new();
    for (name, paragraphs) in hand_written() {
        for sentence in paragraphs.iter().flat_map(|paragraph| sentences(paragraph)) {
            let length = words(&sentence);
            if length > rules.longest {
                problems.push(format!("docs/{name}: {length} words: {}", sentence.trim()));
            }
            *parts.entry(name.split('/').next().unwrap_or_default().to_owned()).or_default() += length;
            all += length;
            // Headings and labels are no sentences.
            if length > 3 {
                in_sentences += length;
                count += 1;
            }
        }
    }
    let mean = in_sentences as f64 / f64::from(count);
    println!("words of running prose: {all} in {count} sentences, {mean:.1} a sentence; by part: {parts:?}");
    assert!(problems.is_empty(), "longer than {} words:\n{}", rules.longest, problems.join("\n"));
    assert!(all <= rules.words, "{all} words, at most {} are wanted", rules.words);
    assert!(mean <= rules.mean, "{mean:.1} words a sentence in the mean, at most {} are wanted", rules.mean);
    assert!(count > 500, "only {count} sentences found: is the pattern still right?");
}

#[test]
fn the_book_uses_the_fields_words() {
    let rules = rules();
    let mut problems = Vec::new();
    for (name, paragraphs) in hand_written() {
        for paragraph in paragraphs {
            let kept: String = paragraph
                .to_lowercase()
                .chars()
                .map(|letter| if letter.is_alphanumeric() || letter == '-' { letter } else { ' ' })
                .collect();
            let line = format!(" {} ", kept.split_whitespace().collect::<Vec<_>>().join(" "));
            for (term, instead) in &rules.forbidden {
                let only_results = instead == "(Results only)" && (name.starts_with("results/") || name.starts_with("development/"));
                if !only_results && line.contains(&format!(" {term} ")) {
                    problems.push(format!("docs/{name}: `{term}` ({instead}): {}", paragraph.trim()));
                }
            }
        }
    }
    assert!(problems.is_empty(), "{} problems:\n{}", problems.len(), problems.join("\n"));
}

#[test]
fn the_checks_find_what_they_look_for() {
    let page = "# A title\n\nOne two [three](four.md). `five six` seven!\n\n| a | b |\n\n```text\ncode here\n```\n\n* item one\n* item two\n\n$$\nx\n$$\n";
    let found: Vec<String> = prose(page).iter().flat_map(|paragraph| sentences(paragraph)).collect();
    let lengths: Vec<usize> = found.iter().map(|sentence| words(sentence)).collect();
    assert_eq!(lengths, [2, 3, 2, 2, 2], "{found:?}");
    assert_eq!(links("[a](b.md) `[no](code.md)` ![c](d.png)"), ["b.md", "d.png"]);
    assert!(anchors("## Slip events, and `more`\n").contains("slip-events-and-more"));
}
