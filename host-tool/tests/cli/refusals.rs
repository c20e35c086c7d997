//! Bad input of every kind: exit code 2, a message that names the file, the line and the way out, nothing left behind.

use crate::support::{Bench, recording_csv};

/// A file that is no recording: name, bytes, and what the message must say besides the name.
struct BadRecording {
    name: &'static str,
    bytes: Vec<u8>,
    says: &'static [&'static str],
}

/// A recording in our format with row `row` (the first row of data is 1) replaced.
fn with_row(row: usize, text: &str) -> Vec<u8> {
    let mut lines: Vec<String> = recording_csv(0.5).lines().map(str::to_owned).collect();
    text.clone_into(&mut lines[row]);
    (lines.join("\n") + "\n").into_bytes()
}

fn bad_recordings() -> Vec<BadRecording> {
    let bad = |name, bytes: Vec<u8>, says| BadRecording { name, bytes, says };
    let good = recording_csv(0.5);
    let header = |header: &str| good.replacen("time_s,pressure_bar,displacement_mm", header, 1).into_bytes();
    let joined = format!("{good}{}", good.split_once('\n').expect("a header").1);
    let cut_semicolons = String::from_utf8(with_row(7, "0.12,0.1")).expect("text").replace(',', ";");
    let standing = "time_s,pressure_bar,displacement_mm\n0,0,0\n0,1,1\n0,2,1\n0,1,0\n".as_bytes().to_vec();
    vec![
        bad("empty.csv", Vec::new(), &["empty"]),
        bad("header_only.csv", b"time_s,pressure_bar,displacement_mm\n".to_vec(), &["0 row(s)"]),
        bad("one_row.csv", b"time_s,pressure_bar,displacement_mm\n0,0,0\n".to_vec(), &["1 row(s)"]),
        bad("no_header.csv", b"0,0,0\n0.02,0.1,0.1\n0.04,0.2,0.2\n".to_vec(), &["no_header.csv:1:", "header"]),
        bad("nan.csv", with_row(7, "0.12,NaN,0.1"), &["nan.csv:8:", "pressure_bar", "NaN"]),
        bad("infinite.csv", with_row(7, "0.12,0.1,-inf"), &["infinite.csv:8:", "displacement_mm"]),
        bad("overflow.csv", with_row(7, "0.12,1e999,0.1"), &["overflow.csv:8:", "pressure_bar"]),
        bad("infinite_time.csv", with_row(7, "inf,0.1,0.1"), &["infinite_time.csv:8:", "time_s"]),
        bad("hole.csv", with_row(7, "0.12,,0.1"), &["hole.csv:8:", "pressure_bar", "nothing"]),
        bad("word.csv", with_row(7, "0.12,high,0.1"), &["word.csv:8:", "pressure_bar", "high"]),
        bad("ragged.csv", with_row(7, "0.12,0.1"), &["ragged.csv:8:", "2 cell(s)"]),
        bad("joined.csv", joined.into_bytes(), &["joined.csv:602:", "joined", "Split"]),
        bad("standing.csv", standing, &["standing.csv:3:", "--rate-hz"]),
        bad("missing_column.csv", header("time_s,pressure_bar,force_N"), &["missing_column.csv:1:", "displacement_mm"]),
        bad("duplicate.csv", header("time_s,pressure_bar,pressure_bar"), &["duplicate.csv:1:", "twice"]),
        bad("cut_semicolons.csv", cut_semicolons.into_bytes(), &["cut_semicolons.csv:8:", "2 cell(s)"]),
        bad("latin1.csv", b"time_s,pressure_bar,d\xe9placement_mm\n0,0,0\n1,1,1\n".to_vec(), &["latin1.csv:1:", "UTF-8"]),
        bad("picture.csv", vec![0x89, b'P', b'N', b'G', 0, 0xff, 0xfe, b'\n', 0, 1, 2, 3], &["picture.csv"]),
        bad("zeros.csv", vec![0; 4096], &["zeros.csv"]),
    ]
}

/// Every command that reads recordings, with `DATA` where the path goes.
const READERS: [&str; 4] = [
    "identify --data DATA --out out/physics.toml --json out/result.json",
    "train --preset stream-1x32 --data DATA --out out/model.safetensors --budget-cpu-s 1 --json out/result.json",
    "evaluate --model physics.toml --data DATA --json out/result.json",
    "export model.safetensors --calibration DATA --out out/model.blob --json out/result.json",
];

#[test]
fn a_bad_recording_is_refused_by_every_command_with_file_and_line() {
    let bench = Bench::with_models();
    for bad in bad_recordings() {
        bench.write(bad.name, &bad.bytes);
        for reader in READERS {
            let said = bench.refuses(&reader.replace("DATA", bad.name), bad.says);
            assert!(said.stderr.contains(bad.name), "`{}` does not name the file:\n{}", said.line, said.stderr);
        }
    }
}

