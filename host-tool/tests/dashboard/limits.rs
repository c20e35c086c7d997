//! What bounds a hand: the ceiling on the slider, and settings that are searched, compared and taken back.

use std::time::Duration;

use fantoccini::Locator;

use crate::browser::{Browser, Look, Served};
use crate::numbers;

/// Names of the settings that are shown.
async fn shown(browser: &Browser) -> Vec<String> {
    let script = "return [...document.querySelectorAll('#settings-rows input')].map((it) => it.getAttribute('aria-label').split(',')[0])";
    let names = browser.run(script).await;
    names.as_array().expect("a list").iter().map(|name| name.as_str().expect("a name").to_owned()).collect()
}

async fn search(browser: &Browser, words: &str) -> Vec<String> {
    let script =
        format!("const it = document.getElementById('settings-search'); it.value = '{words}'; it.dispatchEvent(new Event('input'))");
    browser.run(&script).await;
    shown(browser).await
}

/// What the slider can be set to, and where its ceiling is said to be.
async fn top(browser: &Browser) -> String {
    let script = "return ['slider', 'exact'].map((id) => document.getElementById(id).max).join() + ' ' + document.querySelector('#ticks .ceiling').textContent";
    browser.run(script).await.as_str().unwrap_or_default().to_owned()
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn set_points_end_at_the_ceiling_and_settings_are_searched_compared_and_taken_back() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.be_patient().await;
    browser.until("the ceiling", "return Boolean(document.querySelector('#ticks .ceiling'))").await;
    assert_eq!(top(&browser).await, "3,3 ceiling 3.00 bar");

    // Every word counts, wherever it stands.
    let all = shown(&browser).await.len();
    assert_eq!(search(&browser, "ceiling_bar").await, ["limits.ceiling_bar"]);
    assert_eq!(search(&browser, "BAR/S slew up").await, ["limits.slew_up_bar_per_s"]);
    assert!(search(&browser, "no such thing").await.is_empty());
    let count = browser.text("settings-count").await;
    assert!(count.starts_with(&format!("0 of {all} settings")), "{count}");
    assert_eq!(search(&browser, "").await.len(), all);

    // A value out of bounds goes nowhere; one within is in use at once, and what differs is shown beside what is saved.
    let put = |value: f64| {
        format!(
            "const it = [...document.querySelectorAll('#settings-rows input')].find((it) => it.getAttribute('aria-label').startsWith('limits.ceiling_bar'));
             it.value = {value}; it.dispatchEvent(new Event('change'))"
        )
    };
    browser.run(&put(9.0)).await;
    browser.set("limits.ceiling_bar", 2.0, 2).await;
    assert!(!served.audit().contains("\"value\\\":9"), "{}", served.audit());
    browser.click("settings-changed").await;
    assert_eq!(shown(&browser).await, ["limits.ceiling_bar", "limits.host_timeout_ms"]);
    let row = browser.run("return document.querySelector('#settings-rows tr.changed').textContent").await;
    assert!(row.as_str().is_some_and(|row| row.contains("0 to 4") && row.contains("saved 3") && row.contains("Revert")), "{row}");
    browser.run("document.getElementById('tab-settings').scrollIntoView()").await;
    browser.look("settings-diff.png").await;

    // The slider ends at the ceiling; beyond it the scale is hatched, from where the slider ends.
    browser.until("the scale", "return document.getElementById('slider').max === '2'").await;
    assert_eq!(top(&browser).await, "2,2 ceiling 2.00 bar");
    let drawn = "const box = (it) => it.getBoundingClientRect(); const [slider, beyond] = [box(document.getElementById('slider')), box(document.getElementById('beyond'))];
                 const tick = [...document.querySelectorAll('#ticks span')].find((it) => it.textContent === '1.0');
                 return [Math.abs(beyond.left - slider.right) < 2, beyond.width > 20, getComputedStyle(document.getElementById('beyond')).backgroundImage.startsWith('repeating'),
                   Math.abs(box(tick).left + box(tick).width / 2 - slider.left - slider.width / 2) < 3]";
    assert_eq!(browser.run(drawn).await, serde_json::json!([true, true, true, true]), "the scale and what lies beyond it");
    browser.arm_and_start().await;
    // Beyond the ceiling: by the slider it is the ceiling, by its number it is nothing, by a script it is refused.
    browser.slide(2.7).await;
    browser.until("the pressure", "return Number(document.getElementById('now-pressure').textContent) > 1.9").await;
    browser.slide(1.0).await;
    browser.until("the pressure", "return Number(document.getElementById('now-pressure').textContent) < 1.1").await;
    let exact = browser.client.find(Locator::Id("exact")).await.expect("a place for a number");
    exact.clear().await.expect("it is empty");
    exact.send_keys("2.5").await.expect("a number");
    browser.click("set").await;
    let refused = "const done = arguments[arguments.length - 1];
                   import('/assets/elements.js').then(({ request }) => request('POST', '/api/act', { do: 'hold', value: 2.5 }))
                     .then(() => done('taken'), (problem) => done(problem.message))";
    let refused = browser.client.execute_async(refused, Vec::new()).await.expect("an answer");
    assert!(refused.as_str().is_some_and(|why| why.contains("outside of 0 to 2 bar (limits.ceiling_bar)")), "{refused}");
    tokio::time::sleep(Duration::from_millis(300)).await;
    let samples = served.api("/api/samples?last=60000");
    let highest = |column: &str| numbers(&samples, column).into_iter().fold(0.0, f64::max);
    assert!((highest("set_point") - 2.0).abs() < 1e-6 && highest("pressure_bar") < 2.05, "{} bar", highest("pressure_bar"));
    assert!((numbers(&samples, "set_point").last().expect("samples") - 1.0).abs() < 1e-6, "what is refused changes nothing");
    browser.run("scrollTo(0, 0)").await;
    browser.look("ceiling.png").await;
    browser.click("vent").await;
    browser.until_state("idle").await;

    // One back by its own button, then the others.
    browser.run("document.querySelector('[aria-label=\"Revert limits.ceiling_bar\"]').click()").await;
    browser.until("one back", "return document.getElementById('settings-count').textContent.includes('; 1 differ')").await;
    browser.until("the scale", "return document.getElementById('slider').max === '3'").await;
    assert_eq!(shown(&browser).await, ["limits.host_timeout_ms"]);
    browser.click("settings-revert").await;
    browser.until("all back", "return document.getElementById('settings-count').textContent.includes('; 0 differ')").await;
    let settings = served.api("/api/settings");
    for setting in settings["settings"].as_array().expect("settings") {
        assert_eq!(setting["value"], setting["saved"], "{setting}");
    }
}
