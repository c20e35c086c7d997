//! The book: mdBook builds it, with equations as MathML, so that a page needs neither a network nor a script.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use pulldown_latex::config::{DisplayMode, RenderConfig};
use pulldown_latex::{Parser, Storage, push_mathml};
use serde_json::Value;

use crate::process::{cargo, command, exists, root, run, target_folder};

const VERSION: &str = "0.5.4";

/// Builds the book into `target/book`, and shows it.
pub fn build(open: bool) -> Result<()> {
    let program = mdbook()?;
    run("book", command(program).arg("build").args(open.then_some("--open")))?;
    let (mut dead, mut seen) = (Vec::new(), 0);
    links(&root().join("target/book"), &mut dead, &mut seen)?;
    ensure!(dead.is_empty(), "links of the built book that lead nowhere:\n{}", dead.join("\n"));
    ensure!(seen > 500, "only {seen} links found in the built book: is the pattern still right?");
    Ok(())
}

/// What the built pages point to and is not there.
fn links(folder: &Path, dead: &mut Vec<String>, seen: &mut usize) -> Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| format!("no {}", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() {
            links(&path, dead, seen)?;
            continue;
        }
        // The page of errors has addresses of its own, the printed one those of all pages.
        let is_page =
            path.extension().is_some_and(|ending| ending == "html") && !path.ends_with("404.html") && !path.ends_with("print.html");
        let page = if is_page { std::fs::read_to_string(&path)? } else { String::new() };
        for target in page.split("href=\"").skip(1).chain(page.split("src=\"").skip(1)).filter_map(|rest| rest.split('"').next()) {
            let file = target.split('#').next().unwrap_or_default();
            if !file.is_empty() && !file.contains(':') {
                *seen += 1;
                if !folder.join(file).exists() {
                    dead.push(format!("{}: {target}", path.display()));
                }
            }
        }
    }
    Ok(())
}

/// The program; installed from the registry where it is missing, which takes some minutes once.
fn mdbook() -> Result<PathBuf> {
    let tools = target_folder().join("tools");
    let program = tools.join("bin").join(format!("mdbook{}", std::env::consts::EXE_SUFFIX));
    if !program.exists() {
        let mut install = cargo();
        // A book of some fifty pages is built in a second either way; an optimised program takes twice as long to install.
        install.args(["install", "mdbook", "--debug", "--version", VERSION, "--locked", "--no-default-features", "--root"]).arg(&tools);
        run("mdBook", install.arg("--target-dir").arg(target_folder().join("tools-build")))?;
        let _ = std::fs::remove_dir_all(target_folder().join("tools-build"));
    }
    Ok(program)
}

/// What `deny.toml` says of dependencies. Advisories need a network beyond the registry, so they are asked for by `--advisories`.
pub fn deny(advisories: bool) -> Result<()> {
    if !exists("cargo-deny") {
        anyhow::bail!("cargo-deny is missing (some minutes, once): cargo install cargo-deny --locked");
    }
    let mut check = cargo();
    check.args(["deny", "check", "licenses", "bans", "sources"]);
    run("dependencies", check.args(advisories.then_some("advisories")))
}

/// mdBook's preprocessor: a book as JSON on standard input, the same with MathML on standard output.
pub fn equations() -> Result<()> {
    let input: Value = serde_json::from_reader(std::io::stdin()).context("mdBook writes JSON on standard input")?;
    let mut book = input.get(1).context("a pair of context and book")?.clone();
    chapters(&mut book)?;
    println!("{book}");
    Ok(())
}

fn chapters(value: &mut Value) -> Result<()> {
    match value {
        Value::Array(items) => items.iter_mut().try_for_each(chapters),
        Value::Object(fields) => {
            if let Some(Value::String(content)) = fields.get_mut("content") {
                *content = with_mathml(content)?;
            }
            fields.values_mut().try_for_each(chapters)
        }
        _ => Ok(()),
    }
}

/// `$...$` and lines between `$$` as MathML; code stays.
fn with_mathml(page: &str) -> Result<String> {
    let (mut out, mut fenced, mut display) = (String::new(), false, None::<String>);
    for line in page.lines() {
        fenced ^= line.trim_start().starts_with("```");
        match &mut display {
            Some(equation) if line.trim() == "$$" => {
                out += &format!("\n<div class=\"equation\">{}</div>\n\n", mathml(equation, DisplayMode::Block)?);
                display = None;
            }
            Some(equation) => *equation += &format!("{line}\n"),
            None if !fenced && line.trim() == "$$" => display = Some(String::new()),
            None if fenced => out += &format!("{line}\n"),
            None => out += &format!("{}\n", inline(line)?),
        }
    }
    ensure!(display.is_none(), "an equation without its end: {page}");
    Ok(out)
}

fn inline(line: &str) -> Result<String> {
    let mut out = String::new();
    for (index, part) in line.split('`').enumerate() {
        if index > 0 {
            out.push('`');
        }
        let pieces: Vec<&str> = part.split('$').collect();
        if index % 2 == 1 || pieces.len().is_multiple_of(2) {
            out += part;
            continue;
        }
        for (number, piece) in pieces.iter().enumerate() {
            out += &if number % 2 == 1 { mathml(piece, DisplayMode::Inline)? } else { (*piece).to_owned() };
        }
    }
    Ok(out)
}

fn mathml(equation: &str, display_mode: DisplayMode) -> Result<String> {
    let (storage, mut out) = (Storage::new(), String::new());
    let config = RenderConfig { display_mode, ..RenderConfig::default() };
    push_mathml(&mut out, Parser::new(equation, &storage), config).with_context(|| format!("the equation {equation}"))?;
    ensure!(!out.contains("<merror"), "the equation {equation} is not understood: {out}");
    // One line, and nothing that Markdown reads. The converter leaves out a space before this attribute.
    Ok(out
        .replace("\"minsize", "\" minsize")
        .replace("&amp;nbsp;", "\u{a0}")
        .replace("&nbsp;", "\u{a0}")
        .replace('\n', " ")
        .replace('*', "\u{2217}"))
}

#[cfg(test)]
mod tests {
    use super::with_mathml;

    #[test]
    fn equations_become_mathml_and_code_stays() {
        let page = with_mathml("Let $r_i$ be `$5`.\n\n$$\ns = \\sum_i w_i\n$$\n\n```text\n$x$\n```\n").expect("a sound page");
        assert_eq!(page.matches("<math").count(), 2, "{page}");
        assert!(page.contains("`$5`") && page.contains("\n$x$\n"), "{page}");
        assert!(with_mathml("$\\nosuchcommand$").is_err());
    }
}