#[test]
fn one_bad_file_among_good_ones_is_named() {
    let bench = Bench::with_models();
    bench.write("data/z/bad.csv", with_row(7, "0.12,NaN,0.1"));
    for reader in READERS {
        bench.refuses(&reader.replace("DATA", "data"), &["bad.csv:8:"]);
    }
}

#[test]
fn a_path_that_holds_no_recording_is_named() {
    let bench = Bench::with_models();
    bench.write("nothing_here/notes.txt", "no recordings");
    for reader in READERS {
        bench.refuses(&reader.replace("DATA", "missing.csv"), &["missing.csv"]);
        bench.refuses(&reader.replace("DATA", "nothing_here"), &["nothing_here", ".csv"]);
    }
}

#[test]
fn a_column_map_that_makes_no_sense_is_refused() {
    let bench = Bench::with_models();
    bench.write("foreign.csv", recording_csv(0.5).replacen("time_s,pressure_bar,displacement_mm", "t_s,voltage_V,displacement_um", 1));
    let cases: [(&str, &[&str]); 9] = [
        ("", &["--columns"]),
        ("nonsense", &["--columns", "nonsense"]),
        ("time=t_s", &["--columns", "input", "missing"]),
        ("time=t_s,input=voltage_V,output=voltage_V", &["--columns", "same column"]),
        ("time=t_s,input=voltage_V,input=displacement_um", &["--columns", "twice"]),
        ("time=t_s,input=voltage_V,colour=displacement_um", &["--columns", "colour"]),
        ("time=t_s,input=voltage,output=displacement_um", &["--columns", "unit"]),
        ("time=t_d:d,input=voltage_V,output=displacement_um", &["--columns", "time unit"]),
        ("time=t_s,input=current_A,output=displacement_um", &["foreign.csv:1:", "current_A", "voltage_V"]),
    ];
    for (map, says) in cases {
        bench.refuses(&format!("identify --data foreign.csv --columns={map} --out out/physics.toml"), says);
    }
}

#[test]
fn a_model_that_cannot_be_read_is_named() {
    let bench = Bench::with_models();
    std::fs::create_dir(bench.path("folder.toml")).expect("a folder");
    std::fs::create_dir(bench.path("folder.blob")).expect("a folder");
    bench.write("model.txt", "thresholds = [0.0]");
    bench.write("no_ending", "thresholds = [0.0]");
    for ending in ["toml", "safetensors", "blob"] {
        bench.write(&format!("empty.{ending}"), "");
        bench.write(&format!("garbage.{ending}"), [0xff; 300]);
        bench.write(&format!("csv.{ending}"), recording_csv(0.5));
    }
    let mut names =
        vec!["missing.toml", "missing.safetensors", "missing.blob", "folder.toml", "folder.blob", "data", "model.txt", "no_ending"];
    let generated: Vec<String> = ["empty", "garbage", "csv"]
        .iter()
        .flat_map(|name| ["toml", "safetensors", "blob"].map(|ending| format!("{name}.{ending}")))
        .collect();
    names.extend(generated.iter().map(String::as_str));
    for name in names {
        bench.refuses(&format!("evaluate --model {name} --data data --json out/result.json"), &[name]);
        bench.refuses(&format!("inspect {name} --json out/result.json"), &[name]);
        bench.refuses(&format!("export {name} --calibration data --out out/model.blob"), &[name]);
    }
}

#[test]
fn a_blob_with_a_flipped_bit_or_a_missing_tail_is_refused() {
    let bench = Bench::with_models();
    let blob = bench.read("model.blob");
    // A prime stride visits every region of the blob: header, tables, weights, golden vectors, checksum.
    for position in (0..blob.len()).step_by((blob.len() / 40).max(1)) {
        let mut broken = blob.clone();
        broken[position] ^= 1 << (position % 8);
        bench.write("broken.blob", &broken);
        bench.refuses("inspect broken.blob --json out/result.json", &["broken.blob"]);
    }
    for length in [1, 4, 8, 12, blob.len() / 3, blob.len() - 1] {
        bench.write("short.blob", &blob[..length]);
        bench.refuses("inspect short.blob --json out/result.json", &["short.blob"]);
        bench.refuses("evaluate --model short.blob --data data --json out/result.json", &["short.blob"]);
    }
    bench.write("long.blob", [&blob[..], b"tail"].concat());
    bench.refuses("inspect long.blob", &["long.blob"]);
}

