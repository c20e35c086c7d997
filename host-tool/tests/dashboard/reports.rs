//! Every kind of report in a real browser: on a screen, on a phone, in the dark and on paper; and what its buttons do.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use fantoccini::wd::PrintConfiguration;
use serde_json::json;

use crate::browser::{Browser, Look};
use crate::recordings;

/// A second recording, so that something can be left out.
const EXCITATION: &str = "sample_period_s = 0.02\nnoise_bar = 0.0\nseed = 1\n[[segments]]\nduration_s = 6.0\nsignal = { kind = \"descending-sine\", \
                          amplitude_bar = 0.9, frequency_hz = 0.5, decay_per_s = 0.1 }\n";

/// What makes a page `NAME.html`, in this order: later ones read what earlier ones leave.
const PAGES: [(&str, &str); 18] = [
    ("check", "check --data data"),
    ("identify", "identify --data data --out physics.toml"),
    ("train", "train --preset stream-1x32 --epochs 2 --data data --out model.safetensors --threads 1"),
    ("export", "export model.safetensors --calibration data --out model.blob"),
    ("evaluate", "evaluate --model physics.toml --data data"),
    ("suite", "evaluate --model model.blob --reference model.safetensors --data data --suite"),
    ("inspect", "inspect model.blob"),
    ("explain", "explain E001"),
    ("fit", "fit --no-networks --data data/first.csv --out fitted"),
    ("discover", "discover --data data/first.csv --out found"),
    ("plan-experiment", "plan-experiment --models found/model.toml found/runner_up.toml --out next.toml"),
    ("tune", "tune --data data/first.csv --out tuned"),
    (
        "track",
        "track --settings tuned/settings.toml --model tuned/control.blob --reach-mm 3,8 --reference point-to-point --controllers open-loop,physics-inverse+pid",
    ),
    ("simulate", "simulate play.toml --out played"),
    ("record", "rig record --excitation play.toml --out run.csv"),
    ("replay", "replay run.csv"),
    ("calibrate", "rig calibrate --yes --steps noise,laser,pressure"),
    ("hide", "hide --effect creep --seed 7 --out case"),
];

