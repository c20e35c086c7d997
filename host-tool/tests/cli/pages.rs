//! The tutorials are scripts, like the bring-up page: every command of them is run here and says what the page says.
//!
//! The blocks are those of `first-light.md` (see the module `bring_up`). `<!-- picture: NAME, figure N of FILE -->` takes the Nth drawing of a
//! report that the page's commands wrote. With `CATHETER_WRITE_BOOK=1` it is written to `docs/images`; without, the committed picture must have
//! that drawing's title. The reference pages that the program writes (`<!-- generated: catheter ... -->`) are compared here and written alike.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn writes() -> bool {
    std::env::var("CATHETER_WRITE_BOOK").is_ok_and(|value| value == "1")
}

/// Runs the command with a folder to work in; what it said on both streams, and whether it ended well.
fn run(words: &[&str], folder: &Path) -> (String, bool) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catheter"));
    // Help is wrapped by the width of the terminal: there is none.
    command.args(words).current_dir(folder).stdin(Stdio::null()).env_remove("COLUMNS");
    for name in ["CATHETER_BACKEND", "CATHETER_FLASH", "CATHETER_INJECT", "CATHETER_PORTS"] {
        command.env_remove(name);
    }
    let output = command.output().expect("the built command starts");
    (String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr), output.status.success())
}

/// Plays a page in a folder; each command may take its time, since tests have a limit of their own.
fn play(name: &str, folder: &Path) {
    let page = std::fs::read_to_string(root().join("docs/tutorials").join(name)).expect("a tutorial");
    let mut played = 0;
    for step in crate::bring_up::steps(&page) {
        let place = format!("docs/tutorials/{name}, line {}: `{}`", step.line, step.command);
        let words: Vec<&str> = step.command.split_whitespace().collect();
        match words[..] {
            ["cp", from, to] => {
                std::fs::copy(root().join(from), folder.join(to)).unwrap_or_else(|error| panic!("{place}: {error}"));
            }
            ["catheter", ..] => {
                let (said, ended_well) = run(&words[1..], folder);
                assert!(ended_well, "{place} failed:\n{said}");
                crate::bring_up::says(&place, &step.read, &said);
                played += 1;
            }
            _ => panic!("{place}: who plays this?"),
        }
    }
    assert!(played >= 4, "only {played} commands found in {name}: is the pattern still right?");
    pictures(name, &page, folder);
}

/// The drawings that pages take from what a tutorial wrote: its own, and those of other pages that name it (`... of NAME`).
fn pictures(name: &str, page: &str, folder: &Path) {
    let mut texts = vec![page.to_owned()];
    for entry in std::fs::read_dir(root().join("docs/concepts")).expect("the concepts") {
        texts.push(std::fs::read_to_string(entry.expect("an entry of a folder").path()).expect("a page"));
    }
    for line in texts.iter().flat_map(|text| text.lines()) {
        let Some(wanted) = line.strip_prefix("<!-- picture: ").and_then(|rest| rest.strip_suffix(" -->")) else { continue };
        let (picture, from) = wanted.split_once(", figure ").expect("NAME, figure N of FILE");
        let (number, file) = from.split_once(" of ").expect("figure N of FILE");
        let (file, tutorial) = file.split_once(" of ").unwrap_or((file, if page.contains(line) { name } else { "" }));
        if tutorial != name {
            continue;
        }
        let report = std::fs::read_to_string(folder.join(file)).unwrap_or_else(|error| panic!("{wanted}: {error}"));
        let drawing = report.split("<svg ").nth(number.parse().expect("a number")).unwrap_or_else(|| panic!("{wanted}: no such figure"));
        let drawing = drawing.split("</svg>").next().expect("a drawing ends");
        let place = root().join("docs/images").join(picture);
        if writes() {
            std::fs::write(
                &place,
                format!(
                    "<svg {}</svg>\n",
                    drawing.replacen(
                        '>',
                        &format!("><style>{}</style><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>", style(&report)),
                        1
                    )
                ),
            )
            .expect("docs/images can be written");
        }
        let committed =
            std::fs::read_to_string(&place).unwrap_or_else(|error| panic!("{picture}: {error}; CATHETER_WRITE_BOOK=1 makes it"));
        let title = |text: &str| text.split("</title>").next().and_then(|start| start.rsplit('>').next()).map(str::to_owned);
        assert_eq!(title(&committed), title(drawing), "{picture} is another drawing; CATHETER_WRITE_BOOK=1 makes it anew");
    }
}