#[test]
fn a_blob_of_another_schema_is_refused_by_its_version() {
    let bench = Bench::with_models();
    let mut blob = bench.read("model.blob");
    // docs/reference/formats.md: version at byte 8, CRC-32 of every other byte at byte 16; a valid checksum leaves only the version to complain about.
    blob[8] += 100;
    let checksum = crc32(blob[..16].iter().chain(&blob[20..]));
    blob[16..20].copy_from_slice(&checksum.to_le_bytes());
    bench.write("newer.blob", &blob);
    for line in ["inspect newer.blob", "evaluate --model newer.blob --data data --json out/result.json"] {
        bench.refuses(line, &["newer.blob", "version"]);
    }
}

/// CRC-32 of IEEE 802.3, bit by bit.
fn crc32<'a>(bytes: impl Iterator<Item = &'a u8>) -> u32 {
    !bytes.fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 })
    })
}

#[test]
fn resuming_from_a_checkpoint_that_is_not_there_or_damaged_is_refused() {
    let bench = Bench::with_models();
    let line = "train --preset stream-1x32 --data data --out new.safetensors --epochs 1 --resume";
    bench.refuses(line, &["new.checkpoint"]);
    bench.write("new.checkpoint", [0xff; 100]);
    bench.refuses(line, &["new.checkpoint"]);
}

#[test]
fn a_training_configuration_that_makes_no_sense_is_refused() {
    let bench = Bench::with_models();
    for (text, says) in [
        ("colour = \"blue\"", "colour"),
        ("chunk = 1", "chunk"),
        ("learning_rate = nan", "learning_rate"),
        ("units = []", "units"),
        ("=", ""),
    ] {
        bench.write("bad.toml", text);
        bench.refuses("train --data data --out out/new.safetensors --config bad.toml", &["bad.toml", says]);
    }
    bench.refuses("train --data data --out out/new.safetensors --config missing.toml", &["missing.toml"]);
}

#[test]
fn a_damaged_safetensors_file_is_refused() {
    let bench = Bench::with_models();
    let model = bench.read("model.safetensors");
    for length in [4, 8, 100, model.len() / 2, model.len() - 1] {
        bench.write("short.safetensors", &model[..length]);
        bench.refuses("evaluate --model short.safetensors --data data --json out/result.json", &["short.safetensors"]);
        bench.refuses("export short.safetensors --calibration data --out out/model.blob", &["short.safetensors"]);
    }
    // A whole file of that format, with somebody else's tensor in it.
    let header = r#"{"weight":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
    let mut foreign = (header.len() as u64).to_le_bytes().to_vec();
    foreign.extend_from_slice(header.as_bytes());
    foreign.extend_from_slice(&1.0_f32.to_le_bytes());
    bench.write("foreign.safetensors", foreign);
    bench.refuses("evaluate --model foreign.safetensors --data data", &["foreign.safetensors"]);
}

#[test]
fn physics_that_makes_no_sense_is_refused() {
    let bench = Bench::with_models();
    let text = String::from_utf8(bench.read("physics.toml")).expect("TOML is text");
    bench.write("unknown_kind.toml", text.replacen("prandtl-ishlinskii", "perpetuum-mobile", 1));
    bench.refuses("evaluate --model unknown_kind.toml --data data", &["unknown_kind.toml", "perpetuum-mobile"]);
    bench.write("unknown_field.toml", format!("colour = \"blue\"\n{text}"));
    bench.refuses("evaluate --model unknown_field.toml --data data", &["unknown_field.toml", "colour"]);
    let cut = &text[..text.len() / 2];
    bench.write("cut.toml", cut);
    bench.refuses("evaluate --model cut.toml --data data", &["cut.toml"]);
}

#[test]
fn a_model_of_other_channels_than_the_data_is_refused() {
    let bench = Bench::with_models();
    bench.write("foreign.csv", recording_csv(0.5).replacen("time_s,pressure_bar,displacement_mm", "t_s,voltage_V,displacement_um", 1));
    let columns = "--columns time=t_s,input=voltage_V,output=displacement_um";
    for model in ["physics.toml", "model.safetensors", "model.blob"] {
        bench
            .refuses(&format!("evaluate --model {model} --data foreign.csv {columns} --json out/result.json"), &["foreign.csv", "voltage"]);
    }
    bench.refuses(
        &format!("export model.safetensors --calibration foreign.csv {columns} --out out/model.blob"),
        &["foreign.csv", "voltage"],
    );
}

