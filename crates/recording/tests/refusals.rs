//! Inputs that once made garbage, a hang or a crash, and are refused with a reason.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use recording::{ColumnMap, Prepare, ReadOptions, Resample, load_with, parse, read};

const HEADER: &str = "time_s,pressure_bar,displacement_mm\n";

fn message(text: &str) -> String {
    parse(Path::new("run.csv"), text.as_bytes(), &ColumnMap::own()).expect_err("refused").to_string()
}

fn rows(count: usize, row: impl Fn(f64) -> (f64, f64, f64)) -> String {
    let row = |index: usize| {
        let (time_s, pressure, displacement) = row(index as f64);
        format!("{time_s},{pressure},{displacement}\n")
    };
    HEADER.to_owned() + &(0..count).map(row).collect::<String>()
}

#[test]
fn outputs_that_no_sensor_gives_are_refused() {
    let told = message(&rows(50, |index| (0.02 * index, index.sin(), 1e160 * index.cos())));
    assert!(told.starts_with("run.csv:2: column `displacement_mm` holds `1e160`") || told.contains("no sensor gives"), "{told}");
    assert!(message("time_s,pressure_bar,displacement_mm\n0,1,2\n1,-1e31,2\n").contains("no sensor gives"));
}

#[test]
fn a_clock_in_the_wrong_unit_is_refused_and_named() {
    let text = rows(50, |index| (0.02 * index, index.sin(), index.cos())).replacen("time_s", "t", 1);
    let map = ColumnMap::parse("time=t:us,input=pressure_bar,output=displacement_mm").expect("a map");
    let told = parse(Path::new("run.csv"), text.as_bytes(), &map).expect_err("50 MHz").to_string();
    assert!(told.contains("a sample every 2e-8 s") && told.contains("another unit"), "{told}");
}

#[test]
fn ten_million_columns_and_a_line_without_end_are_refused_at_once() {
    let begin = Instant::now();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("wide.csv");
    for (columns, wanted) in [(10_000_000, "longer than 1 MB"), (10_000, "has 10001 columns")] {
        std::fs::write(&path, "a,".repeat(columns)).expect("a file");
        let told = read(&path, &ColumnMap::own()).expect_err("wide").to_string();
        assert!(told.contains(wanted), "{told}");
    }
    let told = message(&("a,".repeat(3000) + "b\n1\n"));
    assert!(told.len() < 1000 && told.contains("3001 in all"), "{told}");
    assert!(begin.elapsed().as_secs() < 20, "{:?}", begin.elapsed());
}

#[test]
#[cfg(unix)]
fn a_pipe_that_nobody_writes_to_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().expect("mkfifo").success());
    assert!(read(&path, &ColumnMap::own()).expect_err("a pipe").to_string().contains("a pipe or a device"));
}

#[test]
fn a_file_that_unfolds_for_ever_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bomb.csv.gz");
    let mut encoder = flate2::write::GzEncoder::new(std::fs::File::create(&path).expect("a file"), flate2::Compression::best());
    encoder.write_all(HEADER.as_bytes()).expect("header");
    let lines = "# nothing\n".repeat(100_000);
    for _ in 0..100 {
        encoder.write_all(lines.as_bytes()).expect("lines");
    }
    encoder.finish().expect("finished");
    let told = read(&path, &ColumnMap::own()).expect_err("a bomb").to_string();
    assert!(told.contains("more than 100 times its size"), "{told}");
    let cut = std::fs::read(&path).expect("bytes");
    std::fs::write(&path, &cut[..cut.len() / 200]).expect("cut");
    assert!(read(&path, &ColumnMap::own()).expect_err("cut").to_string().contains("damaged gzip"));
}

#[test]
fn an_even_clock_that_would_fill_the_memory_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("slow.csv");
    std::fs::write(&path, rows(100, |index| (1e6 * index, (0.1 * index).sin(), (0.1 * index).cos()))).expect("a file");
    let prepare = Prepare { resample: Some(Resample::Period(1e-3)), ..Prepare::default() };
    let told = load_with(&[path], &ReadOptions { prepare, ..ReadOptions::default() }).expect_err("1e11 samples").to_string();
    assert!(told.contains("give --resample a longer period"), "{told}");
}

