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

/// A child may take so long to make the files that it begins from, s: on a busy machine a training of a second takes its time.
const START_SECONDS: u64 = 120;

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
            batch(program, name, seed, round * BATCH, &mut found)?;
            let of_target = found.targets.entry((*name).to_owned()).or_default();
            *of_target = (of_target.0 + found.inputs - before.0, of_target.1 + found.accepted - before.1);
        }
        round += 1;
    }
    Ok(found)
}

/// One child; behind an input that ended it another one goes on.
fn batch(program: &Path, target: &str, seed: u64, first: u64, found: &mut Found) -> Result<()> {
    let mut next = first;
    // The input that took too long once: a busy machine may have been the reason, twice in a row it is the reader.
    let mut suspect = None;
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
        let (mut newest, mut hung, mut ended) = (None, false, false);
        let mut patience_s = START_SECONDS;
        loop {
            match lines.recv_timeout(Duration::from_secs(patience_s)) {
                Ok(line) if line == "ready" => patience_s = SECONDS,
                Ok(line) => match line.strip_prefix("accepted ") {
                    Some(accepted) => {
                        found.accepted += accepted.parse().unwrap_or(0);
                        ended = true;
                    }
                    None => newest = line.parse::<u64>().ok(),
                },
                Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) => {
                    hung = true;
                    child.kill().context("a child that does not end")?;
                    break;
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
        if hung && suspect != Some(number) {
            suspect = Some(number);
            found.inputs += number - next;
            next = number;
            continue;
        }
        found.inputs += number + 1 - next;
        let what = if hung { format!("took longer than {SECONDS} s") } else { format!("{status}: {}", said.trim()) };
        found.wrong.push(format!("target {target}, seed {seed}, number {number}: {what}"));
        next = number + 1;
    }
    Ok(())
}
