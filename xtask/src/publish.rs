//! What those need who take our packages or programs elsewhere: packages that a registry would accept, and a bill of materials.

use std::collections::{BTreeSet, HashMap};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::process::{answer, cargo, command, root, run, target_folder};
use crate::setup::{self, TARGET};

/// Packages that others may depend on.
const PUBLISHED: [&str; 2] = ["hysteresis", "model-export"];

/// The oldest compiler that they promise.
fn oldest() -> Result<String> {
    let text = std::fs::read_to_string(root().join("Cargo.toml")).context("the workspace's Cargo.toml cannot be read")?;
    let named = text.lines().find_map(|line| line.strip_prefix("rust-version = \"")?.strip_suffix('"'));
    named.map(str::to_owned).context("the workspace names no rust-version")
}

/// Builds the published packages with the oldest compiler, then as a registry would get them: packed, unpacked, built alone.
pub fn check() -> Result<()> {
    let packages = PUBLISHED.iter().flat_map(|package| ["-p", *package]);
    let version = oldest()?;
    let mut oldest = setup::cargo_of(&version);
    if answer(command("rustup").args(["run", &version, "rustc", "--version"])).is_none() {
        setup::toolchain(&version, &[])?;
    }
    // A folder of its own: another compiler's results would otherwise be thrown away in turns.
    oldest.args(["check", "--locked", "--all-features"]).args(packages.clone()).env("CARGO_TARGET_DIR", target_folder().join("oldest"));
    run("packages: the oldest compiler", &mut oldest)?;
    run("packages: as published", cargo().args(["package", "--locked", "--allow-dirty"]).args(packages))
}

/// Compares the public items of the published packages with those at a commit or tag, and says whether the version in Cargo.toml allows the
/// change: a removed or altered item needs a new minor version before 1.0, a major one after.
pub fn semver(against: &str) -> Result<()> {
    if answer(cargo().args(["semver-checks", "--version"])).is_none() {
        bail!("cargo-semver-checks is missing (some minutes, once): cargo install cargo-semver-checks --locked");
    }
    let packages = PUBLISHED.iter().flat_map(|package| ["-p", *package]);
    run("packages: public items", cargo().args(["semver-checks", "--baseline-rev", against]).args(packages))
}

/// Writes what the firmware and the `catheter` command are made of, as CycloneDX 1.5: `target/sbom/NAME.cdx.json`.
pub fn bill_of_materials() -> Result<()> {
    for (package, target) in [("firmware", Some(TARGET)), ("host-tool", None)] {
        let path = write(package, target)?;
        println!("{}", path.display());
    }
    Ok(())
}

fn write(package: &str, target: Option<&str>) -> Result<PathBuf> {
    let mut listing = cargo();
    listing.args(["metadata", "--format-version", "1", "--locked"]);
    if let Some(target) = target {
        listing.args(["--filter-platform", target]);
    }
    let metadata: Value = serde_json::from_str(&answer(&mut listing).context("cargo metadata failed")?)?;
    let packages = list(&metadata["packages"]).map(|package| Some((package["id"].as_str()?, package)));
    let packages: HashMap<&str, &Value> = packages.collect::<Option<_>>().context("a package without an id")?;
    let nodes = list(&metadata["resolve"]["nodes"]).map(|node| Some((node["id"].as_str()?, node)));
    let nodes: HashMap<&str, &Value> = nodes.collect::<Option<_>>().context("a node without an id")?;
    let (root, _) = packages
        .iter()
        .find(|(_, found)| found["name"] == package && found["source"].is_null())
        .with_context(|| format!("no package {package}"))?;
    let (mut met, mut waiting) = (BTreeSet::new(), vec![*root]);
    while let Some(id) = waiting.pop() {
        if met.insert(id) {
            let node = nodes.get(id).with_context(|| format!("{id} is not resolved"))?;
            // What is linked, not what builds or tests.
            let linked = list(&node["deps"]).filter(|needed| list(&needed["dep_kinds"]).any(|kind| kind["kind"].is_null()));
            waiting.extend(linked.filter_map(|needed| needed["pkg"].as_str()));
        }
    }
    let component = |id: &str| {
        let package = packages[id];
        let (name, version) = (package["name"].as_str().unwrap_or_default(), package["version"].as_str().unwrap_or_default());
        let mut component = json!({ "type": "library", "bom-ref": format!("{name}@{version}"), "name": name, "version": version });
        if !package["source"].is_null() {
            component["purl"] = json!(format!("pkg:cargo/{name}@{version}"));
        }
        if let Some(license) = package["license"].as_str() {
            component["licenses"] = json!([{ "expression": license.replace('/', " OR ") }]);
        }
        component
    };
    let mut subject = component(root);
    subject["type"] = json!(if target.is_some() { "firmware" } else { "application" });
    let bill = json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": { "component": subject },
        "components": met.iter().filter(|id| *id != root).map(|id| component(id)).collect::<Vec<_>>(),
    });
    let path = target_folder().join("sbom").join(format!("{package}.cdx.json"));
    std::fs::create_dir_all(target_folder().join("sbom"))?;
    std::fs::write(&path, serde_json::to_string_pretty(&bill)? + "\n").with_context(|| format!("{}", path.display()))?;
    Ok(path)
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}
