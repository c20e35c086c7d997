//! `catheter export --c`: a model as C source.

use std::process::Command;

use crate::support::Bench;

const PROGRAM: &str = "#include <stdio.h>
#include \"NAME.h\"
int main(void)
{
    NAME_state state = {0};
    float output = NAME_step(&state, 0.5f);

    printf(\"%s to %s, %g\\n\", UPPER_INPUT_UNIT, UPPER_OUTPUT_UNIT, (double)output);
    return NAME_self_test();
}
";

/// Compiles `folder/name.c` with a program around it and runs that; `None`, and a loud message, without a compiler.
fn compiled(bench: &Bench, folder: &str, name: &str) -> Option<String> {
    if Command::new("cc").arg("--version").output().is_err() {
        eprintln!("NOT TESTED: no C compiler on this machine, {name}.c was not compiled");
        return None;
    }
    let main = PROGRAM.replace("NAME", name).replace("UPPER", &name.to_uppercase());
    bench.write(&format!("{folder}/main.c"), main);
    let define = format!("-D{}_SELF_TEST", name.to_uppercase());
    let built = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-O2", &define, "-o", "program", "main.c"])
        .arg(format!("{name}.c"))
        .current_dir(bench.path(folder))
        .output()
        .expect("the compiler starts");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let said = Command::new(bench.path(&format!("{folder}/program"))).output().expect("the program starts");
    assert!(said.status.success(), "the self-test of {name}.c ended with {}", said.status);
    Some(String::from_utf8_lossy(&said.stdout).into_owned())
}

#[test]
fn every_kind_of_model_becomes_c_that_passes_its_own_test() {
    let bench = Bench::with_models();
    for (model, more, name) in [
        ("physics.toml", "--calibration exact", "physics"),
        ("model.safetensors", "--calibration data", "network"),
        ("model.blob", "", "blob"),
    ] {
        let said = bench.works(&format!("export {model} {more} --c made/{name}.c"));
        assert!(said.stdout.contains(&format!("{name}_step")) && said.stdout.contains("-ffp-contract=off"), "{}", said.stdout);
        if let Some(printed) = compiled(&bench, "made", name) {
            assert!(printed.starts_with("bar to mm, "), "{printed}");
        }
    }
}

#[test]
fn a_model_gives_the_same_c_as_its_blob() {
    let bench = Bench::with_models();
    bench.works("export model.safetensors --calibration data --out first/model.blob --c first/model.c --json first.json");
    bench.works("export first/model.blob --c second/model.c --json second.json");
    for file in ["model.c", "model.h"] {
        assert!(bench.read(&format!("first/{file}")) == bench.read(&format!("second/{file}")), "{file} differs");
    }
    let (first, second) = (bench.json("first.json"), bench.json("second.json"));
    for key in ["bytes", "sha256", "accumulator_headroom", "output_unit"] {
        assert_eq!(first[key], second[key], "{key}");
    }
    let close = |key: &str| (first[key].as_f64().expect("a number") - second[key].as_f64().expect("a number")).abs();
    assert!(close("rmse_f32_vs_fixed") < 1e-9 && close("max_abs_f32_vs_fixed") < 1e-9);
    assert_eq!(second["c"], serde_json::json!(["second/model.c", "second/model.h"]));
    // The header says which model it is.
    let inspected = bench.works("inspect first/model.blob").stdout;
    let header = String::from_utf8(bench.read("first/model.h")).expect("C is text");
    let hash = header.split("MODEL_MODEL_SHA256 \"").nth(1).and_then(|rest| rest.split('"').next()).expect("the model's hash");
    assert!(hash.len() == 64 && inspected.contains(hash), "{hash}\n{inspected}");
}

#[test]
fn file_names_become_names_of_c() {
    let bench = Bench::with_models();
    bench.works("export model.blob --c 2x64-lab.v1.c");
    let header = String::from_utf8(bench.read("2x64-lab.v1.h")).expect("C is text");
    assert!(header.contains("float model_2x64_lab_v1_step(model_2x64_lab_v1_state *state, float input);"));
    assert!(header.contains("#ifndef MODEL_2X64_LAB_V1_H"));
    assert!(header.contains("#define MODEL_2X64_LAB_V1_SAMPLE_PERIOD_S 0.02\n"));
    let source = String::from_utf8(bench.read("2x64-lab.v1.c")).expect("C is text");
    assert!(source.contains("#include \"2x64-lab.v1.h\""));
}

#[test]
fn what_cannot_be_written_as_c_is_refused() {
    let bench = Bench::with_models();
    bench.write("file", "in the way");
    bench.write("taken.h/file", "in the way");
    bench.refuses("export model.blob", &["--out", "--c"]);
    bench.refuses("export model.blob --out other.blob", &["already a blob", "--c"]);
    bench.refuses("export model.blob --c out/model.h", &["out/model.h", ".c"]);
    bench.refuses("export model.blob --c file/model.c", &["file"]);
    bench.refuses("export model.blob --c taken.c", &["taken.h", "folder"]);
    bench.refuses("export model.blob --c out/a\"b.c", &["#include"]);
    for more in ["--calibration data", "--out other.blob", "--compensation model.blob", "--columns time=t_s"] {
        bench.refuses(&format!("export model.blob --c out/model.c {more}"), &["model.blob", "as it is"]);
    }
    bench.refuses("export model.safetensors --c out/model.c", &["--calibration"]);
    bench.refuses("export model.blob --c out/model.c --json model.blob", &["model.blob", "overwritten"]);
    let mut wrong = bench.read("model.blob");
    wrong.truncate(100);
    bench.write("wrong.blob", wrong);
    bench.refuses("export wrong.blob --c out/model.c", &["wrong.blob", "truncated"]);
}
