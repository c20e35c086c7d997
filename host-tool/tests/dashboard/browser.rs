//! A real browser, headless, through its driver; and the command that serves it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use fantoccini::{Client, ClientBuilder, Locator};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};

use crate::processes::{self, Process};

/// On a busy machine a page takes its time; what has a limit of its own is measured otherwise.
const PATIENCE: Duration = Duration::from_secs(20);

/// What a browser pretends.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Look {
    Desktop,
    Dark,
    Phone,
}

/// What a server on this machine answers.
fn ask(port: u16, what: &str, head: &str, body: &str) -> Value {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the server listens");
    let length = if body.is_empty() { String::new() } else { format!("Content-Length: {}\r\n", body.len()) };
    write!(stream, "{what} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n{head}{length}\r\n{body}")
        .expect("it takes a request");
    // Not every server closes the connection, asked to or not.
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    let mut reader = BufReader::new(stream);
    let (mut line, mut length) = (String::new(), 0);
    while reader.read_line(&mut line).expect("it answers") > 2 {
        if let Some((_, value)) = line.split_once(':').filter(|(name, _)| name.eq_ignore_ascii_case("content-length")) {
            length = value.trim().parse().expect("a length");
        }
        line.clear();
    }
    let mut answer = vec![0; length];
    reader.read_exact(&mut answer).expect("it answers");
    serde_json::from_slice(&answer).unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&answer)))
}

/// `catheter dashboard`, until it is dropped.
pub struct Served {
    pub child: Child,
    /// The address that may do most.
    pub address: String,
    pub begun: Instant,
    pub folder: tempfile::TempDir,
}

