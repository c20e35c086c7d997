use std::path::{Path, PathBuf};

use super::*;

mod clocks;
mod estimates;
mod layouts;

const HEADER: &str = "time_s,pressure_bar,displacement_mm\n";

fn own(text: &str) -> Result<Recording, RecordingError> {
    parse(Path::new("run.csv"), text.as_bytes(), &ColumnMap::own())
}

#[test]
fn bad_files_are_refused_with_file_line_and_remedy() {
    let rows = |body: &str| format!("{HEADER}{body}");
    let cases: Vec<(String, &str)> = vec![
        (String::new(), "run.csv: the file is empty"),
        ("\n\r\n  \n".into(), "run.csv: the file is empty"),
        (HEADER.into(), "run.csv: has 0 row(s)"),
        (rows("0,1,2\n"), "run.csv: has 1 row(s)"),
        (rows("0,1,2\n1,NaN,2\n"), "run.csv:3: column `pressure_bar` holds `NaN`"),
        (rows("0,1,2\n1,1,-inf\n"), "run.csv:3: column `displacement_mm` holds `-inf`"),
        (rows("0,1,2\n1,1e999,3\n"), "run.csv:3: column `pressure_bar` holds `1e999`"),
        (rows("0,1,2\n1,,3\n"), "run.csv:3: column `pressure_bar` holds nothing"),
        (rows("0,1,2\n1,abc,3\n"), "run.csv:3: column `pressure_bar` holds `abc`"),
        (rows("0,1,2\n\n\n1,0x10,3\n"), "run.csv:5: column `pressure_bar` holds `0x10`"),
        (
            "# a rig\ntime_s,pressure_bar,displacement_mm\n# a pause\n0,1,2\n1,oops,3\n".into(),
            "run.csv:5: column `pressure_bar` holds `oops`",
        ),
        (rows("0,1,2\r\n\r\n1,oops,3"), "run.csv:4: column `pressure_bar` holds `oops`"),
        (rows("0,1,2\n0,1,3\n0,1,4\n0,1,5\n"), "run.csv:3: the time 0 s does not come after the 0 s"),
        (rows("0,1,2\n1,1,3\n0.5,1,4\n"), "run.csv:4: the time 0.5 s does not come after the 1 s"),
        (rows("0,1,2\n1,1\n"), "run.csv:3: the row has 2 cell(s), the header has 3"),
        (rows("0,1,2\n1,1,2,3\n"), "run.csv:3: the row has 4 cell(s), the header has 3"),
        ("0,1,2\n1,1,2\n".into(), "run.csv:1: the first line holds numbers"),
        ("time_s;pressure_bar\n0;1;2\n".into(), "run.csv:1: there is no column `displacement_mm` (the file has time_s,pressure_bar)"),
        ("time_s,pressure_bar\n0,1\n1,1\n".into(), "run.csv:1: there is no column `displacement_mm`"),
        ("time_s,pressure_bar,displacement_mm,note\n0,1,2,3\n".into(), "run.csv:1: the column `note` is not part of our format"),
        ("time_s,pressure_bar,displacement_mm,time_s\n0,1,2,3\n".into(), "run.csv:1: the column `time_s` occurs twice"),
        ("time_s,pressure_bar,displacement_mm,sequence\n0,1,2,7\n1,1,2,7\n".into(), "run.csv:3: the sequence number 7"),
        ("time_s,pressure_bar,displacement_mm,sequence\n0,1,2,7.5\n1,1,2,8\n".into(), "run.csv:2: the sequence number 7.5"),
    ];
    for (text, wanted) in cases {
        let message = own(&text).expect_err(&text).to_string();
        assert!(message.starts_with(wanted), "{text:?} gave: {message}");
        assert!(message.contains(';') || message.contains('?'), "no remedy in: {message}");
    }
    let latin = parse(Path::new("run.csv"), b"time_s,pressure_bar,displacement_mm\n\n0,1,\xb5\n", &ColumnMap::own());
    assert!(latin.expect_err("not UTF-8").to_string().starts_with("run.csv:3: the text is not UTF-8"));
}

