//! Compiling generated C with the compilers of this machine, and running it.

use std::fmt;
use std::path::Path;
use std::process::{Command, Output};

/// Reads words, whether to reset first and the bits of a sample's values; writes pairs, held samples and the bits of the estimate. A state
/// is full of rubbish before each reset but the first, where it is all zeros.
const PROGRAM: &str = r#"
#include <stdio.h>
#include <string.h>
#include "model.h"

static model_state state;

int main(void)
{
    uint32_t record[1 + MODEL_INPUTS];
    uint32_t answer[2];
    float inputs[MODEL_INPUTS];
    union {
        float value;
        uint32_t bits;
    } number;
    int wrong = model_self_test();

    if (wrong != 0) {
        fprintf(stderr, "self-test: sample %d\n", wrong);
        return 1;
    }
    while (fread(record, sizeof record, 1, stdin) == 1) {
        if (record[0] != 0u) {
            memset(&state, 0xA5, sizeof state);
            model_reset(&state);
        }
        memcpy(inputs, record + 1, sizeof inputs);
#if MODEL_INPUTS == 1
        number.value = model_step(&state, inputs[0]);
#else
        number.value = model_step(&state, inputs);
#endif
        answer[0] = state.held_samples;
        answer[1] = number.bits;
        if (fwrite(answer, sizeof answer, 1, stdout) != 1) {
            return 2;
        }
    }
    return 0;
}
"#;

/// Nothing of what a careful reader would complain about.
const STRICT: &[&str] = &["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"];

/// One compiler with one set of options.
#[derive(Clone, Debug)]
pub struct Build {
    compiler: &'static str,
    options: Vec<&'static str>,
    is_slow: bool,
}

impl fmt::Display for Build {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {}", self.compiler, self.options.join(" "))
    }
}

/// Every build this machine can make, the strictest first; `None`, and a loud message, without any C compiler.
pub fn builds() -> Option<Vec<Build>> {
    let mut seen = Vec::new();
    let mut builds = Vec::new();
    for compiler in ["cc", "gcc", "clang"] {
        // The same compiler under another name is no second one. Its first word is its name.
        let Some(version) =
            output(Command::new(compiler).arg("--version")).map(|text| text.split_once(' ').map(|(_, rest)| rest.to_owned()))
        else {
            continue;
        };
        if seen.contains(&version) {
            continue;
        }
        seen.push(version);
        let with =
            |first: &[&'static str], second: &[&'static str], is_slow| Build { compiler, options: [first, second].concat(), is_slow };
        builds.push(with(STRICT, &["-O2"], false));
        builds.push(with(STRICT, &["-O0"], true));
        // All that a compiler may do to floating point without being told to be inexact.
        builds.push(with(&["-std=gnu11", "-O3"], &["-march=native", "-ffp-contract=fast"], false));
        builds.push(with(STRICT, &["-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all"], true));
    }
    builds.retain(|build| {
        let works = build.works();
        if !works {
            eprintln!("NOT TESTED: this machine cannot build with {build}");
        }
        works
    });
    if builds.is_empty() {
        eprintln!("NOT TESTED: no C compiler (cc, gcc, clang) on this machine, the generated C was neither compiled nor run");
        return None;
    }
    Some(builds)
}

fn output(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

impl Build {
    /// Whether it takes much longer than the others to run.
    pub fn is_slow(&self) -> bool {
        self.is_slow
    }

    /// Whether a program of nothing can be built and run.
    fn works(&self) -> bool {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (source, program) = (folder.path().join("nothing.c"), folder.path().join("nothing"));
        std::fs::write(&source, "int main(void)\n{\n    return 0;\n}\n").expect("the source");
        let built = Command::new(self.compiler).args(&self.options).arg(source).arg("-o").arg(&program).output();
        built.is_ok_and(|built| built.status.success()) && Command::new(program).status().is_ok_and(|status| status.success())
    }

    fn compile(&self, folder: &Path, more: &[&str]) -> Output {
        std::fs::write(folder.join("main.c"), PROGRAM).expect("the program around the model");
        let mut command = Command::new(self.compiler);
        command.args(&self.options).args(more).args(["-DMODEL_SELF_TEST", "model.c", "main.c", "-o", "program"]);
        command.current_dir(folder).output().expect("the compiler starts")
    }

    fn compiled(&self, folder: &Path) -> Command {
        let said = self.compile(folder, &[]);
        assert!(said.status.success(), "{self}:\n{}", String::from_utf8_lossy(&said.stderr));
        Command::new(folder.join("program"))
    }

    /// Compiles the model in `folder` and runs the script: held samples and the bits of the estimate, for every sample.
    pub fn run(&self, folder: &Path, script: &[u8]) -> Vec<(u32, u32)> {
        let path = folder.join("script");
        std::fs::write(&path, script).expect("the script");
        let input = std::fs::File::open(path).expect("the script");
        let said = self.compiled(folder).stdin(input).output().expect("the program starts");
        assert!(said.status.success(), "{self}: {}", String::from_utf8_lossy(&said.stderr));
        let pairs = said.stdout.as_chunks::<4>().0.as_chunks::<2>().0.iter();
        pairs.map(|[held, bits]| (u32::from_ne_bytes(*held), u32::from_ne_bytes(*bits))).collect()
    }

    /// Whether the compiled model's own test finds a fault.
    pub fn fails_its_self_test(&self, folder: &Path) -> bool {
        let said = self.compiled(folder).output().expect("the program starts");
        !said.status.success() && String::from_utf8_lossy(&said.stderr).contains("self-test")
    }

    /// What the compiler says to a source that it must refuse with one option more.
    pub fn refused_with(&self, folder: &Path, option: &str) -> String {
        let said = self.compile(folder, &[option]);
        assert!(!said.status.success(), "{self} took {option}");
        String::from_utf8_lossy(&said.stderr).into_owned()
    }
}
