//! The page by keyboard, by screen reader, in both colours, and on a phone.

use crate::browser::{Browser, Look, Served};

const ARROW_RIGHT: char = '\u{e014}';
const TABS: [&str; 6] = ["excitation", "reference", "learn", "calibrate", "settings", "teach"];

/// Opens each tab in turn, waits for its contents, and runs a script there; `look` names the pictures for whoever works on the page.
async fn each_tab(browser: &Browser, look: &str, script: &str) -> Vec<(&'static str, String)> {
    let mut found = Vec::new();
    for tab in TABS {
        // The driver scrolls no farther than to the edge of a phone, where the button that vents lies.
        browser.run(&format!("document.getElementById('tab-{tab}').scrollIntoView({{ block: 'center' }})")).await;
        browser.click(&format!("tab-{tab}")).await;
        let filled = format!(
            "return document.querySelectorAll('#page-{tab} button').length > 0 || document.querySelectorAll('#page-{tab} input').length > 0"
        );
        browser.until(tab, &filled).await;
        found.push((tab, browser.run(script).await.to_string()));
        browser.run(&format!("document.getElementById('tab-{tab}').scrollIntoView()")).await;
        browser.look(&format!("{look}-{tab}.png")).await;
    }
    found
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn every_control_has_a_name_and_tabs_move_by_arrows() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    browser.until("the steps", "return document.querySelectorAll('#calibrate-steps li').length === 5").await;
    let nameless = "const named = (it) => (it.getAttribute('aria-label') ?? '').trim() || [...(it.labels ?? [])].some((label) => label.textContent.trim())
                      || it.textContent.trim() || it.getAttribute('title');
                    const parts = document.querySelectorAll('button, input, select, textarea, iframe, canvas, progress, a[href], svg[role=img]');
                    return [...parts].filter((it) => it.getClientRects().length && !named(it)).map((it) => it.outerHTML.slice(0, 90)).join(' | ')";
    for (tab, found) in each_tab(&browser, "desk", nameless).await {
        assert_eq!(found, "\"\"", "{tab} has controls without a name");
    }
    browser.click("tab-excitation").await;
    let chosen = "return document.querySelector('.tabs [aria-selected=true]').id + ' ' + document.activeElement.id";
    for tab in ["reference", "learn", "calibrate"] {
        let active = browser.client.active_element().await.expect("something has the focus");
        active.send_keys(&ARROW_RIGHT.to_string()).await.expect("a key");
        assert_eq!(browser.run(chosen).await, format!("tab-{tab} tab-{tab}"));
    }
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn text_has_the_contrast_of_aa_in_light_and_dark() {
    let served = Served::start(&[]);
    // Relative luminance and contrast by WCAG 2.1; what counts are the colours that the browser computed.
    let script = "const one = (part) => ((part /= 255) <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4);
        const light = ([r, g, b]) => 0.2126 * one(r) + 0.7152 * one(g) + 0.0722 * one(b);
        const parts = (text) => text.match(/[\\d.]+/g).map(Number);
        const ground = (it) => { for (; it; it = it.parentElement) { const found = parts(getComputedStyle(it).backgroundColor);
          if (found.length === 3 || found[3] === 1) return found; } return parts(getComputedStyle(document.documentElement).backgroundColor); };
        const bad = new Set();
        for (const it of document.querySelectorAll('body *')) {
          const own = [...it.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
          if (!own || it.closest('svg, script, noscript, .u-legend') || !it.getClientRects().length || it.disabled) continue;
          const [a, b] = [light(parts(getComputedStyle(it).color)), light(ground(it))].sort((x, y) => y - x);
          if ((a + 0.05) / (b + 0.05) < 4.5) bad.add(`${it.tagName}.${it.className}#${it.id} ${((a + 0.05) / (b + 0.05)).toFixed(2)}`);
        }
        return [...bad].join(' | ')";
    for look in [Look::Desktop, Look::Dark] {
        let browser = Browser::open(look, &served.address).await;
        let dark = browser.run("return matchMedia('(prefers-color-scheme: dark)').matches").await;
        assert_eq!(dark, look == Look::Dark);
        for (tab, found) in each_tab(&browser, if dark == true { "dark" } else { "light" }, script).await {
            assert_eq!(found, "\"\"", "{tab}, dark: {dark}");
        }
    }
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_phone_shows_every_part_without_scrolling_sideways() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Phone, &served.address).await;
    browser.until("the steps", "return document.querySelectorAll('#calibrate-steps li').length === 5").await;
    let wider = "return document.documentElement.scrollWidth - document.documentElement.clientWidth";
    for (tab, found) in each_tab(&browser, "phone", wider).await {
        assert_eq!(found, "0", "{tab} is too wide");
    }
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn any_two_channels_are_drawn_against_each_other() {
    let served = Served::start(&[]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    let channels = browser.run("return [...document.getElementById('loop-x').options].map((it) => it.value)").await;
    let channels: Vec<String> =
        channels.as_array().expect("a list").iter().map(|name| name.as_str().unwrap_or_default().to_owned()).collect();
    assert!(
        ["command", "output", "set", "pressure", "displacement", "estimate", "residual"]
            .iter()
            .all(|name| channels.iter().any(|own| own == name)),
        "{channels:?}"
    );
    let inked = "const it = document.getElementById('loop'); const data = it.getContext('2d').getImageData(0, 0, it.width, it.height).data;
                 let sum = 0; for (let at = 0; at < data.length; at += 4) sum = (sum * 31 + data[at] + data[at + 3]) % 1000003; return String(sum)";
    let mut seen = Vec::new();
    for (x, y) in [("pressure", "displacement"), ("displacement", "pressure"), ("command", "pressure")] {
        let choose = |id: &str, name: &str| {
            format!("const it = document.getElementById('{id}'); it.value = '{name}'; it.dispatchEvent(new Event('change'))")
        };
        browser.run(&choose("loop-x", x)).await;
        browser.run(&choose("loop-y", y)).await;
        tokio::time::sleep(std::time::Duration::from_millis(600)).await;
        seen.push(browser.run(inked).await);
    }
    assert!(seen[0] != seen[1] && seen[1] != seen[2], "{seen:?}");
}