#[test]
fn what_a_monitor_writes_beside_a_recording_is_read() {
    let text = "time_s,pressure_bar,displacement_mm,sequence,pressure_measured_bar,set_point,output_bar,pressure_code,laser_code,fault\n\
                0,1,2,7,1.1,1,1,3000,1700,0\n0.1,1.5,2.5,8,1.6,1.5,1.5,3100,1800,0\n";
    let read = own(text).expect("a recording");
    assert_eq!((read.input, read.output), (vec![1.0, 1.5], vec![2.0, 2.5]));
}

#[test]
fn byte_order_mark_crlf_and_blank_lines_change_nothing() {
    let plain = own("time_s,pressure_bar,displacement_mm\n0,1,2\n0.5,3,4\n1,5,6\n").expect("plain");
    let dressed = own("\u{feff}time_s, pressure_bar ,displacement_mm\r\n0,1,2\r\n0.5, 3,4\r\n1,5,6\r\n\r\n  \r\n").expect("dressed");
    assert_eq!((plain.time_s, plain.input, plain.output), (dressed.time_s, dressed.input, dressed.output));
}

/// One hundred samples of a sine at 100 Hz with jitter, and one lost.
fn one_lost_of_a_sine(frequency_hz: f64) -> Recording {
    let mut text = HEADER.to_owned();
    for index in (0..100).filter(|&index| index != 40) {
        let jitter = if index % 3 == 1 { 0.004 } else { 0.0 };
        let time_s = f64::from(index) * 0.01 + jitter;
        let value = (std::f64::consts::TAU * frequency_hz * time_s).sin();
        text += &format!("{time_s},{value},{value}\n");
    }
    own(&text).expect("read")
}

#[test]
fn a_lost_sample_is_a_gap_where_something_could_have_happened_in_it_and_jitter_is_not() {
    // In 20 ms a sine of 10 Hz leaves the straight line by a tenth of its range.
    let fast = one_lost_of_a_sine(10.0);
    assert_eq!(fast.gaps, [40]);
    assert_eq!(fast.segments(), [0..40, 40..99]);
    assert!((fast.sample_period_s - 0.01).abs() < 1e-9);
    let timing = fast.timing();
    assert!(timing.uneven_share > 0.5 && timing.gaps == 1 && (timing.longest_step_s - 0.02).abs() < 1e-9, "{timing:?}");
    // A sine of 1 Hz leaves it by a thousandth: the lost sample is known.
    assert!(one_lost_of_a_sine(1.0).gaps.is_empty());
}

#[test]
fn a_jump_of_the_sequence_is_a_gap_even_when_the_clock_hides_it() {
    let text = "time_s,pressure_bar,displacement_mm,sequence,temperature_c\n0,1,2,10,20\n1,1,2,11,20\n2,1,2,14,21\n3,1,2,15,21\n";
    let recording = own(text).expect("read");
    assert_eq!(recording.gaps, [2]);
    assert_eq!(recording.extra[1], ExtraColumn { name: "temperature_c".into(), values: vec![20.0, 20.0, 21.0, 21.0] });
}

#[test]
fn rounded_times_give_the_exact_period() {
    let mut text = HEADER.to_owned();
    for index in 0..500 {
        text += &format!("{:.4},0,0\n", f64::from(index) / 128.0);
    }
    assert!((own(&text).expect("read").sample_period_s - 1.0 / 128.0).abs() < 1e-7);
}

