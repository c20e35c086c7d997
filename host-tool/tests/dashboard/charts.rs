//! The charts as a hand uses them: held still, zoomed, moved, read off; and what is marked on them.

use std::time::{Duration, Instant};

use fantoccini::actions::{Actions, InputSource, KeyAction, KeyActions, MOUSE_BUTTON_LEFT, MouseActions, PointerAction};
use serde_json::Value;

use crate::browser::{Browser, Look, Served};
use crate::numbers;

const SHIFT: char = '\u{e008}';
/// Bits of the notices: the output was held back by ceiling or floor, or by the slew limit.
const LIMITS: u64 = 1 << 1 | 1 << 2;
const SLEW: u64 = 1 << 3;

/// Where a chart draws, in the window: left, top, width and height.
async fn area(browser: &Browser, chart: &str) -> [f64; 4] {
    let script = format!(
        "const box = document.querySelector('#{chart} .u-over').getBoundingClientRect(); return [box.left, box.top, box.width, box.height]"
    );
    let found = browser.run(&script).await;
    std::array::from_fn(|nth| found[nth].as_f64().expect("a number"))
}

async fn perform(browser: &Browser, actions: impl Into<Actions>) {
    browser.client.perform_actions(actions).await.expect("a hand moves");
}

fn to(x: f64, y: f64) -> PointerAction {
    PointerAction::MoveTo { duration: Some(Duration::ZERO), x, y }
}

/// What stands below a chart for the place under the pointer: the time, then each curve.
async fn read(browser: &Browser, chart: &str) -> Vec<f64> {
    let script = format!(
        "const done = arguments[arguments.length - 1];
         requestAnimationFrame(() => requestAnimationFrame(() =>
           done([...document.querySelectorAll('#{chart} .u-legend .u-value')].map((it) => parseFloat(it.textContent)))))"
    );
    let found = browser.client.execute_async(&script, Vec::new()).await.expect("what the chart tells");
    found.as_array().expect("values").iter().map(|value| value.as_f64().unwrap_or(f64::NAN)).collect()
}

/// What a chart tells at a share of its width.
async fn at(browser: &Browser, chart: &str, share: f64) -> Vec<f64> {
    let [left, top, width, height] = area(browser, chart).await;
    perform(browser, MouseActions::new("mouse".into()).then(to(left + share * width, top + height / 2.0))).await;
    read(browser, chart).await
}

/// The times at the ends of the charts.
async fn ends(browser: &Browser) -> [f64; 2] {
    let (near, far) = (at(browser, "chart-pressure", 0.1).await[0], at(browser, "chart-pressure", 0.9).await[0]);
    let span = (far - near) / 0.8;
    [near - 0.1 * span, near + 0.9 * span]
}

/// Drags across a share of the width, with the Shift key or without.
async fn drag(browser: &Browser, [from, until]: [f64; 2], shift: bool) {
    let [left, top, width, height] = area(browser, "chart-pressure").await;
    let (y, pause) = (top + height / 2.0, KeyAction::Pause { duration: Duration::ZERO });
    let mouse = MouseActions::new("mouse".into())
        .then(to(left + from * width, y))
        .then(PointerAction::Down { button: MOUSE_BUTTON_LEFT })
        .then(to(left + until * width, y))
        .then(PointerAction::Up { button: MOUSE_BUTTON_LEFT });
    if shift {
        let keys = KeyActions::new("keys".into()).then(KeyAction::Down { value: SHIFT });
        let keys = keys.then(pause.clone()).then(pause.clone()).then(pause).then(KeyAction::Up { value: SHIFT });
        perform(browser, Actions::from(keys).and(mouse)).await;
    } else {
        perform(browser, mouse).await;
    }
}

/// Shares of the width at which a chart's marks of a colour begin and end: in the row of a strip, or halfway up.
pub async fn marked(browser: &Browser, colour: &str, row: &str) -> Option<[f64; 2]> {
    let script = format!(
        "const canvas = document.querySelector('#chart-pressure canvas'); const over = document.querySelector('#chart-pressure .u-over');
         const [own, part] = [canvas.getBoundingClientRect(), over.getBoundingClientRect()]; const scale = canvas.width / own.width;
         const probe = document.createElement('i'); probe.style.color = 'var(--{colour})'; document.body.append(probe);
         const wanted = getComputedStyle(probe).color.match(/\\d+/g).map(Number); probe.remove();
         const [left, width] = [Math.round((part.left - own.left) * scale), Math.round(part.width * scale)];
         const row = Math.round((part.top - own.top + {row}) * scale);
         const data = canvas.getContext('2d').getImageData(left, row, width, 1).data;
         const found = [];
         for (let x = 0; x < width; x += 1) if (data[4 * x + 3] > 200 && wanted.every((value, nth) => Math.abs(value - data[4 * x + nth]) < 24)) found.push(x);
         return found.length ? [found[0] / width, (found.at(-1) + 1) / width] : null"
    );
    let found = browser.run(&script).await;
    Some([found.get(0)?.as_f64()?, found.get(1)?.as_f64()?])
}

