//! Experiments on the page: a calibration from a rig that errs to saved settings, a reference that is followed, a recording that becomes the model.

use std::time::{Duration, Instant};

use host_tool::plant::PlantConfig;
use serde_json::Value;

use crate::browser::{Browser, Look, Served};
use crate::recordings;

/// How often a step is repeated that a busy machine spoiled.
const ATTEMPTS: u32 = 5;
/// The longest step plays for 20 s of the rig's own time, and the simulation may be slower than real time.
const STEP_WITHIN: Duration = Duration::from_secs(120);
/// Identification takes seconds of processor time, of which a busy machine has few to spare.
const COMPUTED_WITHIN: Duration = Duration::from_secs(900);
/// Where the tip of the default rig gets below its ceiling, and leaves its rest, mm.
const REACH_MM: [f64; 2] = [0.4, 2.0];

fn quantity(calibration: &Value, name: &str) -> f64 {
    let findings = calibration["steps"].as_array().into_iter().flatten();
    let all = findings.flat_map(|step| step["finding"]["quantities"].as_array().into_iter().flatten());
    let found = all.into_iter().find(|quantity| quantity["name"] == name).unwrap_or_else(|| panic!("{name} is missing: {calibration}"));
    found["value"].as_f64().expect("a value")
}

/// Does a step as a person does: begins it, answers what it asks, takes what it finds. `picture` is made at the second question.
async fn step(browser: &Browser, served: &Served, name: &str, picture: Option<&str>) {
    for attempt in 1..=ATTEMPTS {
        let ready = format!(
            "const it = document.querySelector('#calibrate-steps button.begin[data-step={name}]'); return Boolean(it) && !it.disabled"
        );
        browser.until(name, &ready).await;
        browser.run(&format!("document.querySelector('#calibrate-steps button.begin[data-step={name}]').click()")).await;
        let (begun, mut answered, mut last) = (Instant::now(), 0, String::new());
        let state = loop {
            let state = browser.run(&format!("return document.querySelector('#calibrate-steps li[data-step={name}]').className")).await;
            if let Some(state) =
                state.as_str().and_then(|class| class.strip_prefix("step ")).filter(|state| ["found", "failed"].contains(state))
            {
                break state.to_owned();
            }
            assert!(begun.elapsed() < STEP_WITHIN, "{name} does not end; the page says: {}", browser.said().await);
            let asks = browser.run("const it = document.getElementById('calibrate-ask'); return it.hidden || it.closest('[hidden]') ? '' : document.getElementById('calibrate-question').textContent").await;
            let asks = asks.as_str().unwrap_or_default().to_owned();
            if !asks.is_empty() && asks != last {
                answered += 1;
                if let (2, Some(picture)) = (answered, picture) {
                    browser.run("document.getElementById('tab-calibrate').scrollIntoView()").await;
                    browser.picture(picture).await;
                }
                browser.click("calibrate-go").await;
            }
            last = asks;
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        if state == "found" {
            browser.click("calibrate-accept").await;
            browser
                .until(
                    "it is in use",
                    &format!("return document.querySelector('#calibrate-steps li[data-step={name}]').className === 'step taken'"),
                )
                .await;
            return;
        }
        let told = served.api("/api/calibration");
        let problem = told["steps"].as_array().expect("steps").iter().find(|step| step["name"] == name).map(|step| step["problem"].clone());
        println!("{name}, attempt {attempt}: {problem:?}");
        browser.until("no task", "return document.getElementById('calibrate-run').hidden").await;
        browser.run("const it = document.getElementById('acknowledge'); if (!it.disabled) it.click()").await;
    }
    panic!("the step {name} has no result");
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_rig_that_errs_is_calibrated_on_the_page_from_zero_to_saved_settings() {
    let files = tempfile::tempdir().expect("a temporary folder");
    let hardware = files.path().join("rig.toml");
    let errors = "rest_mm = 3.0\n[laser]\nzero = 0.4\ngain = 1.07\n[pressure]\nzero = 0.05\ngain = 0.95\n\
                  [valve]\ndead_band_share = 0.05\nhysteresis_share = 0.005\ngain = 1.04\n";
    std::fs::write(&hardware, errors).expect("a file");
    let served = Served::start(&["--hardware", hardware.to_str().expect("a path")]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.be_patient().await;
    browser.click("settings-save").await;
    browser.click("tab-calibrate").await;
    let explained = browser.text("calibrate-steps").await;
    assert!(explained.contains("THE RIG IS PRESSURISED") && explained.contains("THE RIG JUMPS"), "{explained}");
    for (name, picture) in
        [("noise", None), ("laser", None), ("pressure", Some("dashboard-calibrate.png")), ("valve", None), ("response", None)]
    {
        step(&browser, &served, name, picture).await;
    }
    let told = served.api("/api/calibration");
    let near = |name: &str, truth: f64, tolerance: f64| {
        let value = quantity(&told, name);
        println!("{name}: {value}, {truth} in truth");
        assert!((value - truth).abs() <= tolerance, "{name} is {value}, and {truth} in truth");
    };
    // Zeros within a thousandth of the spans of 20 mm and 6 bar, gains within half a per cent.
    near("laser zero", 0.4, 0.001 * 20.0);
    near("laser span", 1.07, 0.005 * 1.07);
    near("pressure zero", 0.05, 0.001 * 6.0);
    near("pressure span", 0.95, 0.005 * 0.95);
    near("valve dead band", 0.05, 0.1 * 0.05);
    // A step can be repeated; its finding takes the place of the first.
    step(&browser, &served, "laser", None).await;
    let told = served.api("/api/calibration");
    let (zero_mm, gain) = (quantity(&told, "laser zero"), quantity(&told, "laser span"));
    assert!(zero_mm.abs() <= 0.001 * 20.0 && (gain - 1.0).abs() <= 0.005, "left after the first: {zero_mm} mm and {gain}");

    let changes = browser.text("calibrate-changes").await;
    assert!(
        changes.contains("laser.low_mm") && changes.contains("pressure.low_bar") && changes.contains("valve.full_scale_bar"),
        "{changes}"
    );
    browser.click("calibrate-save").await;
    browser.click("calibrate-print").await;
    browser.until("the page", "return !document.getElementById('calibrate-link').hidden").await;
    browser.run("document.getElementById('calibrate-result').scrollIntoView({ block: 'end' })").await;
    browser.look("calibrated.png").await;
    let settings = served.api("/api/settings");
    for setting in settings["settings"].as_array().expect("settings") {
        assert_eq!(setting["value"], setting["saved"], "{setting}");
    }
    // Vented after the last step, the tip keeps what its play operators hold, by the laser as it is now understood.
    let plant = PlantConfig::default();
    let held_mm: f64 = plant.thresholds_bar.iter().zip(&plant.weights_mm_per_bar).map(|(threshold, weight)| threshold * weight).sum();
    let rest_mm = served.api("/api/samples?last=1")["displacement_mm"][0].as_f64().expect("a displacement");
    println!("at rest: {rest_mm} mm, {} in truth", 3.0 + held_mm);
    assert!((rest_mm - 3.0 - held_mm).abs() < 0.05, "{rest_mm} mm at rest");
    let link = browser.run("return document.getElementById('calibrate-link').href").await;
    browser.client.goto(link.as_str().expect("an address")).await.expect("the page opens");
    let page = browser.run("return document.body.textContent").await;
    let page = page.as_str().expect("text");
    assert!(page.contains("Saved: the device starts with them") && page.contains("laser span") && page.contains('\u{b1}'), "{page}");
    assert!(browser.run("return document.querySelectorAll('svg').length").await.as_u64().expect("a number") >= 5, "curves");
}

/// Begins to follow point to point between two displacements, mm.
async fn begin_to_follow(browser: &Browser, controller: &str, [low_mm, high_mm]: [f64; 2]) {
    browser.click("tab-reference").await;
    let script = format!(
        "const put = (id, value, kind) => {{ const it = document.getElementById(id); it.value = value; it.dispatchEvent(new Event(kind)); }};
         put('reference-controller', '{controller}', 'change'); put('reference-low', {low_mm}, 'input'); put('reference-high', {high_mm}, 'input');
         put('reference-name', 'point-to-point', 'change')"
    );
    browser.run(&script).await;
    browser.until("the reference", "return document.getElementById('reference-verdict').textContent.includes('21.0 s')").await;
    browser.click("reference-go").await;
    browser.until_state("running").await;
    assert_eq!(browser.run("return document.getElementById('arm').disabled").await, true, "what runs is not disturbed");
}

/// What the page was told of the reference that has ended.
async fn followed(browser: &Browser, served: &Served) -> Value {
    let begun = Instant::now();
    while browser.text("now-state").await != "idle" {
        assert!(begun.elapsed() < STEP_WITHIN, "it does not end; the page says: {}", browser.said().await);
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    browser.until("no task", "return document.getElementById('reference-run').hidden").await;
    let followed = served.api("/api/controllers")["followed"].clone();
    println!("{followed}");
    followed
}

fn number(figures: &Value, name: &str) -> f64 {
    figures[name].as_f64().unwrap_or_else(|| panic!("{name} is missing: {figures}"))
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_reference_is_followed_and_the_error_told() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.be_patient().await;
    browser.click("tab-reference").await;
    browser.until("the reference", "return document.getElementById('reference-verdict').textContent.includes('21.0 s')").await;
    // What is offered lies within what the tip reaches, 0.20 to 2.80 mm; what lies beyond is refused before it plays.
    assert_eq!(
        browser.run("return ['low', 'high'].map((end) => document.getElementById(`reference-${end}`).value).join()").await,
        "0.5,2.5"
    );
    browser.until("it can be followed", "return !document.getElementById('reference-go').disabled").await;
    browser.run("const it = document.getElementById('reference-high'); it.value = 5; it.dispatchEvent(new Event('input'))").await;
    browser.until("the reach", "return document.getElementById('reference-verdict').textContent.includes('from 0.20 to 2.80 mm')").await;
    assert_eq!(browser.run("return document.getElementById('reference-go').disabled").await, true);
    // A reference upside down is none.
    browser.run("const it = document.getElementById('reference-high'); it.value = 0; it.dispatchEvent(new Event('input'))").await;
    browser.until("the refusal", "return document.getElementById('reference-verdict').textContent.includes('below the highest')").await;
    assert_eq!(browser.run("return document.getElementById('reference-go').disabled").await, true);
    browser.run("const it = document.getElementById('reference-high'); it.value = 2; it.dispatchEvent(new Event('input'))").await;
    // Without a model this one is refused, with the reason.
    browser.run("document.getElementById('reference-controller').value = 'physics-inverse'").await;
    browser.click("reference-go").await;
    browser.until("the reason", "return document.getElementById('reference-outcome').textContent.includes('does not arm')").await;
    // The linear map is made for a rig of 4 mm/bar, and this one has 1 mm/bar: the error tells. Ended by hand, it says so.
    begin_to_follow(&browser, "open-loop", REACH_MM).await;
    served.pass(7.0).await;
    browser.click("reference-end").await;
    browser.until("the end", "return document.getElementById('reference-outcome').textContent.includes('it was vented')").await;
    let wrong = followed(&browser, &served).await;
    assert!(number(&wrong, "rmse_mm") > 0.6 && (0.1..0.9).contains(&number(&wrong, "share")), "{wrong}");
    browser.set("control.linear_mm_per_bar", 1.0, 2).await;
    begin_to_follow(&browser, "open-loop", REACH_MM).await;
    served.pass(12.0).await;
    browser.picture("dashboard-reference.png").await;
    let right = followed(&browser, &served).await;
    assert!(right["problem"].is_null() && right["share"] == 1.0 && right["controller"] == "open-loop", "{right}");
    // The loop is 0.2 mm to either side of the map.
    assert!((0.02..0.25).contains(&number(&right, "rmse_mm")) && number(&right, "output_span_bar") > 1.0, "{right}");
    let shown = format!("{:.3} mm from the reference", number(&right, "rmse_mm"));
    browser.until(&shown, &format!("return document.getElementById('reference-outcome').textContent.includes('{shown}')")).await;
    let settings = served.api("/api/settings");
    for name in ["control.sensor", "control.feed_forward"] {
        let setting = settings["settings"].as_array().expect("settings").iter().find(|setting| setting["name"] == name);
        let setting = setting.unwrap_or_else(|| panic!("{name} is missing"));
        assert_eq!(setting["value"], setting["saved"], "the controller was for the reference only");
    }
}

/// Plays the excitation that is loaded, to its end.
async fn play(browser: &Browser) {
    browser.arm_and_start().await;
    let begun = Instant::now();
    while browser.text("now-state").await != "idle" {
        assert!(begun.elapsed() < STEP_WITHIN, "it does not end; the page says: {}", browser.said().await);
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_recording_that_somebody_has_is_loaded_and_computed_on() {
    let served = Served::start(&[]);
    // The lab's own recordings have other columns; those of the page have ours all the same.
    std::fs::write(served.folder.path().join("catheter.toml"), "[recordings]\ncolumns = \"time=t:ms,input=P:kPa,output=x:um\"\n")
        .expect("a file");
    let rows: String = (0..400_u32).map(|row| format!("{};{};{}\n", 20 * row, 50 + row % 100, 300 + 3 * (row % 100))).collect();
    let (good, bad) = (served.folder.path().join("day 1.csv"), served.folder.path().join("bad.csv"));
    std::fs::write(&good, format!("Zeit (ms);Druck (kPa);Weg (um)\n{rows}")).expect("a file");
    std::fs::write(&bad, format!("Zeit (ms);Druck (kPa);Weg (um)\n{}", rows.replacen("60;", "60;much", 1))).expect("a file");
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.click("tab-learn").await;
    browser.until("the role", "return !document.getElementById('load-file').disabled").await;
    let choose = async |file: &std::path::Path, said: &str| {
        let input = browser.client.find(fantoccini::Locator::Id("load-file")).await.expect("a place for files");
        input.send_keys(&file.display().to_string()).await.expect("a file");
        browser.until(said, &format!("return document.getElementById('load-said').textContent.includes(\"{said}\")")).await;
    };
    choose(&good, "there is no column").await;
    browser.run("document.getElementById('load-columns').value = 'time=Zeit (ms):ms,input=Druck (kPa):kPa,output=Weg (um):um'").await;
    choose(&bad, "bad.csv:5:").await;
    choose(&good, "day-1: 400 samples, 8.0 s.").await;
    let said = browser.text("load-said").await;
    assert!(said.contains("is converted from kPa into bar"), "{said}");
    browser.run("document.getElementById('load-said').scrollIntoView({ block: 'center' })").await;
    browser.look("loaded.png").await;
    let row = "const it = document.querySelector('#recordings input'); return `${it.checked} ${it.closest('tr').textContent}`";
    let row = browser.run(row).await;
    assert!(row.as_str().is_some_and(|row| row.starts_with("true day-1loaded from day 1.csv")), "{row}");
    browser.press("Check: what is in them").await;
    browser.until("the check", "return document.getElementById('job-title').textContent === 'check of day-1: done'").await;
    browser.until("its report", "return !document.getElementById('job-report').hidden").await;
    let text = std::fs::read_to_string(served.folder.path().join("sessions/day-1.csv")).expect("the recording");
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].contains("from day 1.csv, sha256 "), "{}", lines[0]);
    assert_eq!(lines[1..4], ["time_s,pressure_bar,displacement_mm", "0,0.5,0.3", "0.02,0.51,0.303"]);

    // Everything that can be computed of a recording, of a short one.
    let actuator = served.folder.path().join("actuator.csv");
    std::fs::write(&actuator, recordings::actuator(14, 0.02)).expect("a file");
    browser.run("document.getElementById('load-columns').value = ''").await;
    choose(&actuator, "actuator: 700 samples, 14.0 s.").await;
    browser.run("document.querySelector('[aria-label=\"Use day-1\"]').click()").await;
    let begun = Instant::now();
    for (title, kind, heading) in [
        ("Identify: play operators", "identify", "A physics model"),
        ("Discover: what the simulation lacks", "discover", "Which effect does the simulation lack?"),
        ("Fit: the ladder of models", "ladder", "Which model to use"),
        ("Tune: controllers", "tune", "A controller from recordings"),
    ] {
        browser.press(title).await;
        computed(&browser, &format!("{kind} of actuator: done")).await;
        browser.until("its report", "return !document.getElementById('job-report').hidden").await;
        // Embedded, it is the same page, its buttons with it.
        let frame = browser.client.find(fantoccini::Locator::Id("job-report")).await.expect("a frame");
        frame.enter_frame().await.expect("the report opens");
        let whole = format!("return document.querySelector('h1')?.textContent === '{heading}' && document.readyState === 'complete'");
        let opened = Instant::now();
        while browser.run(&whole).await != true {
            assert!(opened.elapsed() < STEP_WITHIN, "{kind}: {}", browser.run("return document.body.textContent.slice(0, 300)").await);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let parts =
            browser.run("return [document.querySelectorAll('figure svg').length, document.querySelectorAll('.tools button').length]").await;
        assert!(parts[0].as_u64() > Some(0) && parts[1].as_u64() > Some(2), "{kind}: {parts} drawings and buttons");
        browser.client.clone().enter_parent_frame().await.expect("the page again");
        println!("{kind}: done {:.1} s after the first began", begun.elapsed().as_secs_f64());
    }
    browser.run("document.getElementById('job-title').scrollIntoView({ block: 'start' })").await;
    browser.look("tuned.png").await;
    // What tuning found goes to the device, its settings with it.
    browser.click("job-use").await;
    browser.until("the model", "return document.getElementById('identity').textContent.includes(' model ')").await;
    let told = served.api("/api/settings");
    let settings = told["settings"].as_array().expect("settings").iter();
    let changed = settings.filter(|setting| {
        setting["name"].as_str().is_some_and(|name| name.starts_with("control.")) && setting["value"] != setting["default"]
    });
    assert!(changed.count() >= 2, "the settings that belong to the controller");
    // What takes long tells how far it is, and ends when somebody wants that: of ten minutes the ladder takes many seconds on any machine.
    let long = served.folder.path().join("long.csv");
    std::fs::write(&long, recordings::actuator(600, 0.0004)).expect("a file");
    choose(&long, "long: 30000 samples, 600.0 s.").await;
    browser.run("document.querySelector('[aria-label=\"Use actuator\"]').click()").await;
    browser.run("document.getElementById('jobs-kinds').scrollIntoView({ block: 'center' })").await;
    browser.press("Fit with networks: minutes").await;
    // Two states of its own lines, one with progress.
    let moves = "if (document.getElementById('job-title').textContent !== 'fit of long: running') return false;
                 const now = document.getElementById('job-lines').textContent; window.first ||= now;
                 return now !== window.first && now.includes('% physics rungs')";
    browser.until_within(COMPUTED_WITHIN, "progress", moves).await;
    println!("progress: {}", browser.text("job-lines").await.lines().last().unwrap_or_default());
    browser.click("job-end").await;
    computed(&browser, "fit of long: ended").await;
    assert_eq!(browser.run("return document.getElementById('job-use').hidden").await, true, "what was ended made no model");
}

/// Waits until what is computed has ended as wanted.
async fn computed(browser: &Browser, wanted: &str) {
    let begun = Instant::now();
    loop {
        let title = browser.text("job-title").await;
        if title == wanted {
            return;
        }
        let ended =
            ["done", "ended", "exit code"].iter().any(|end| title.contains(end)) && title.split(' ').next() == wanted.split(' ').next();
        assert!(!ended && begun.elapsed() < COMPUTED_WITHIN, "{title}: {}", browser.text("job-lines").await);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_recording_made_just_now_becomes_the_model_on_the_device_by_two_clicks() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.be_patient().await;
    browser.click("tab-excitation").await;
    browser.until("the verdict", "return document.getElementById('excitation-verdict').textContent.startsWith('Within the limits')").await;
    // Half of what is offered: the rest of it is only smaller.
    browser.run("const it = document.getElementById('excitation-duration'); it.value = 10; it.dispatchEvent(new Event('input'))").await;
    browser.until("the verdict", "return document.getElementById('excitation-verdict').textContent.includes('500 points')").await;
    browser.click("excitation-load").await;
    browser.click("tab-learn").await;
    browser.run("document.getElementById('record-name').value = 'first'").await;
    browser.click("record").await;
    browser.until("the recording", "return document.getElementById('record').textContent === 'End recording'").await;
    play(&browser).await;
    browser.click("record").await;
    browser.until("the list", "return Boolean(document.querySelector('#recordings input'))").await;
    browser.run("document.querySelector('#recordings input').click()").await;
    browser.press("Identify: play operators").await;
    let begun = Instant::now();
    while !browser.text("job-title").await.ends_with("done") {
        let title = browser.text("job-title").await;
        assert!(begun.elapsed() < COMPUTED_WITHIN && !title.contains("exit code"), "{title}: {}", browser.text("job-lines").await);
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    assert!(!browser.text("job-lines").await.is_empty(), "what it says is shown");
    browser.click("job-use").await;
    browser.until("the model", "return document.getElementById('identity').textContent.includes(' model ')").await;
    assert!(served.api("/api/state")["identity"]["model_id"].is_string());
    play(&browser).await;
    let samples = served.api("/api/samples?last=60000");
    browser.until("the residual", "return !document.getElementById('chart-residual').hidden").await;
    browser.run("document.getElementById('job-title').scrollIntoView({ block: 'center' })").await;
    browser.look("learn.png").await;
    let column = |name: &str| samples[name].as_array().expect("a column").iter().map(Value::as_f64).collect::<Vec<_>>();
    let errors: Vec<f64> = column("displacement_mm")
        .into_iter()
        .zip(column("estimate_mm"))
        .zip(samples["state"].as_array().expect("a column"))
        .filter(|(_, state)| **state == "running")
        .filter_map(|((laser, estimate), _)| Some(laser? - estimate?))
        .collect();
    let rmse_mm = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
    println!("estimate beside the laser: {rmse_mm:.4} mm RMSE over {} samples", errors.len());
    assert!(errors.len() > 500 && rmse_mm < 0.05, "{rmse_mm} mm over {} samples", errors.len());
}
