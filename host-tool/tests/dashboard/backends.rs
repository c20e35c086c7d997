//! The firmware as ARM code behind the dashboard, operated by a script: in the emulator, and as the flashable image on the model of its chip.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::browser::Served;

/// ARM code on a busy machine runs at a tenth of real time.
const WITHIN: Duration = Duration::from_secs(120);

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < WITHIN, "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Opens the backend with the image that a variable names; holds a pressure there, and vents.
fn operate(backend: &str, image: &str, board: &str) {
    let image = std::env::var(image).unwrap_or_else(|_| panic!("{image} names the image; `cargo xtask test` sets it"));
    let served = Served::start(&["--backend", backend, "--image", &image]);
    // Whoever asks is answered before a slow rig is open.
    let first = served.api("/api/state");
    assert!(backend != "board-model" || first["problem"] == "connecting", "{first}");
    println!("{backend}: answers after {} ms", served.begun.elapsed().as_millis());
    let state = |name: &str| served.api("/api/state")["rig"][name].clone();
    until("the rig", || state("phase") == "idle");
    println!("{backend}: open after {} ms, at {} of real time", served.begun.elapsed().as_millis(), state("speed"));
    let identity = served.api("/api/state")["identity"].clone();
    assert_eq!((&identity["board"], &identity["simulated"]), (&json!(board), &json!(true)));

    let lease = served.post("/api/lease", "", &Value::Null)["lease"].as_str().expect("a lease").to_owned();
    let act = |action: Value| {
        let answer = served.post("/api/act", &lease, &action);
        assert!(answer["error"].is_null(), "{action}: {answer}");
    };
    act(json!({ "do": "set", "name": "limits.host_timeout_ms", "value": 3000 }));
    act(json!({ "do": "arm", "mode": "pressure" }));
    act(json!({ "do": "start", "value": 0.8 }));
    let pressure = || served.api("/api/samples?last=1")["pressure_bar"][0].as_f64().unwrap_or(0.0);
    until("the pressure", || {
        served.post("/api/lease/renew", &lease, &Value::Null);
        pressure() > 0.75
    });
    act(json!({ "do": "vent" }));
    until("rest", || state("phase") == "idle" && pressure() < 0.1);
    println!("{backend}: held and vented after {} ms, at {} of real time", served.begun.elapsed().as_millis(), state("speed"));
}

#[test]
#[ignore = "needs the emulator and the image `pil`: `cargo xtask test`"]
fn a_script_operates_the_firmware_in_the_emulator() {
    operate("qemu", "CATHETER_PIL_IMAGE", "qemu");
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn a_script_operates_the_image_on_the_model_of_its_chip() {
    operate("board-model", "CATHETER_RIG_IMAGE", "custom-f405");
}
