//! The README and the book point only to what exists.

use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// README, changelog and every page of the book.
fn pages() -> Vec<PathBuf> {
    let mut pages = vec![root().join("README.md"), root().join("CHANGELOG.md")];
    for entry in std::fs::read_dir(root().join("docs")).expect("the book") {
        let path = entry.expect("an entry of a folder").path();
        if path.extension().is_some_and(|ending| ending == "md") {
            pages.push(path);
        }
    }
    pages
}

/// The targets of Markdown links and images in `text`.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')').map(|(target, _)| target))
}

#[test]
fn every_link_leads_somewhere() {
    let mut seen = 0;
    for page in pages() {
        let text = std::fs::read_to_string(&page).expect("a page of the book");
        for target in links(&text).filter(|target| !target.starts_with("https://")) {
            let file = target.split('#').next().unwrap_or(target);
            let place = page.parent().expect("a page lies in a folder").join(file);
            assert!(place.exists(), "{}: the link to {target} leads nowhere", page.display());
            seen += 1;
        }
    }
    assert!(seen > 10, "only {seen} links found: is the pattern still right?");
}

#[test]
fn every_page_of_the_book_is_in_its_table_of_contents() {
    let contents = std::fs::read_to_string(root().join("docs/README.md")).expect("the table of contents");
    for page in pages().iter().filter(|page| page.parent() == Some(&root().join("docs"))) {
        let name = page.file_name().expect("a page has a name").to_string_lossy();
        assert!(name == "README.md" || contents.contains(&format!("({name})")), "{name} is not in docs/README.md");
    }
}

#[test]
fn every_folder_of_the_tree_in_the_readme_exists() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("the README");
    let tree = readme.split("## The tree").nth(1).and_then(|rest| rest.split("\n## ").next()).expect("the README shows the tree");
    let names: Vec<&str> = tree.lines().filter_map(|line| line.strip_prefix("| `")?.split_once('`').map(|(name, _)| name)).collect();
    assert!(names.len() >= 8, "{names:?}");
    for name in names {
        assert!(root().join(name).exists(), "{name} is in the README's tree and not in the project");
    }
}
