//! The parent process: starts children, and tells which input crashed, hung, took too much memory, or was garbage that was accepted.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use crate::{SECONDS, targets};

/// Inputs of one child.
const BATCH: u64 = 100;

/// How long a child may take.
#[derive(Clone, Copy, Debug)]
struct Patience {
    /// Processor time of one input: what others do on the machine is not the reader's.
    processor: Duration,
    /// Time without an answer: a reader that waits for ever takes no processor time. So long also to make the files that a child begins from.
    answer: Duration,
}

const PATIENCE: Patience = Patience { processor: Duration::from_secs(SECONDS), answer: Duration::from_secs(120) };
/// How often a child that does not answer is looked at.
const LOOK: Duration = Duration::from_millis(200);

/// What a run found.
#[derive(Debug, Default)]
pub struct Found {
    /// Inputs that were read.
    pub inputs: u64,
    /// Of them accepted.
    pub accepted: u64,
    /// Inputs and accepted ones of each target.
    pub targets: BTreeMap<String, (u64, u64)>,
    /// Target, seed, number and what happened, of each input that ended wrongly.
    pub wrong: Vec<String>,
}

/// Reads changed files with all targets in turn for so long; `program` is `fuzz-readers`.
///
/// # Errors
/// When a child cannot be started.
pub fn run(program: &Path, seed: u64, duration: Duration) -> Result<Found> {
    let begin = Instant::now();
    let names: Vec<&str> = targets::all().iter().map(|target| target.name).collect();
    let mut found = Found::default();
    let mut round = 0;
    while begin.elapsed() < duration {
        for name in &names {
            if begin.elapsed() >= duration {
                break;
            }
            let before = (found.inputs, found.accepted);
            batch(program, &PATIENCE, name, seed, round * BATCH, &mut found)?;
            let of_target = found.targets.entry((*name).to_owned()).or_default();
            *of_target = (of_target.0 + found.inputs - before.0, of_target.1 + found.accepted - before.1);
        }
        round += 1;
    }
    Ok(found)
}

/// One child; behind an input that ended it another one goes on.
fn batch(program: &Path, patience: &Patience, target: &str, seed: u64, first: u64, found: &mut Found) -> Result<()> {
    let mut next = first;
    while next < first + BATCH {
        let count = first + BATCH - next;
        let words = [target.to_owned(), seed.to_string(), next.to_string(), count.to_string()];
        let mut child = Command::new(program)
            .args(&words)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("{} does not start", program.display()))?;
        let stdout = child.stdout.take().context("a pipe")?;
        let (sender, lines) = mpsc::channel();
        let reader =
            std::thread::spawn(move || BufReader::new(stdout).lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        let (mut newest, mut hung, mut ended) = (None, None, false);
        let (mut answered, mut used) = (Instant::now(), None);
        loop {
            match lines.recv_timeout(LOOK) {
                Ok(line) => {
                    (answered, used) = (Instant::now(), processor_time(child.id()));
                    match line.strip_prefix("accepted ") {
                        Some(accepted) => {
                            found.accepted += accepted.parse().unwrap_or(0);
                            ended = true;
                        }
                        // "ready" is no number: until the first input the child makes its files, for which only the answer counts.
                        None => newest = line.parse::<u64>().ok(),
                    }
                }
                Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) => {
                    let reading = newest.and(used).zip(processor_time(child.id()));
                    let busy = reading.is_some_and(|(before, now)| now.saturating_sub(before) > patience.processor);
                    if busy || answered.elapsed() > patience.answer {
                        let which = if busy { patience.processor } else { patience.answer };
                        hung =
                            Some(format!("took longer than {:.1} s{}", which.as_secs_f64(), if busy { " of processor time" } else { "" }));
                        child.kill().context("a child that does not end")?;
                        break;
                    }
                }
            }
        }
        let mut said = String::new();
        let stderr = child.stderr.take().context("a pipe")?;
        // Of a panic the first lines say where.
        stderr.take(2000).read_to_string(&mut said).unwrap_or_default();
        let status = child.wait()?;
        drop(reader.join());
        if ended && status.success() {
            found.inputs += count;
            return Ok(());
        }
        let number = newest.unwrap_or(next);
        found.inputs += number + 1 - next;
        let what = hung.unwrap_or_else(|| format!("{status}: {}", said.trim()));
        let wrong = format!("target {target}, seed {seed}, number {number}: {what}");
        // Of a long run nobody waits for the end to mend this.
        eprintln!("{wrong}");
        found.wrong.push(wrong);
        next = number + 1;
    }
    Ok(())
}

/// Processor time that a process has used, of all its threads; `None` where the system has no `/proc`.
fn processor_time(process: u32) -> Option<Duration> {
    // proc(5): user and system time are fields 14 and 15, in ticks of 10 ms; the name in brackets may hold spaces.
    let text = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let (_, behind_the_name) = text.rsplit_once(')')?;
    let ticks: Vec<u64> = behind_the_name.split_whitespace().skip(11).take(2).filter_map(|field| field.parse().ok()).collect();
    (ticks.len() == 2).then(|| Duration::from_millis(10 * (ticks[0] + ticks[1])))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// What a run finds of a child that does this while it reads its last input.
    fn found(work: &str, patience: &Patience) -> Found {
        let folder = tempfile::tempdir().expect("folder");
        let program = folder.path().join("child");
        std::fs::write(&program, format!("#!/bin/sh\necho ready\necho 99\n{work}\necho accepted 1\n")).expect("written");
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("permissions");
        let mut found = Found::default();
        batch(&program, patience, "target", 1, 0, &mut found).expect("a child");
        found
    }

    #[test]
    fn a_reader_is_judged_by_its_processor_time_and_one_that_waits_for_ever_by_its_answer() {
        let patience = Patience { processor: Duration::from_millis(500), answer: Duration::from_secs(60) };
        // Others had the machine meanwhile.
        assert!(found("sleep 2", &patience).wrong.is_empty());
        let busy = found("while :; do :; done", &patience).wrong;
        assert!(busy.len() == 1 && busy[0].ends_with("number 99: took longer than 0.5 s of processor time"), "{busy:?}");
        let waits = found("exec sleep 1000", &Patience { answer: Duration::from_secs(1), ..patience }).wrong;
        assert!(waits.len() == 1 && waits[0].ends_with("took longer than 1.0 s"), "{waits:?}");
    }
}
