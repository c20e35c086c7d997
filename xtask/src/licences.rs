//! Licences and sources of all dependencies against `deny.toml`, with nothing to install: what `cargo deny check licenses sources` also asks.
//! Duplicates and advisories need `cargo xtask deny`.

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::process::{answer, cargo, root};

/// The one registry.
const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";

/// Checks every package that the lock file names, for every platform.
pub fn check() -> Result<()> {
    let rules = std::fs::read_to_string(root().join("deny.toml")).context("deny.toml cannot be read")?;
    let allowed = allowed(&rules).context("deny.toml has no line `allow = [...]`")?;
    let said = answer(cargo().args(["metadata", "--format-version", "1", "--locked"])).context("cargo metadata failed")?;
    let metadata: Value = serde_json::from_str(&said)?;
    let packages: Vec<&Value> =
        metadata["packages"].as_array().into_iter().flatten().filter(|package| !package["source"].is_null()).collect();
    ensure!(packages.len() > 100, "only {} dependencies found", packages.len());
    let mut problems = Vec::new();
    for package in &packages {
        let text = |key: &str| package[key].as_str().unwrap_or_default();
        let of = format!("{} {}", text("name"), text("version"));
        let excepted = exceptions(&rules).any(|(name, licences)| name == text("name") && is_allowed(text("license"), &licences));
        if !excepted && !is_allowed(text("license"), &allowed) {
            problems.push(format!("{of}: its licence `{}` is not among those of deny.toml", text("license")));
        }
        if text("source") != REGISTRY {
            problems.push(format!("{of}: comes from {}", text("source")));
        }
    }
    ensure!(problems.is_empty(), "{}", problems.join("\n"));
    println!("licences and sources of {} dependencies are those that deny.toml allows", packages.len());
    Ok(())
}

/// The list of `allow = [...]`.
fn allowed(rules: &str) -> Option<Vec<&str>> {
    rules.lines().find_map(|line| line.strip_prefix("allow = [")?.strip_suffix(']')).map(names)
}

/// Packages with a list of their own, each on a line `{ allow = [...], crate = "NAME" },`.
fn exceptions(rules: &str) -> impl Iterator<Item = (&str, Vec<&str>)> {
    rules.lines().filter_map(|line| {
        let (list, rest) = line.trim().strip_prefix("{ allow = [")?.split_once(']')?;
        Some((rest.strip_prefix(", crate = \"")?.split_once('"')?.0, names(list)))
    })
}

fn names(list: &str) -> Vec<&str> {
    list.split(',').map(|one| one.trim().trim_matches('"')).collect()
}

/// Whether a licence expression (SPDX; `/` is an old OR) can be met with allowed ones.
fn is_allowed(expression: &str, allowed: &[&str]) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ").replace(" WITH ", "\u{a0}WITH\u{a0}");
    let mut words = spaced.split([' ', '\t']).filter(|word| !word.is_empty()).peekable();
    let holds = alternatives(&mut words, allowed);
    holds && words.next().is_none()
}

type Words<I> = std::iter::Peekable<I>;

fn alternatives<'a, I: Iterator<Item = &'a str>>(words: &mut Words<I>, allowed: &[&str]) -> bool {
    let mut holds = together(words, allowed);
    while words.next_if_eq(&"OR").is_some() {
        holds |= together(words, allowed);
    }
    holds
}

fn together<'a, I: Iterator<Item = &'a str>>(words: &mut Words<I>, allowed: &[&str]) -> bool {
    let mut holds = one(words, allowed);
    while words.next_if_eq(&"AND").is_some() {
        holds &= one(words, allowed);
    }
    holds
}

fn one<'a, I: Iterator<Item = &'a str>>(words: &mut Words<I>, allowed: &[&str]) -> bool {
    if words.next_if_eq(&"(").is_some() {
        let holds = alternatives(words, allowed);
        return words.next_if_eq(&")").is_some() && holds;
    }
    words.next().is_some_and(|licence| allowed.contains(&licence.replace('\u{a0}', " ").as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_met_by_what_is_allowed() {
        let rules = "x = 1\nallow = [\"MIT\", \"Apache-2.0 WITH LLVM-exception\", \"Unicode-3.0\"]\n";
        let allowed = allowed(rules).expect("a list");
        for good in
            ["MIT", "GPL-3.0 OR MIT", "GPL-3.0/MIT", "(GPL-3.0 OR MIT) AND Unicode-3.0", "Apache-2.0 WITH LLVM-exception OR GPL-2.0"]
        {
            assert!(is_allowed(good, &allowed), "{good}");
        }
        let exception = "    { allow = [\"MPL-2.0\"], crate = \"webdriver\" },\n";
        assert_eq!(exceptions(exception).collect::<Vec<_>>(), [("webdriver", vec!["MPL-2.0"])]);
        for bad in ["", "GPL-3.0", "MIT AND GPL-3.0", "Apache-2.0", "(MIT", "MIT GPL-3.0"] {
            assert!(!is_allowed(bad, &allowed), "{bad}");
        }
    }
}