#[test]
fn what_is_written_reads_back_bit_for_bit() {
    let awkward = [0.1 + 0.2, -0.0, 1e-300, 123_456_789.123_456_79, f64::MIN_POSITIVE, 5e29, 1.0 / 3.0];
    let time_s: Vec<f64> = (0..awkward.len()).map(|index| index as f64 / 3.0).collect();
    let reversed = awkward.iter().rev().copied().collect();
    let mut recording =
        Recording::new(Path::new("b_7.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, awkward.to_vec(), reversed)
            .expect("valid");
    recording.extra.push(ExtraColumn { name: "temperature_c".into(), values: awkward.to_vec() });
    let second = Signal { quantity: "pressure2".into(), unit: "bar".into() };
    recording.more_inputs.push(Channel { signal: second, values: awkward.to_vec() });
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("deep/b_7.csv");
    write(&path, &recording).expect("write");
    let back = load(&[folder.path().to_path_buf()], None).expect("read").remove(0);
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&back.time_s), bits(&recording.time_s));
    assert_eq!(bits(&back.input), bits(&recording.input));
    assert_eq!(bits(&back.output), bits(&recording.output));
    assert_eq!(bits(&back.extra[0].values), bits(&awkward));
    assert_eq!((bits(&back.more_inputs[0].values), &back.more_inputs[0].signal), (bits(&awkward), &recording.more_inputs[0].signal));
    assert_eq!((back.family.as_str(), back.sha256.len()), ("b", 64));
}

#[test]
fn foreign_columns_carry_quantity_and_unit() {
    let map = ColumnMap::parse("time=t_ms,input=voltage_V, output=laser:um").expect("map");
    let text = "laser,note,t_ms,voltage_V\n5,x,0,1\n6,y,20,2\n";
    let recording = parse(Path::new("x/model_1hz_sine.csv"), text.as_bytes(), &map).expect("read");
    assert_eq!(recording.time_s, [0.0, 0.02]);
    assert_eq!(recording.input, [1.0, 2.0]);
    assert_eq!(recording.output, [0.005, 0.006]);
    assert_eq!(recording.input_signal.column(), "voltage_V");
    assert_eq!(recording.output_signal, Signal { quantity: "laser".into(), unit: "mm".into() });
    assert_eq!(recording.family, "model");
    let error = parse(Path::new("y.csv"), b"t_ms,voltage_V\n0,1\n", &map).expect_err("no output").to_string();
    assert!(error.contains("y.csv:1: there is no column `laser` (the file has t_ms,voltage_V)"), "{error}");
}

#[test]
fn our_own_files_have_a_map_that_can_be_named() {
    let named = ReadOptions::columns(Some("own")).map().expect("a map");
    assert_eq!(named, ColumnMap::own());
}

#[test]
fn bad_column_maps_say_what_is_wrong() {
    for (text, wanted) in [
        ("time=t_s,input=v_V", "`output` is missing"),
        ("time=t_s,input=v_V,input3=w_V,output=d_mm", "`input3` is given without `input2`"),
        ("time=t_s,input=v_V,input2=v_V,output=d_mm", "same column"),
        ("time=t_s,input=v_V,output=d_mm,other=x_y", "`other` is none of"),
        ("time=t_s,time=t_s,input=v_V,output=d_mm", "`time` is given twice"),
        ("time=t_s,input=v_V,output", "has no `=`"),
        ("time=t_s,input=v,output=d_mm", "`v` has no unit"),
        ("time=t_d,input=v_V,output=d_mm", "the time unit `d`"),
        ("time=t_s,input=v_V,output=v_V", "same column"),
        ("", "has no `=`"),
    ] {
        let message = ColumnMap::parse(text).expect_err(text).to_string();
        assert!(message.contains(wanted) && message.contains("for example"), "{text}: {message}");
    }
}

#[test]
fn folders_and_missing_paths_are_told_apart() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().to_path_buf();
    assert!(matches!(load(std::slice::from_ref(&path), None), Err(RecordingError::NoFiles { .. })));
    assert!(matches!(read(&path, &ColumnMap::own()), Err(RecordingError::IsFolder { .. })));
    assert!(matches!(load(&[path.join("absent.csv")], None), Err(RecordingError::Open { .. })));
    assert!(matches!(load(&Vec::<PathBuf>::new(), None), Err(RecordingError::NoPaths)));
    for name in ["b_2.csv", "sub/a_1.CSV", "a_9.csv", ".hidden.csv", "notes.txt"] {
        std::fs::create_dir_all(path.join("sub")).expect("folder");
        std::fs::write(path.join(name), format!("{HEADER}0,1,2\n1,1,2\n")).expect("write");
    }
    let families: Vec<String> = load(&[path], None).expect("read").into_iter().map(|recording| recording.family).collect();
    assert_eq!(families, ["a", "b", "a"]);
}