/// The style of a report's drawings with its light colours, as a picture by itself needs it.
fn style(report: &str) -> String {
    let sheet = report.split("<style>").nth(1).and_then(|rest| rest.split("</style>").next()).expect("a report has a style");
    let root = sheet.split(":root{").nth(1).and_then(|rest| rest.split('}').next()).expect("colours");
    let mut rules = String::new();
    for rule in sheet.split('}').filter(|rule| rule.trim_start().starts_with("svg")) {
        write!(rules, "{}}}", rule.trim_start()).expect("writing to a string");
    }
    for (name, colour) in root.split(';').filter_map(|pair| pair.trim().split_once(':')) {
        rules = rules.replace(&format!("var({name})"), colour);
    }
    rules.replace("svg ", "").replace('<', "&lt;") + "text{font-family:system-ui,sans-serif}"
}

#[test]
fn the_tutorial_from_a_csv_file_to_a_model_says_what_it_shows() {
    play("csv-to-model.md", tempfile::tempdir().expect("a folder").path());
}

#[test]
fn the_tutorial_from_a_rig_to_a_controller_says_what_it_shows() {
    play("rig-to-controller.md", tempfile::tempdir().expect("a folder").path());
}

#[test]
fn the_tutorial_of_a_hidden_effect_says_what_it_shows() {
    play("hidden-effect.md", tempfile::tempdir().expect("a folder").path());
}

/// The help of a command and of its subcommands, as sections.
fn reference(words: &[&str], folder: &Path, into: &mut String) {
    let (help, _) = run(&[words, &["--help"]].concat(), folder);
    let hashes = "#".repeat(words.len() + 1);
    write!(
        into,
        "{hashes} `{}`\n\n```text\n{}\n```\n\n",
        ["catheter"].iter().chain(words).copied().collect::<Vec<_>>().join(" "),
        help.trim_end()
    )
    .expect("writing to a string");
    let commands = help.split("Commands:\n").nth(1).and_then(|rest| rest.split("\n\n").next()).unwrap_or_default();
    for name in
        commands.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next())
    {
        if name != "help" {
            reference(&[words, &[name]].concat(), folder, into);
        }
    }
}

#[test]
fn the_reference_pages_are_what_the_program_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut commands = String::new();
    reference(&[], folder.path(), &mut commands);
    let block = |words: &[&str]| format!("```text\n{}\n```\n", run(words, folder.path()).0.trim_end());
    let pages = [
        (
            "commands.md",
            "# Commands\n\n<!-- generated: catheter COMMAND --help -->\n\n".to_owned()
                + commands.replacen("# `catheter`", "## `catheter`", 1).trim_end()
                + "\n",
        ),
        (
            "settings.md",
            "# Settings\n\n<!-- generated: catheter rig settings get -->\n\nValues are the defaults.\n\n".to_owned()
                + &block(&["rig", "settings", "get"]),
        ),
        (
            "faults.md",
            "# Faults, blockers, notices\n\n<!-- generated: catheter explain -->\n\n`catheter explain E017` adds what to do.\n\n"
                .to_owned()
                + &block(&["explain"]),
        ),
    ];
    for (name, wanted) in pages {
        let place = root().join("docs/reference").join(name);
        if writes() {
            std::fs::write(&place, &wanted).expect("docs/reference can be written");
        }
        let page = std::fs::read_to_string(&place).unwrap_or_default();
        assert!(
            page == wanted,
            "docs/reference/{name} is not what the program says: CATHETER_WRITE_BOOK=1 cargo test -p host-tool --test cli pages"
        );
    }
}
