//! Whatever comes over the line, the parser answers with a message or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use model_export::link::{fuzzing, frame, parse_anything};

fuzz_target!(|bytes: &[u8]| {
    parse_anything(bytes);
    // Random bytes seldom carry a right checksum: the same ones again behind it.
    if let Ok(wire) = frame::encode(bytes) {
        parse_anything(&wire);
    }
    // And as a script of what a bad line does to sound frames.
    let _ = fuzzing::carry_out(bytes);
});
