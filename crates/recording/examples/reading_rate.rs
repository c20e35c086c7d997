//! Measures how fast a CSV of five million rows is read: into a recording, as every command does, and into the bare byte records of the `csv` crate.
//!
//! Both read the same file, in turns, on one thread; what counts is processor time, the least of several rounds. Run with
//! `cargo run --release -p recording --example reading_rate -- FILE`; the file is written first. One line of JSON.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use cpu_time::ProcessTime;
use csv::{ByteRecord, ReaderBuilder};

const ROWS: usize = 5_000_000;
const ROUNDS: usize = 5;

fn main() -> anyhow::Result<()> {
    let path = PathBuf::from(std::env::args().nth(1).expect("the file to write and to read"));
    write(&path)?;
    let (mut ours_s, mut bare_s) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        ours_s = ours_s.min(seconds(|| Ok(recording::load(std::slice::from_ref(&path), None)?[0].len()))?);
        bare_s = bare_s.min(seconds(|| bare(&path))?);
    }
    let bytes = std::fs::metadata(&path)?.len();
    println!("{{\"rows\":{ROWS},\"bytes\":{bytes},\"recording_cpu_s\":{ours_s:.3},\"byte_records_cpu_s\":{bare_s:.3}}}");
    Ok(())
}

/// Processor time of a read of all rows, s.
fn seconds(read: impl Fn() -> anyhow::Result<usize>) -> anyhow::Result<f64> {
    let begun = ProcessTime::now();
    let rows = read()?;
    let seconds = begun.elapsed().as_secs_f64();
    anyhow::ensure!(rows == ROWS, "{rows} rows were read");
    Ok(seconds)
}

/// Every record, and nothing done with it.
fn bare(path: &Path) -> anyhow::Result<usize> {
    let mut reader = ReaderBuilder::new().from_path(path)?;
    let mut record = ByteRecord::new();
    let mut rows = 0;
    while reader.read_byte_record(&mut record)? {
        rows += 1;
    }
    Ok(rows)
}

/// A sine at 1 kHz with four digits, as a logger writes it.
fn write(path: &Path) -> anyhow::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    writeln!(file, "time_s,pressure_bar,displacement_mm")?;
    for row in 0..ROWS {
        let time_s = row as f64 * 1e-3;
        let pressure_bar = 1.5 - 1.4 * (0.7 * time_s).cos();
        writeln!(file, "{time_s:.3},{pressure_bar:.4},{:.4}", 4.0 * pressure_bar + 0.3 * (0.7 * time_s).sin())?;
    }
    Ok(file.flush()?)
}
