//! Processes and those that they began, by their numbers.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A process. Its start tells it from a later one with the same number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Process {
    pub number: u32,
    parent: u32,
    begun: u64,
}

impl Process {
    fn read(number: u32) -> Option<Self> {
        let stat = fs::read_to_string(format!("/proc/{number}/stat")).ok()?;
        let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
        // One that has ended and waits for its parent is none.
        if *fields.first()? == "Z" {
            return None;
        }
        Some(Self { number, parent: fields.get(1)?.parse().ok()?, begun: fields.get(19)?.parse().ok()? })
    }

    pub fn lives(self) -> bool {
        Self::read(self.number).is_some_and(|now| now.begun == self.begun)
    }
}

fn all() -> Vec<Process> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).filter_map(Process::read).collect()
}

/// A process, those that descend from it, and those whose command line names `mark`.
pub fn family(root: u32, mark: &str) -> Vec<Process> {
    let all = all();
    let names = |process: &Process| {
        fs::read(format!("/proc/{}/cmdline", process.number)).is_ok_and(|line| String::from_utf8_lossy(&line).contains(mark))
    };
    let mut family: Vec<Process> = all.iter().filter(|process| process.number == root || names(process)).copied().collect();
    let mut seen = 0;
    while let Some(parent) = family.get(seen).map(|process| process.number) {
        seen += 1;
        let children = all.iter().filter(|process| process.parent == parent);
        let fresh: Vec<Process> = children.filter(|process| !family.contains(process)).copied().collect();
        family.extend(fresh);
    }
    family
}

/// Ends those that `find` finds, again until it finds none: a browser begins others while it is ended.
pub fn end(find: impl Fn() -> Vec<Process>) {
    let until = Instant::now() + Duration::from_secs(5);
    let mut met: Vec<Process> = Vec::new();
    while Instant::now() < until {
        let found = find();
        met.extend(found.iter().filter(|process| !met.contains(process)).copied().collect::<Vec<_>>());
        let living: Vec<String> = met.iter().filter(|process| process.lives()).map(|process| process.number.to_string()).collect();
        if living.is_empty() {
            return;
        }
        let _ = Command::new("kill").arg("-KILL").args(living).stderr(Stdio::null()).status();
        std::thread::sleep(Duration::from_millis(10));
    }
}
