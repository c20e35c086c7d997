//! The maps of `tests/baselines/maps.toml` keep development and reporting apart, and training from test recordings.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use toml::Value;

fn maps() -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("baselines/maps.toml");
    let text = std::fs::read_to_string(&path).expect("the maps");
    let described: Value = toml::from_str(&text).expect("valid TOML");
    described["map"].as_array().expect("a list of maps").clone()
}

fn text<'a>(map: &'a Value, key: &str) -> &'a str {
    map.get(key).and_then(Value::as_str).unwrap_or_else(|| panic!("{key} is missing from {map}"))
}

fn files<'a>(map: &'a Value, key: &str) -> BTreeSet<&'a str> {
    map[key].as_array().expect("a list of files").iter().map(|file| file.as_str().expect("a file name")).collect()
}

#[test]
fn no_held_out_error_is_seen_on_both_sides() {
    // What is held out: an output of a file.
    let mut sides: BTreeMap<(String, &str, String), &str> = BTreeMap::new();
    let maps = maps();
    for map in &maps {
        let output = map["from"].as_array().and_then(|from| from.last()).and_then(Value::as_str).expect("an output");
        for file in files(map, "test") {
            let side = text(map, "role");
            let other = sides.insert((text(map, "set").to_owned(), file, output.to_owned()), side).unwrap_or(side);
            assert_eq!(side, other, "{}: {output} of {file} is judged on both sides", text(map, "name"));
        }
    }
    for side in ["development", "reporting"] {
        let of_side: Vec<&Value> = maps.iter().filter(|map| text(map, "role") == side).collect();
        let sets: BTreeSet<&str> = of_side.iter().map(|map| text(map, "set")).collect();
        assert!(of_side.len() >= 10 && sets.len() >= 4, "{side}: {} maps of {} sets say little", of_side.len(), sets.len());
    }
}

#[test]
fn no_map_is_judged_on_what_it_is_fitted_to() {
    for map in &maps() {
        let shared: Vec<&str> = files(map, "train").intersection(&files(map, "test")).copied().collect();
        let by_episodes = map.get("train_episodes").is_some();
        assert!(shared.is_empty() || by_episodes, "{}: {shared:?} on both sides", text(map, "name"));
    }
}

#[test]
fn the_columns_name_one_signal_for_each_source() {
    for map in &maps() {
        let roles: Vec<&str> = text(map, "columns").split(',').filter_map(|part| part.split_once('=')).map(|(role, _)| role).collect();
        let sources = map["from"].as_array().map_or(0, Vec::len);
        assert_eq!(roles.first(), Some(&"time"), "{}", text(map, "name"));
        assert_eq!(roles.last(), Some(&"output"), "{}", text(map, "name"));
        assert_eq!(roles.len(), sources + 1, "{}", text(map, "name"));
    }
}