/// Makes a page, if the command leaves one.
fn make(folder: &Path, name: &str, line: &str) -> Option<std::path::PathBuf> {
    let page = folder.join(format!("{name}.html"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_catheter"));
    command.args(line.split(' ')).current_dir(folder);
    // A recording has none of its own.
    if name != "record" {
        command.arg("--html").arg(&page);
    }
    let output = command.output().expect("the built command starts");
    // A limit of the suite may fail: its page says so.
    let code = output.status.code().expect("it ends by itself");
    assert!(code == 0 || (name == "suite" && code == 1), "{line}: {code}: {}", String::from_utf8_lossy(&output.stderr));
    (name != "record").then_some(page)
}

/// How a page is looked at: the width of the window, the medium and the colours.
struct Sight {
    name: &'static str,
    width: u32,
    medium: &'static str,
    colours: &'static str,
}

const SIGHTS: [Sight; 4] = [
    Sight { name: "screen", width: 1400, medium: "", colours: "light" },
    Sight { name: "dark", width: 1400, medium: "", colours: "dark" },
    Sight { name: "phone", width: 400, medium: "", colours: "light" },
    // A4 within Chromium's margins of a centimetre.
    Sight { name: "paper", width: 718, medium: "print", colours: "light" },
];

impl Sight {
    async fn take(&self, browser: &Browser) {
        let size = json!({ "width": self.width, "height": 900, "deviceScaleFactor": 1, "mobile": false });
        browser.devtools("Emulation.setDeviceMetricsOverride", &size);
        let colours = json!([{ "name": "prefers-color-scheme", "value": self.colours }]);
        browser.devtools("Emulation.setEmulatedMedia", &json!({ "media": self.medium, "features": colours }));
    }
}

/// What is wrong with how a page looks: too wide, parts beyond their frames, text that cannot be told from its ground.
const FLAWS: &str = "
    const flaws = [];
    const over = document.documentElement.scrollWidth - document.documentElement.clientWidth;
    if (over > 0) flaws.push(`the page is ${over} px too wide`);
    const paper = matchMedia('print').matches;
    if (paper || innerWidth > 1000) for (const it of document.querySelectorAll('.scroll, figure, pre'))
      if (it.scrollWidth > it.clientWidth + 1) flaws.push(`${it.scrollWidth - it.clientWidth} px cut off: ${it.textContent.slice(0, 60)}`);
    if (paper) for (const it of document.querySelectorAll('.tools, nav')) if (it.getClientRects().length) flaws.push('buttons on paper');
    const one = (part) => ((part /= 255) <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4);
    const light = ([r, g, b]) => 0.2126 * one(r) + 0.7152 * one(g) + 0.0722 * one(b);
    const parts = (text) => text.match(/[\\d.]+/g).map(Number);
    const ground = (it) => { for (; it; it = it.parentElement) { const found = parts(getComputedStyle(it).backgroundColor);
      if (found.length === 3 || found[3] === 1) return found; } return [255, 255, 255]; };
    const pale = new Set();
    for (const it of document.querySelectorAll('body *')) {
      const own = [...it.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
      if (!own || it.closest('script, title, desc') || !it.getClientRects().length || it.matches('.letter')) continue;
      const style = getComputedStyle(it);
      const [a, b] = [light(parts(it.closest('svg') ? style.fill : style.color)), light(ground(it))].sort((x, y) => y - x);
      if ((a + 0.05) / (b + 0.05) < 4.5) pale.add(`${it.tagName}.${it.getAttribute('class')} ${((a + 0.05) / (b + 0.05)).toFixed(2)}`);
    }
    flaws.push(...pale);
    for (const svg of document.querySelectorAll('figure svg')) {
      const frame = svg.getBoundingClientRect();
      const texts = [...svg.querySelectorAll('text')].map((it) => [it.getBoundingClientRect(), it]).filter(([box]) => box.width > 0);
      for (const [box, it] of texts) if (box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1 || box.bottom > frame.bottom + 1)
        flaws.push(`outside of its drawing: ${it.textContent}`);
      texts.forEach(([a, one], nth) => texts.slice(nth + 1).forEach(([b, other]) => {
        const [x, y] = [Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)];
        // Letters of families may touch; boxes of text are taller than what is written.
        if (x > 2 && y > 0.4 * Math.min(a.height, b.height, 14) && !one.matches('.letter')) flaws.push(`one on the other: ${one.textContent} / ${other.textContent}`);
      }));
    }
    return flaws";

/// What the buttons of the first figures over time do; nothing where there is none.
const BUTTONS: &str = "
    const flaws = [];
    const hear = (svg) => [...svg.querySelectorAll('.ticks, .series')].map((it) => it.innerHTML).join();
    const overTime = [...document.querySelectorAll('figure')].find((it) => it.querySelector('[title=\"Zoom in\"]'));
    if (overTime) {
      const svg = overTime.querySelector('svg');
      const whole = hear(svg);
      for (const title of ['Zoom in', 'Later', 'Zoom out', 'Earlier']) {
        const before = hear(svg);
        if (title === 'Zoom out') overTime.querySelector('[title=\"Zoom in\"]').click();
        overTime.querySelector(`[title=\"${title}\"]`).click();
        if (hear(svg) === before && title !== 'Zoom out') flaws.push(`${title} does nothing`);
        if (/NaN|Infinity|undefined/.test(hear(svg))) flaws.push(`${title} draws ${hear(svg).match(/.{30}(NaN|Infinity|undefined)/)}`);
      }
      overTime.querySelector('[title=\"Show the whole of it\"]').click();
      if (hear(svg) !== whole) flaws.push('the whole is not as it was');
    }
    const entry = document.querySelector('figure .entry[role=button]');
    if (entry) {
      const figure = entry.closest('figure');
      const hidden = () => figure.querySelectorAll('.series.hidden').length;
      entry.dispatchEvent(new MouseEvent('click', { bubbles: true }));
      if (!hidden() || entry.getAttribute('aria-pressed') !== 'false') flaws.push('a line is not hidden');
      entry.dispatchEvent(new KeyboardEvent('keydown', { key: 'Enter', bubbles: true }));
      if (hidden() || entry.getAttribute('aria-pressed') !== 'true') flaws.push('a line does not come back');
    }
    return [flaws, Boolean(overTime), Boolean(entry)]";

/// Saves the first figure three times; says what the files are.
async fn downloads(browser: &Browser, folder: &Path) -> Option<Vec<(String, Vec<u8>)>> {
    std::fs::create_dir_all(folder).expect("a folder");
    let behaviour = json!({ "behavior": "allow", "downloadPath": folder });
    browser.devtools("Browser.setDownloadBehavior", &behaviour);
    let script = "const bar = document.querySelector('figure .tools'); if (!bar) return false;
                  for (const it of bar.querySelectorAll('[title^=Download]')) it.click(); return true";
    if browser.run(script).await != true {
        return None;
    }
    let begun = Instant::now();
    loop {
        let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
        let mut files: Vec<_> =
            entries.filter(|path| path.extension().is_some_and(|ending| ["svg", "png", "csv"].iter().any(|one| ending == *one))).collect();
        files.sort();
        if files.len() == 3 {
            let read = |path: &std::path::PathBuf| {
                (path.extension().expect("an ending").to_string_lossy().into_owned(), std::fs::read(path).expect("a file"))
            };
            let read: Vec<_> = files.iter().map(read).collect();
            if read.iter().all(|(_, bytes)| !bytes.is_empty()) {
                return Some(read);
            }
        }
        assert!(begun.elapsed() < Duration::from_secs(20), "not saved: {files:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Looks at a page in every way; gives what is wrong, and how many pages of paper it takes.
async fn inspect(browser: &Browser, name: &str, page: &Path, kept: &Path) -> (Vec<String>, usize) {
    let mut wrong = Vec::new();
    for sight in &SIGHTS {
        sight.take(browser).await;
        browser.client.goto(&format!("file://{}", page.display())).await.expect("the page opens");
        let flaws = browser.run(FLAWS).await;
        wrong.extend(
            flaws.as_array().expect("a list").iter().map(|flaw| format!("{name}, {}: {}", sight.name, flaw.as_str().unwrap_or_default())),
        );
        browser.look_at_all(&format!("{name}-{}.png", sight.name)).await;
        if sight.name == "phone" {
            let requests = browser.run("return performance.getEntriesByType('resource').map((it) => it.name)").await;
            if requests != json!([]) {
                wrong.push(format!("{name}: asks for {requests}"));
            }
        }
    }
    SIGHTS[0].take(browser).await;
    let answered = browser.run(BUTTONS).await;
    wrong.extend(answered[0].as_array().expect("a list").iter().map(|flaw| format!("{name}: {}", flaw.as_str().unwrap_or_default())));
    // A page with curves has both.
    if ["identify", "evaluate", "fit", "discover", "track", "demo"].contains(&name) && (answered[1] != true || answered[2] != true) {
        wrong.push(format!("{name}: curves that cannot be zoomed or hidden"));
    }
    for (ending, bytes) in downloads(browser, &kept.join(name)).await.unwrap_or_default() {
        let text = String::from_utf8_lossy(&bytes);
        let right = match ending.as_str() {
            "svg" => text.starts_with("<svg") && text.ends_with("</svg>") && !text.contains("var(--"),
            "png" => bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.len() > 2000,
            _ => text.lines().count() > 2 && text.lines().all(|line| line.is_empty() || line.contains(',')),
        };
        if !right {
            wrong.push(format!("{name}: {} bytes of {ending}: {:.80}", bytes.len(), text));
        }
    }
    let paper = PrintConfiguration::builder().background(false).build().expect("a kind of paper");
    let paper = browser.client.print(paper).await.expect("it is printed");
    let pages = String::from_utf8_lossy(&paper).matches("/Type /Page\n").count();
    if !paper.starts_with(b"%PDF-") || pages == 0 {
        wrong.push(format!("{name}: printed, it is {} bytes and {pages} pages", paper.len()));
    }
    let said = browser.log();
    wrong.extend(said.as_array().expect("a list").iter().map(|entry| format!("{name}: says {}", entry["message"])));
    (wrong, pages)
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn every_report_is_whole_on_a_screen_a_phone_and_paper_and_its_buttons_work() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let place = folder.path();
    std::fs::create_dir(place.join("data")).expect("a folder");
    for (name, seconds, hertz_per_s) in [("first", 14, 0.02), ("second", 10, 0.05)] {
        std::fs::write(place.join(format!("data/{name}.csv")), recordings::actuator(seconds, hertz_per_s)).expect("a file");
    }
    std::fs::write(place.join("play.toml"), EXCITATION).expect("a file");
    let mut pages: Vec<_> = PAGES.iter().filter_map(|(name, line)| Some((*name, make(place, name, line)?))).collect();
    // It takes a minute to make, and `cargo xtask test` has made one.
    if let Some(demo) = std::env::var_os("CATHETER_DEMO_PAGE") {
        pages.push(("demo", demo.into()));
    }
    let browser = Browser::start(Look::Desktop).await;
    let mut wrong = Vec::new();
    for (name, page) in &pages {
        let begun = Instant::now();
        let (flaws, sheets) = inspect(&browser, name, page, &place.join("saved")).await;
        println!("{name}: {} ms, {sheets} sheets", begun.elapsed().as_millis());
        wrong.extend(flaws);
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