impl Served {
    pub fn start(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let begun = Instant::now();
        let mut child = Command::new(env!("CARGO_BIN_EXE_catheter"))
            .args(["dashboard", "--port", "0", "--no-open"])
            .args(arguments)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the built command starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("its output")).read_line(&mut line).expect("its first line");
        let address = line.trim().strip_prefix("listening on ").unwrap_or_else(|| panic!("the first line is {line:?}")).to_owned();
        Self { child, address, begun, folder }
    }

    pub fn token(&self) -> &str {
        self.address.split_once("token=").expect("a token").1
    }

    pub fn port(&self) -> u16 {
        let host = self.address.split('/').nth(2).expect("a host");
        host.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port")
    }

    /// What `GET /api/...` says.
    pub fn api(&self, path: &str) -> Value {
        ask(self.port(), &format!("GET {path}"), &format!("Authorization: Bearer {}\r\n", self.token()), "")
    }

    /// What `POST /api/...` says, with a lease.
    pub fn post(&self, path: &str, lease: &str, body: &Value) -> Value {
        let head = format!("Authorization: Bearer {}\r\nX-Lease: {lease}\r\nContent-Type: application/json\r\n", self.token());
        ask(self.port(), &format!("POST {path}"), &head, &body.to_string())
    }

    /// The rig's time, s: that of its newest sample.
    pub fn time_s(&self) -> f64 {
        crate::numbers(&self.api("/api/samples?last=1"), "time_ms").last().map_or(0.0, |time| time / 1000.0)
    }

    /// Waits for a time of the rig, s. A machine that stands still for a moment holds up the simulated rig as well, and a
    /// browser may be there early or late: what has to have happened on the rig is waited for by the rig's clock.
    pub async fn reach(&self, time_s: f64) {
        let begun = Instant::now();
        while self.time_s() < time_s {
            assert!(begun.elapsed() < Duration::from_secs(60), "waited in vain for {time_s} s, at {} s", self.time_s());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Lets some time of the rig pass, s.
    pub async fn pass(&self, seconds: f64) {
        self.reach(self.time_s() + seconds).await;
    }

    pub fn audit(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("sessions/audit.jsonl")).unwrap_or_default()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A driver with the browser that it began, until it is dropped.
struct Driver {
    child: Child,
    port: u16,
    /// Of its only session.
    session: String,
    profile: tempfile::TempDir,
}

impl Driver {
    /// The driver, its browser and whatever that began.
    fn processes(&self) -> Vec<Process> {
        processes::family(self.child.id(), &self.profile.path().display().to_string())
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        // A driver that is ended leaves renderers of its browser behind.
        processes::end(|| self.processes());
        let _ = self.child.wait();
    }
}

/// A browser with one page.
pub struct Browser {
    driver: Driver,
    pub client: Client,
}

impl Browser {
    pub async fn start(look: Look) -> Self {
        let port = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a free port").port();
        let driver = Command::new("chromedriver").arg(format!("--port={port}")).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let child = driver.unwrap_or_else(|error| panic!("chromedriver cannot be started ({error}): type `cargo xtask setup`"));
        // From here on a panic ends what was begun.
        let mut driver = Driver { child, port, session: String::new(), profile: tempfile::tempdir().expect("a temporary folder") };
        let own = format!("--user-data-dir={}", driver.profile.path().display());
        let mut options = json!({ "args": [
            "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1400,1080", own,
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
        ] });
        let arguments = options["args"].as_array_mut().expect("a list");
        match look {
            Look::Desktop => {}
            Look::Dark => arguments.push("--blink-settings=preferredColorScheme=0".into()),
            Look::Phone => options["mobileEmulation"] = json!({ "deviceMetrics": { "width": 390, "height": 844, "pixelRatio": 2.0 } }),
        }
        let capabilities =
            json!({ "goog:chromeOptions": options, "goog:loggingPrefs": { "browser": "ALL" }, "pageLoadStrategy": "normal" });
        let capabilities = capabilities.as_object().cloned().expect("an object");
        let begun = Instant::now();
        let client = loop {
            let connected = ClientBuilder::new(HttpConnector::new())
                .capabilities(capabilities.clone())
                .connect(&format!("http://127.0.0.1:{port}"))
                .await;
            match connected {
                Ok(client) => break client,
                Err(error) => assert!(begun.elapsed() < PATIENCE, "no browser: {error}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        driver.session = client.session_id().await.expect("the driver answers").expect("a session");
        Self { driver, client }
    }

    fn command(&self, path: &str, body: &Value) -> Value {
        let (body, what) = (body.to_string(), format!("POST /session/{}/{path}", self.driver.session));
        let answer = ask(self.driver.port, &what, "Content-Type: application/json\r\n", &body);
        assert!(answer["value"]["error"].is_null(), "{what}: {answer}");
        answer["value"].clone()
    }

    /// A command of the browser's own protocol, which is no part of WebDriver.
    pub fn devtools(&self, command: &str, parameters: &Value) -> Value {
        self.command("goog/cdp/execute", &json!({ "cmd": command, "params": parameters }))
    }

    /// What the browser has said since it was asked last: errors of scripts, what a page's policy has refused.
    pub fn log(&self) -> Value {
        self.command("se/log", &json!({ "type": "browser" }))
    }

    /// Opens the page and waits until it is live.
    pub async fn open(look: Look, address: &str) -> Self {
        let browser = Self::start(look).await;
        browser.client.goto(address).await.expect("the page loads");
        browser.until("samples", "return Number(document.getElementById('now-pressure').textContent) >= -1").await;
        browser
    }

    pub async fn run(&self, script: &str) -> Value {
        self.client.execute(script, Vec::new()).await.unwrap_or_else(|error| panic!("{script}: {error}"))
    }

    pub async fn text(&self, id: &str) -> String {
        self.run(&format!("return document.getElementById('{id}').textContent")).await.as_str().unwrap_or_default().to_owned()
    }

    pub async fn click(&self, id: &str) {
        self.until(
            id,
            &format!("const it = document.getElementById('{id}'); return Boolean(it) && !it.disabled && it.getClientRects().length > 0"),
        )
        .await;
        let element = self.client.find(Locator::Id(id)).await.unwrap_or_else(|error| panic!("{id}: {error}"));
        element.click().await.unwrap_or_else(|error| panic!("{id}: {error}"));
    }

    /// Clicks the button with this text.
    pub async fn press(&self, text: &str) {
        let path = format!("//button[normalize-space(.)='{text}']");
        let element = self.client.find(Locator::XPath(&path)).await.unwrap_or_else(|error| panic!("{text}: {error}"));
        element.click().await.unwrap_or_else(|error| panic!("{text}: {error}"));
    }

    pub async fn key(&self, key: char) {
        let body = self.client.find(Locator::Css("body")).await.expect("a body");
        body.send_keys(&key.to_string()).await.expect("a key");
    }

    /// Moves the slider, as dragging it does.
    pub async fn slide(&self, value: f64) {
        let script = format!(
            "const it = document.getElementById('slider'); it.value = {value}; it.dispatchEvent(new Event('input', {{ bubbles: true }}))"
        );
        self.run(&script).await;
    }

    /// Waits until a script returns true.
    pub async fn until(&self, what: &str, script: &str) {
        self.until_within(PATIENCE, what, script).await;
    }

    /// As [`Browser::until`], for what takes longer than a page does.
    pub async fn until_within(&self, limit: Duration, what: &str, script: &str) {
        let begun = Instant::now();
        while self.run(script).await != Value::Bool(true) {
            assert!(begun.elapsed() < limit, "waited in vain for {what}; the page says: {}", self.said().await);
            tokio::time::sleep(Duration::from_millis(30)).await;
        }
    }

    /// From idle to running, by the buttons.
    pub async fn arm_and_start(&self) {
        self.click("arm").await;
        self.until_state("armed").await;
        self.click("start").await;
        self.until_state("running").await;
    }

    pub async fn until_state(&self, state: &str) {
        self.until(state, &format!("return document.getElementById('now-state').textContent === '{state}'")).await;
    }

    pub async fn said(&self) -> String {
        let script =
            "return ['now-state', 'lease', 'why', 'banner', 'said'].map((id) => document.getElementById(id).textContent).join(' | ')";
        self.run(script).await.to_string()
    }

    /// A picture for the book, where one is wanted: `CATHETER_SCREENSHOTS=1` writes them.
    pub async fn picture(&self, name: &str) {
        if std::env::var_os("CATHETER_SCREENSHOTS").is_none() {
            return;
        }
        let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/images").join(name);
        std::fs::write(path, self.client.screenshot().await.expect("a picture")).expect("a file");
    }

    /// A picture for whoever works on the page: `CATHETER_LOOK=FOLDER` gathers them.
    pub async fn look(&self, name: &str) {
        if let Some(folder) = std::env::var_os("CATHETER_LOOK") {
            std::fs::write(Path::new(&folder).join(name), self.client.screenshot().await.expect("a picture")).expect("a file");
        }
    }

    /// The same of a whole page, however long.
    pub async fn look_at_all(&self, name: &str) {
        if let Some(folder) = std::env::var_os("CATHETER_LOOK") {
            let size = self.run("const it = document.documentElement; return [it.clientWidth, it.scrollHeight]").await;
            let clip = json!({ "x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 1 });
            let picture = self.devtools("Page.captureScreenshot", &json!({ "captureBeyondViewport": true, "clip": clip }));
            let bytes = STANDARD.decode(picture["data"].as_str().expect("a picture")).expect("base64");
            std::fs::write(Path::new(&folder).join(name), bytes).expect("a file");
        }
    }

    /// Changes a setting on its tab; `differ` settings differ from the saved ones then. On a machine that stands still for longer than a page
    /// may be silent, control is lost beside a vented rig and comes back by itself; what was refused meanwhile is changed again.
    pub async fn set(&self, name: &str, value: f64, differ: u32) {
        self.click("tab-settings").await;
        self.until("the settings", "return document.querySelectorAll('#settings-rows input').length > 50").await;
        let script = format!(
            "const it = [...document.querySelectorAll('#settings-rows input')].find((it) => it.getAttribute('aria-label').startsWith('{name}'));
             it.value = {value}; it.dispatchEvent(new Event('change'))"
        );
        let counted = format!("return document.getElementById('settings-count').textContent.includes('; {differ} differ')");
        let begun = Instant::now();
        loop {
            self.until_operating().await;
            self.run(&script).await;
            tokio::time::sleep(Duration::from_millis(200)).await;
            if self.run(&counted).await == Value::Bool(true) {
                break;
            }
            assert!(begun.elapsed() < PATIENCE, "waited in vain for {name}; the page says: {}", self.said().await);
        }
    }

    pub async fn until_operating(&self) {
        self.until("control", "return document.getElementById('lease').textContent === 'You operate'").await;
    }

    /// What a machine with other work needs: the browser may be late by more than 250 ms.
    pub async fn be_patient(&self) {
        self.set("limits.host_timeout_ms", 3000.0, 1).await;
    }
}

impl Browser {
    /// The driver, its browser and whatever that began.
    pub fn processes(&self) -> Vec<Process> {
        self.driver.processes()
    }
}
