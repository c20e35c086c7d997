//! `catheter explain`.

use anyhow::{Result, bail};
use model_export::link::fault::{AdaptationCondition, Blocker, Explanation, Fault, Notice, explain};
use serde::Serialize;

use super::{Outcome, Results};
use crate::say;

/// Say what a fault, blocker, notice or condition means and what to do about it.
#[derive(clap::Args)]
pub struct Arguments {
    /// Its identifier or name: E017 is a fault, B003 a blocker, N002 a notice, C005 a condition of adaptation; the list of all when absent.
    identifier: Option<String>,
    #[command(flatten)]
    results: Results,
}

/// What `--json` gets of each.
#[derive(Serialize)]
struct Written {
    identifier: String,
    name: &'static str,
    meaning: &'static str,
    remedy: &'static str,
}

impl Written {
    fn new((table, explanation): (char, Explanation)) -> Self {
        let Explanation { number, name, meaning, remedy } = explanation;
        Self { identifier: format!("{table}{number:03}"), name, meaning, remedy }
    }
}

/// Everything that has a number.
fn all() -> Vec<(char, Explanation)> {
    let faults = Fault::ALL.iter().map(|fault| ('E', fault.explanation()));
    let blockers = Blocker::ALL.iter().map(|blocker| ('B', blocker.explanation()));
    let notices = Notice::ALL.iter().map(|notice| ('N', notice.explanation()));
    let conditions = AdaptationCondition::ALL.iter().map(|condition| ('C', condition.explanation()));
    faults.chain(blockers).chain(notices).chain(conditions).collect()
}

/// Runs the command.
///
/// # Errors
/// On an identifier that nothing has.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let entries: Vec<Written> = match &arguments.identifier {
        None => all().into_iter().map(Written::new).collect(),
        Some(identifier) => {
            let table = identifier.trim().chars().next().unwrap_or_default().to_ascii_uppercase();
            let named = || all().into_iter().find(|(_, entry)| entry.name.eq_ignore_ascii_case(identifier.trim()));
            let Some(entry) = explain(identifier).map(|explanation| (table, explanation)).or_else(named) else {
                let last = |table| all().iter().filter(|(found, _)| *found == table).map(|(_, entry)| entry.number).max().unwrap_or(0);
                bail!(
                    "nothing has the number or name {identifier}; there are faults E001 to E{:03}, blockers B001 to B{:03}, notices N001 to N{:03} and \
                     conditions C001 to C{:03}, and `catheter explain` lists them all",
                    last('E'),
                    last('B'),
                    last('N'),
                    last('C')
                );
            };
            vec![Written::new(entry)]
        }
    };
    for entry in &entries {
        if arguments.identifier.is_some() {
            say!("{} {}\n\n{}\n{}", entry.identifier, entry.name, entry.meaning, entry.remedy);
        } else {
            say!("{}  {:<24} {}", entry.identifier, entry.name, entry.meaning);
        }
    }
    let title = "What the rig says, explained";
    match &arguments.identifier {
        Some(identifier) => arguments.results.write(title, &format!("The entry {identifier}."), &entries[0], |_| {})?,
        None => arguments.results.write(title, "Faults, blockers, notices and conditions.", &entries, |_| {})?,
    }
    Ok(Outcome::Success)
}
