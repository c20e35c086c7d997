//! Files made by the ordinary tool of each format (`formats/make.py`) are read to the bit, and what is written is read back to the bit.

use std::path::{Path, PathBuf};

use recording::{ColumnMap, ENDINGS, ReadOptions, Recording, load_with, read, write_as};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/formats").join(name)
}

fn own(name: &str) -> Recording {
    read(&fixture(name), &ColumnMap::own()).unwrap_or_else(|error| panic!("{error}"))
}

fn mapped(name: &str, columns: &str) -> Recording {
    read(&fixture(name), &ColumnMap::parse(columns).expect(columns)).unwrap_or_else(|error| panic!("{error}"))
}

fn bits(recording: &Recording) -> Vec<[u64; 3]> {
    let columns = recording.time_s.iter().zip(&recording.input).zip(&recording.output);
    columns.map(|((time, input), output)| [time.to_bits(), input.to_bits(), output.to_bits()]).collect()
}

fn notes(recording: &Recording) -> String {
    recording.notes.iter().map(|note| note.text.as_str()).collect::<Vec<_>>().join(" ")
}

#[test]
fn files_of_every_tool_hold_the_same_bits() {
    let reference = own("reference.csv");
    assert_eq!(reference.len(), 80);
    for name in ["gzip.csv.gz", "savez.npz", "compressed.npz", "compressed.mat", "columns.mat", "zstd.mcap", "lz4.mcap", "tab.tsv"] {
        let found = own(name);
        assert_eq!(bits(&found), bits(&reference), "{name}");
        assert_eq!(found.input_signal, reference.input_signal, "{name}");
        assert_eq!(found.sha256.len(), 64, "{name}");
        assert_ne!(found.sha256, reference.sha256, "{name}: the hash is that of the file, not of what is in it");
    }
}

#[test]
fn a_spreadsheet_with_decimal_commas_is_read_to_the_bit_and_said() {
    let found = mapped("excel.csv", "time=Zeit (s),input=Druck (bar),output=Weg (mm)");
    assert_eq!(bits(&found), bits(&own("reference.csv")));
    assert!(notes(&found).contains("decimal commas") && notes(&found).contains("semicolons"), "{}", notes(&found));
}

#[test]
fn columns_of_matrices_and_fields_of_structures_have_names() {
    let reference = own("reference.csv");
    assert_eq!(bits(&mapped("matrix.npz", "time=log.1:s,input=log.2:bar,output=log.3:mm")), bits(&reference));
    let single = mapped("matrix.npz", "time=log32.1:s,input=log32.2:bar,output=log32.3:mm");
    assert!(single.input.iter().zip(&reference.input).all(|(one, other)| *one == f64::from(*other as f32)));
    assert_eq!(bits(&mapped("structure.mat", "time=run.t:s,input=run.p:bar,output=run.x:mm")), bits(&reference));
    let counted = mapped("structure.mat", "time=run.t:s,input=run.n:1,output=run.x:mm");
    assert_eq!(counted.input[79], 79.0);
    let nested = mapped("nested.mcap", "time=log_time_s,input=rig.p:bar,output=rig.x:mm");
    assert_eq!((&nested.input, &nested.output), (&reference.input, &reference.output));
    assert!(nested.time_s.iter().zip(&reference.time_s).all(|(one, other)| (one - other).abs() < 1e-9));
}

#[test]
fn what_was_passed_over_is_said() {
    assert!(notes(&own("compressed.npz")).contains("passed over: rig, channels"));
    let structure = mapped("structure.mat", "time=run.t:s,input=run.p:bar,output=run.x:mm");
    assert!(notes(&structure).contains("run.name") && notes(&structure).contains("cell"), "{}", notes(&structure));
    assert!(notes(&own("zstd.mcap")).contains("The topic `/rig` was read; others were passed over: /log"));
}