/// First and last time, s, between two times, of samples that a column of numbers marks.
fn times(samples: &Value, column: &str, [from, to]: [f64; 2], is_marked: impl Fn(u64) -> bool) -> Option<[f64; 2]> {
    let marks = samples[column].as_array().expect("a column").iter().map(|value| value.as_u64().expect("a number"));
    let marked = numbers(samples, "time_ms").into_iter().map(|time| time / 1000.0).zip(marks);
    let mut found = marked.filter(|(time, mark)| (from..=to).contains(time) && is_marked(*mark)).map(|(time, _)| time);
    let first = found.next()?;
    Some([first, found.last().unwrap_or(first)])
}

/// The marks of a colour stand at the times that the samples say.
async fn marks_agree(browser: &Browser, [from, to]: [f64; 2], colour: &str, row: &str, truth: [f64; 2]) {
    let shares = marked(browser, colour, row).await.unwrap_or_else(|| panic!("no mark in {colour}, and {truth:?} s in the samples"));
    for (share, time) in shares.into_iter().zip(truth) {
        let drawn = from + share * (to - from);
        // Two places of a hundred in the width.
        assert!((drawn - time).abs() < 0.02 * (to - from), "{colour}: drawn at {drawn:.3} s, and {time:.3} s in truth");
    }
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn curves_are_held_still_zoomed_moved_and_read_and_limits_are_marked() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.be_patient().await;
    // The linear map asks for 5 bar at 20 mm, and the ceiling is 3 bar.
    browser.set("control.feed_forward", 1.0, 2).await;
    browser.run("document.querySelector('input[name=mode][value=displacement]').click()").await;
    browser.run("const it = document.getElementById('window'); it.value = '5'; it.dispatchEvent(new Event('change'))").await;
    browser.arm_and_start().await;
    // A full window: left of the device's start the crosshair has nothing to stand on.
    served.reach(3.5).await;
    served.pass(0.5).await;
    let (whole, samples) = limiter_at_work(&browser, &served).await;

    // Held still while time goes on, and marked where the limiter was at work.
    assert_eq!(browser.text("pause").await, "Live");
    served.reach(whole[1] + 0.4).await;
    let again = ends(&browser).await;
    assert!((whole[1] - again[1]).abs() < 0.001, "{whole:?} and {again:?} s");
    assert!((whole[1] - whole[0] - 5.0).abs() < 0.05, "{whole:?} s in a window of 5 s");
    for (colour, row, bits) in [("warn", "2", SLEW), ("accent", "7", LIMITS)] {
        let truth = times(&samples, "notices", whole, |notices| notices & bits != 0).expect("the limiter was at work");
        marks_agree(&browser, whole, colour, row, truth).await;
    }
    browser.look("marks.png").await;

    // Read off: the chart tells what the samples say, and the other chart tells the same time.
    for share in [0.3, 0.5, 0.75] {
        let told = at(&browser, "chart-pressure", share).await;
        let beside = read(&browser, "chart-displacement").await;
        assert!((told[0] - beside[0]).abs() < 1e-9, "{told:?} s beside {beside:?} s");
        let near = |column: &str| -> Vec<f64> {
            let rows = numbers(&samples, "time_ms").into_iter().zip(numbers(&samples, column));
            rows.filter(|(time, _)| (time / 1000.0 - told[0]).abs() < 0.03).map(|(_, value)| value).collect()
        };
        for (value, column) in [(told[1], "command_bar"), (told[2], "pressure_bar"), (beside[1], "displacement_mm")] {
            let near = near(column);
            let (low, high) = near.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), one| (low.min(*one), high.max(*one)));
            // A sensor that is judged anew, as after a change of the settings, has no value for a moment. Three digits are shown.
            let is_told =
                if value.is_nan() { near.iter().any(|one| one.is_nan()) } else { (low - 0.0006..=high + 0.0006).contains(&value) };
            assert!(is_told, "{column} at {} s: {value} told, {low} to {high} in truth", told[0]);
        }
    }

    // Zoomed by a drag, by a button, by the wheel; moved by buttons, and by a drag with Shift.
    let place = |[from, to]: [f64; 2], share: f64| from + share * (to - from);
    let near = |found: [f64; 2], wanted: [f64; 2], what: &str| {
        let tolerance = 0.015 * (wanted[1] - wanted[0]);
        assert!(found.iter().zip(wanted).all(|(one, other)| (one - other).abs() < tolerance), "{what}: {found:?} s, {wanted:?} s wanted");
    };
    drag(&browser, [0.3, 0.8], false).await;
    let mut seen = [place(whole, 0.3), place(whole, 0.8)];
    near(ends(&browser).await, seen, "dragged");
    for (button, shares) in [("closer", [0.25, 0.75]), ("earlier", [-0.25, 0.75]), ("later", [0.25, 1.25]), ("wider", [-0.5, 1.5])] {
        browser.click(button).await;
        seen = shares.map(|share| place(seen, share));
        near(ends(&browser).await, seen, button);
    }
    drag(&browser, [0.5, 0.7], true).await;
    seen = [-0.2, 0.8].map(|share| place(seen, share));
    near(ends(&browser).await, seen, "moved with Shift");
    let [left, top, width, height] = area(&browser, "chart-pressure").await;
    let wheel = format!(
        "document.querySelector('#chart-pressure .u-over').dispatchEvent(new WheelEvent('wheel',
           {{ deltaY: -100, clientX: {}, clientY: {}, cancelable: true, bubbles: true }}))",
        left + 0.5 * width,
        top + 0.5 * height
    );
    browser.run(&wheel).await;
    seen = [0.1, 0.9].map(|share| place(seen, share));
    near(ends(&browser).await, seen, "the wheel");

    // A double click goes back to what is live; on a machine that stands still between the two it is two clicks.
    let begun = Instant::now();
    while browser.text("pause").await != "Pause" {
        assert!(begun.elapsed() < Duration::from_secs(20), "waited in vain for what is live");
        let there = MouseActions::new("mouse".into()).then(to(left + 0.5 * width, top + 0.5 * height));
        let press = |mouse: MouseActions| {
            mouse.then(PointerAction::Down { button: MOUSE_BUTTON_LEFT }).then(PointerAction::Up { button: MOUSE_BUTTON_LEFT })
        };
        perform(&browser, press(press(there))).await;
    }
    // The newest sample stands at the end of the charts, and they move on.
    let before = served.time_s();
    served.pass(0.5).await;
    let begun = Instant::now();
    loop {
        let (now, end) = (served.time_s(), ends(&browser).await[1]);
        if end > before.max(seen[1]) && now - end < 2.0 {
            break;
        }
        assert!(begun.elapsed() < Duration::from_secs(20), "the charts end at {end} s at {now} s");
    }
}