#[test]
fn a_place_that_takes_no_result_is_refused_before_any_work() {
    let bench = Bench::with_models();
    bench.write("file", "in the way");
    let commands = [
        ("identify --data data --out OUT", "toml"),
        ("train --data data --out OUT", "safetensors"),
        ("export model.safetensors --calibration data --out OUT", "blob"),
    ];
    for (command, ending) in commands {
        let refuses = |out: &str, says: &[&str]| {
            let start = std::time::Instant::now();
            bench.refuses(&command.replace("OUT", out), says);
            // Far below any training: the place is checked first.
            assert!(start.elapsed().as_secs() < 20, "{command} worked before it refused {out}");
        };
        refuses("data", &["data"]);
        refuses("result.wrong", &["result.wrong", &format!(".{ending}")]);
        refuses(&format!("file/result.{ending}"), &["file"]);
        #[cfg(target_os = "linux")]
        refuses(&format!("/proc/nowhere/result.{ending}"), &["/proc"]);
    }
    bench.refuses("simulate paper --out file", &["file"]);
    bench.refuses("simulate paper --out file/below", &["file"]);
    bench.refuses("demo --out file", &["file"]);
    bench.refuses("evaluate --model physics.toml --data data --json data", &["data", "folder"]);
    bench.refuses("evaluate --model physics.toml --data data --json file/below.json", &["file"]);
}

#[test]
fn a_command_does_not_overwrite_what_it_reads() {
    let bench = Bench::with_models();
    bench.refuses("evaluate --model physics.toml --data data --json data/a1.csv", &["a1.csv"]);
    bench.refuses("evaluate --model physics.toml --data data --json physics.toml", &["physics.toml"]);
    for json in ["data/a1.csv", "model.safetensors"] {
        bench.refuses(&format!("export model.safetensors --calibration data --out new.blob --json {json}"), &[json]);
    }
    bench.refuses("identify --data data --out new.toml --json data/a1.csv", &["a1.csv"]);
    bench.refuses("train --data data --out new.safetensors --json data/a1.csv", &["a1.csv"]);
}

#[test]
fn unknown_names_are_refused_with_the_known_ones() {
    let bench = Bench::with_models();
    bench.refuses(
        "train --preset lstm --data data --out out/model.safetensors",
        &["lstm", "hybrid", "stream-2x64", "stream-1x32", "paper-window"],
    );
    bench.refuses("simulate papers --out out", &["papers", "paper", "rich"]);
    bench.refuses("simulate paper --plant nonsense --out out", &["nonsense", "all-effects"]);
}

#[test]
fn an_excitation_that_cannot_be_played_is_refused_with_file_and_reason() {
    let bench = Bench::new();
    let segment = |signal: &str| format!("[[segments]]\nduration_s = 20.0\nsignal = {signal}\n");
    let sine = |amplitude: &str, decay: &str| {
        segment(&format!("{{ kind = \"descending-sine\", amplitude_bar = {amplitude}, frequency_hz = 0.3, decay_per_s = {decay} }}"))
    };
    let cases: [(&str, String, &[&str]); 8] = [
        ("empty.toml", String::new(), &["segments"]),
        ("syntax.toml", "segments = [".to_owned(), &["syntax.toml"]),
        ("kind.toml", segment("{ kind = \"square\" }"), &["square"]),
        ("nan.toml", sine("nan", "0.1"), &["amplitude_bar"]),
        ("peak.toml", sine("2.0", "0.0"), &["4.000 bar", "3 bar"]),
        // The paper's test (c) taken literally: 2 A e^(0.12 x 20), reached at the last crest.
        ("ascending.toml", sine("1.5", "-0.12"), &["bar at", "ascending-sine"]),
        ("slew.toml", segment("{ kind = \"triangle\", minimum_bar = 0.0, maximum_bar = 2.0, frequency_hz = 10.0 }"), &["bar/s"]),
        ("long.toml", sine("1.0", "0.1").replace("20.0", "1e12"), &["long.toml"]),
    ];
    for (name, text, says) in cases {
        bench.write(name, text);
        let said = bench.refuses(&format!("simulate {name} --out out --json result.json"), says);
        assert!(said.stderr.contains(name), "{}", said.stderr);
    }
    bench.refuses("simulate missing.toml --out out", &["missing.toml"]);
}

#[test]
fn numbers_out_of_range_are_refused() {
    let bench = Bench::with_models();
    for budget in ["0", "-1", "NaN", "inf", "soon"] {
        bench.refuses(&format!("train --data data --out out/model.safetensors --budget-cpu-s={budget}"), &["--budget-cpu-s"]);
    }
    for seed in ["-1", "1.5", "18446744073709551616"] {
        bench.refuses(&format!("simulate paper --out out --seed={seed}"), &["--seed"]);
    }
    for threads in ["0", "-1", "1e9", "99999999"] {
        bench.refuses(&format!("train --data data --out out/model.safetensors --threads={threads}"), &["--threads"]);
    }
}