#[test]
fn units_in_headers_and_behind_a_colon_are_converted_and_said() {
    let reference = own("reference.csv");
    let close = |found: &[f64], wanted: &[f64]| found.iter().zip(wanted).all(|(one, other)| (one - other).abs() < 1e-15 * 4.0);
    let maps = [
        None,
        Some("time=time_ms:ms,input=pressure_kPa:kPa,output=displacement_um:um"),
        Some("time=time_ms,input=pressure_kPa:kPa,output=displacement_um:um@0..1000=0..1mm"),
    ];
    for map in maps {
        let found = map.map_or_else(|| own("units.csv"), |map| mapped("units.csv", map));
        assert!(close(&found.time_s, &reference.time_s) && close(&found.input, &reference.input), "{map:?}");
        assert!(close(&found.output, &reference.output), "{map:?}");
        assert_eq!((found.input_signal.unit.as_str(), found.output_signal.unit.as_str()), ("bar", "mm"));
        assert!(notes(&found).contains("`pressure_kPa` is converted from kPa into bar."), "{}", notes(&found));
    }
    let kept = mapped("units.csv", "time=time_ms,input=pressure_kPa,output=displacement_um");
    assert_eq!((kept.input_signal.unit.as_str(), kept.output_signal.unit.as_str()), ("kPa", "um"));
    let options = ReadOptions {
        columns: Some("time=time_ms,input=pressure_kPa:kPa,output=displacement_um:um".into()),
        keep_units: true,
        ..ReadOptions::default()
    };
    let kept = &load_with(&[fixture("units.csv")], &options).expect("read")[0];
    assert_eq!((kept.input_signal.unit.as_str(), kept.output_signal.unit.as_str()), ("kPa", "um"));
}

#[test]
fn every_format_gives_back_what_was_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut reference = own("reference.csv");
    // Numbers that lose bits where a format rounds.
    reference.output[3] = 0.1 + 0.2;
    reference.output[4] = -1.0e-17 / 3.0;
    reference.input[5] = f64::MIN_POSITIVE;
    reference.extra.push(recording::ExtraColumn { name: "temperature_c".into(), values: vec![21.0 + 1.0 / 3.0; 80] });
    reference.more_inputs.push(recording::Channel {
        signal: recording::Signal { quantity: "pressure2".into(), unit: "bar".into() },
        values: reference.input.iter().map(|value| value / 7.0).collect(),
    });
    for ending in ENDINGS {
        for provenance in ["", "catheter convert, µ and a\nline end"] {
            let path = folder.path().join(format!("run.{ending}"));
            write_as(&path, &reference, provenance).unwrap_or_else(|error| panic!("{error}"));
            let back = read(&path, &ColumnMap::own()).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(bits(&back), bits(&reference), "{ending}");
            assert_eq!((&back.extra, &back.more_inputs), (&reference.extra, &reference.more_inputs), "{ending}");
            assert_eq!((&back.input_signal, &back.output_signal), (&reference.input_signal, &reference.output_signal), "{ending}");
            let first = std::fs::read(&path).expect("bytes");
            write_as(&path, &reference, provenance).expect("written again");
            assert_eq!(std::fs::read(&path).expect("bytes"), first, "{ending}: equal recordings give equal files");
        }
    }
    let foreign = mapped("structure.mat", "time=run.t:s,input=run.p:bar,output=run.x:mm");
    let error = write_as(&folder.path().join("foreign.mat"), &foreign, "").expect_err("`run.p_bar` is no variable");
    assert!(error.to_string().contains("rename the column"), "{error}");
    assert!(write_as(&folder.path().join("run.xlsx"), &reference, "").is_err());
}

#[test]
fn a_folder_of_other_formats_is_found_and_copies_beside_text_are_not_counted_twice() {
    let folder = tempfile::tempdir().expect("a folder");
    let reference = own("reference.csv");
    for name in ["a.npz", "b.mat", "c.mcap"] {
        write_as(&folder.path().join(name), &reference, "").expect("written");
    }
    let count = || load_with(&[folder.path().to_path_buf()], &ReadOptions::default()).expect("read").len();
    assert_eq!(count(), 3);
    write_as(&folder.path().join("d.csv.gz"), &reference, "").expect("written");
    assert_eq!(count(), 1);
}

#[test]
fn files_that_people_take_for_recordings_are_refused_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let cases: [(&[u8], &str); 6] = [
        (b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'", "np.savez"),
        (b"\x89HDF\r\n\x1a\n", "-v7"),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64", "-v7"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "as CSV"),
        (b"\xff\xfet\x00i\x00m\x00e\x00", "UTF-8"),
        (b"PK\x05\x06\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", "no column"),
    ];
    for (bytes, wanted) in cases {
        let path = folder.path().join("run.csv");
        std::fs::write(&path, bytes).expect("a file");
        let message = read(&path, &ColumnMap::own()).expect_err(wanted).to_string();
        assert!(message.contains(wanted), "{message}");
    }
}