/// Runs into ceiling and slew limit, and holds the charts still with both in the window: its ends, and the samples. On a slow
/// machine the window may have moved on before it is held, so that it takes another attempt.
async fn limiter_at_work(browser: &Browser, served: &Served) -> ([f64; 2], Value) {
    for _ in 0..5 {
        browser.slide(20.0).await;
        served.pass(0.7).await;
        browser.slide(6.0).await;
        served.pass(1.2).await;
        browser.run("scrollTo(0, 0)").await;
        browser.click("pause").await;
        let whole = ends(browser).await;
        served.reach(whole[1]).await;
        let samples = served.api("/api/samples?last=60000");
        let works = |bits: u64| times(&samples, "notices", whole, |notices| notices & bits != 0).is_some();
        if numbers(&samples, "time_ms").first().is_some_and(|first| first / 1000.0 < whole[0]) && works(SLEW) && works(LIMITS) {
            return (whole, samples);
        }
        browser.click("pause").await;
    }
    panic!("the limiter was never at work in the window");
}

/// The line of the fault that struck last stands where the samples say, `struck` at the rig's time, s.
pub async fn fault_is_marked(browser: &Browser, served: &Served, struck: f64) {
    // A window that is full: left of the device's start the crosshair has nothing to stand on.
    browser.run("const it = document.getElementById('window'); it.value = '5'; it.dispatchEvent(new Event('change'))").await;
    served.reach(5.5).await;
    browser.click("pause").await;
    // What was on its way is drawn.
    served.pass(0.5).await;
    let mut seen = ends(browser).await;
    // A slow browser comes to the window when the fault has left it.
    while struck < seen[0] + 0.1 * (seen[1] - seen[0]) {
        browser.click("earlier").await;
        let before = std::mem::replace(&mut seen, ends(browser).await);
        assert!(seen[0] < before[0], "the window stays at {seen:?} s");
    }
    marks_agree(browser, seen, "bad", "part.height / 2", [struck, struck]).await;
    browser.click("pause").await;
}

/// The rig's time at which a fault struck, s, soon after it did.
pub fn struck(served: &Served) -> f64 {
    let samples = served.api("/api/samples?last=60000");
    let before = times(&samples, "fault", [0.0, f64::INFINITY], |fault| fault == 0).expect("samples before the fault");
    times(&samples, "fault", [before[1], f64::INFINITY], |fault| fault != 0).expect("a fault struck")[0]
}
