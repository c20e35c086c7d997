//! The bring-up page is a script: every command on it is run here on the rig in this process, and says what the page says.
//!
//! A block is ` ```text ` with lines that begin with `$ ` and, below each, what is to be read. A line to be read is found in what the command
//! said, in this order, word by word: `0.20 ± 0.02` is a number within a tolerance, `...` any words. Before a block, `<!-- situation: NAME,... -->`
//! tells what the rig suffers meanwhile (`--inject`), `<!-- ends: CODE -->` the exit code where it is not 0. Settings and models stay from
//! command to command as on a board; states do not, so a block on arming and running is one command.

use crate::support::Bench;

/// A command of the page.
#[derive(Debug)]
pub struct Step {
    pub line: usize,
    pub command: String,
    situation: String,
    ends: i32,
    pub read: Vec<String>,
}

const PAGE: &str = include_str!("../../../docs/tutorials/first-light.md");

/// What stands behind the name of a comment.
fn comment<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    line.trim().strip_prefix("<!-- ")?.strip_suffix(" -->")?.strip_prefix(name)?.strip_prefix(": ")
}

pub fn steps(page: &str) -> Vec<Step> {
    let (mut steps, mut inside, mut situation, mut ends): (Vec<Step>, bool, String, i32) = (Vec::new(), false, String::new(), 0);
    for (index, line) in page.lines().enumerate() {
        if let Some(found) = comment(line, "situation") {
            situation = found.to_owned();
        } else if let Some(found) = comment(line, "ends") {
            ends = found.parse().expect("an exit code");
        } else if line.starts_with("```") {
            if inside {
                (situation, ends) = (String::new(), 0);
            }
            inside = !inside;
        } else if inside && let Some(command) = line.strip_prefix("$ ") {
            steps.push(Step { line: index + 1, command: command.to_owned(), situation: situation.clone(), ends, read: Vec::new() });
        } else if inside && !line.trim().is_empty() {
            steps.last_mut().unwrap_or_else(|| panic!("line {}: a reading before the first command", index + 1)).read.push(line.to_owned());
        }
    }
    steps
}

/// A word without what surrounds it.
fn bare(word: &str) -> &str {
    word.trim_matches(|letter| "(),;:`".contains(letter))
}

/// Whether the words of a line are those of a pattern.
fn matches(pattern: &[&str], words: &[&str]) -> bool {
    match pattern {
        [] => words.is_empty(),
        ["...", rest @ ..] => (0..=words.len()).any(|skipped| matches(rest, &words[skipped..])),
        [value, "±", tolerance, rest @ ..] => {
            let number = |word: &str| bare(word).parse::<f64>().unwrap_or_else(|_| panic!("{word} is no number"));
            let is_near = |word: &str| bare(word).parse::<f64>().is_ok_and(|found| (found - number(value)).abs() <= number(tolerance));
            words.first().is_some_and(|word| is_near(word)) && matches(rest, &words[1..])
        }
        [word, rest @ ..] => words.first().is_some_and(|found| bare(found) == bare(word)) && matches(rest, &words[1..]),
    }
}

/// Every reading is in what a command said, in this order.
pub fn says(place: &str, readings: &[String], output: &str) {
    let mut said = output.lines();
    for wanted in readings {
        let pattern: Vec<&str> = wanted.split_whitespace().collect();
        let found = said.any(|line| matches(&pattern, &line.split_whitespace().collect::<Vec<_>>()));
        assert!(found, "{place}: `{wanted}` is not in what it said, or not in this order:\n{output}");
    }
}

#[test]
fn readings_are_compared_word_by_word_and_numbers_within_their_tolerance() {
    let is =
        |pattern: &str, line: &str| matches(&pattern.split_whitespace().collect::<Vec<_>>(), &line.split_whitespace().collect::<Vec<_>>());
    assert!(is("pressure 0.20 ± 0.02 bar ...", "pressure   0.215 bar measured (code 1689)"));
    assert!(!is("pressure 0.20 ± 0.02 bar ...", "pressure   0.225 bar measured"));
    assert!(!is("pressure 0.20 ± 0.02 bar", "pressure 0.2 bar measured"));
    assert!(is("... code 1489 ± 10 ...", "laser 0.000 mm (code 1492)"));
    assert!(!is("state idle", "state fault"));
}

#[test]
fn every_command_of_the_page_says_what_the_page_says() {
    let bench = Bench::new();
    let mut played = 0;
    for step in steps(PAGE) {
        let Some(line) = step.command.strip_prefix("catheter ") else {
            let known = ["export CATHETER_BACKEND=serial", "cargo xtask flash"];
            assert!(known.contains(&step.command.as_str()), "line {}: who plays `{}`?", step.line, step.command);
            continue;
        };
        let output = assert_cmd::Command::new(env!("CARGO_BIN_EXE_catheter"))
            .args(line.split_whitespace())
            .env("CATHETER_BACKEND", "virtual")
            .env("CATHETER_FLASH", "rig.flash")
            .env("CATHETER_INJECT", &step.situation)
            .current_dir(bench.path(""))
            .timeout(std::time::Duration::from_secs(120))
            .output()
            .expect("the built command starts");
        let stdout = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        let place = format!("docs/tutorials/first-light.md, line {}: `{}`", step.line, step.command);
        assert_eq!(output.status.code(), Some(step.ends), "{place} said\n{stdout}");
        says(&place, &step.read, &stdout);
        played += 1;
    }
    assert!(played >= 20, "only {played} commands found: is the pattern still right?");
}