#[test]
fn start_and_zero_are_taken_off_as_asked_and_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    std::fs::write(&path, rows(200, |index| (0.02 * index, (0.1 * index).sin(), 7.0 + index * 0.01))).expect("a file");
    let load = |prepare| load_with(std::slice::from_ref(&path), &ReadOptions { prepare, ..ReadOptions::default() });
    let found = &load(Prepare { skip_s: 1.0, tare_s: Some(0.1), resample: None }).expect("read")[0];
    assert_eq!((found.len(), found.time_s[0]), (150, 1.0));
    // Five samples from the fiftieth on: 7.50 to 7.54.
    assert!((found.output[0] - (7.50 - 7.52)).abs() < 1e-12, "{}", found.output[0]);
    let notes: Vec<&str> = found.notes.iter().map(|note| note.text.as_str()).collect();
    assert!(notes.iter().any(|text| text.contains("The first 1 s, 50 samples, are left out")), "{notes:?}");
    assert!(notes.iter().any(|text| text.contains("mean over the first 5 sample(s) that count, 7.52 mm")), "{notes:?}");
    let found = &load(Prepare { resample: Some(Resample::Period(0.04)), ..Prepare::default() }).expect("read")[0];
    assert_eq!((found.len(), found.sample_period_s), (100, 0.04));
    assert!(load(Prepare { skip_s: 4.0, ..Prepare::default() }).expect_err("nothing left").to_string().contains("skip less"));
}

#[test]
fn signals_that_are_nearly_nothing_are_refused_and_a_zero_is_not() {
    let told = message(&rows(50, |index| (0.02 * index, index.sin(), 1e-310 * index.cos())));
    assert!(told.contains("`displacement_mm` never exceeds") && told.contains("their units"), "{told}");
    let still = rows(50, |index| (0.02 * index, index.sin(), 0.0));
    assert!(parse(Path::new("run.csv"), still.as_bytes(), &ColumnMap::own()).is_ok());
}

#[test]
fn old_line_ends_and_two_byte_text_are_told_as_such() {
    let text = rows(50, |index| (0.02 * index, index.sin(), index.cos()));
    assert!(message(&text.replace('\n', "\r")).contains("carriage return alone"));
    for bytes in [u16::to_le_bytes, u16::to_be_bytes] {
        let wide: Vec<u8> = text.encode_utf16().flat_map(bytes).collect();
        let told = parse(Path::new("run.csv"), &wide, &ColumnMap::own()).expect_err("two bytes a letter").to_string();
        assert!(told.contains("UTF-16"), "{told}");
    }
}

#[test]
fn a_unit_that_does_not_go_with_the_values_is_told() {
    for (scales, words) in [([1e6, 1.0, 1.0], "Is the time in ms or us?"), ([1.0, 100.0, 1.0], "kPa"), ([1.0, 1.0, 1e4], "Is it in um?")] {
        let [time, pressure, displacement] = scales;
        let text = rows(50, |index| (time * 0.02 * index, pressure * index.sin(), displacement * index.cos()));
        let recording = parse(Path::new("run.csv"), text.as_bytes(), &ColumnMap::own()).expect("a recording");
        assert!(recording.notes.iter().any(|note| note.text.contains(words)), "{words}: {:?}", recording.notes);
    }
}

#[test]
fn a_clock_longer_than_the_recording_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    std::fs::write(&path, rows(50, |index| (0.02 * index, index.sin(), index.cos()))).expect("a file");
    let prepare = Prepare { resample: Some(Resample::Period(1e9)), ..Prepare::default() };
    let told = load_with(&[path], &ReadOptions { prepare, ..ReadOptions::default() }).expect_err("one sample").to_string();
    assert!(told.contains("a shorter period"), "{told}");
}
