//! A server around a fake rig, and clients without a browser.

#![allow(dead_code, reason = "each test file needs a part of it")]

pub mod fake;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dashboard::{Config, Foreign, JobKind, Jobs, Loaded, Phase, Role, Server, Tls};
use futures_util::{SinkExt, StreamExt};
use serde_json::Value;
use tokio::net::TcpStream as Stream;
use tokio::sync::oneshot;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

use fake::{Fake, Watched};

/// A server that runs.
pub struct Bench {
    pub port: u16,
    tokens: Vec<(Role, String)>,
    pub fingerprint: Option<String>,
    pub watched: Arc<Mutex<Watched>>,
    pub folder: tempfile::TempDir,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// A computation that needs no tool: it says what it was given and leaves a report.
const KIND: JobKind = JobKind {
    name: "count",
    title: "Count",
    arguments: |data, folder| {
        let script = format!(
            "printf 'ten\\rtwenty\\r\\nlines of it\\n'; mkdir {0}; printf '<script>1</script>' > {0}/report.html; wc -l < {1}",
            folder.display(),
            data[0].display()
        );
        // A second command makes the model and the settings that belong to it.
        let made = format!(
            "printf blob > {0}/model.blob; printf '{{\"settings\": {{\"limits.host_timeout_ms\": 400}}}}' > {0}/result.json",
            folder.display()
        );
        vec![vec!["-c".into(), script.into()], vec!["-c".into(), made.into()]]
    },
    report: "report.html",
    model: Some("model.blob"),
    settings: Some("result.json"),
};

/// A reader of files whose first line is a header; it says nothing of other columns.
fn read(file: &Foreign<'_>, to: &Path) -> Result<Loaded, String> {
    let text = String::from_utf8(file.bytes.to_vec()).map_err(|_| format!("{}: no text", file.name))?;
    let samples = text.lines().count().checked_sub(1).filter(|count| *count > 0).ok_or_else(|| format!("{}: no samples", file.name))?;
    std::fs::write(to, &text).map_err(|error| error.to_string())?;
    let notes = file.columns.map(|columns| format!("read as {columns}")).into_iter().collect();
    Ok(Loaded { samples, seconds: 1.5, sha256: "0".repeat(64), notes })
}

impl Bench {
    pub fn start() -> Self {
        Self::start_with(|_| ())
    }

    /// With another configuration.
    pub fn start_with(changed: impl FnOnce(&mut Config)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = config(folder.path());
        changed(&mut config);
        let server = Server::bind(config).unwrap();
        let addresses = server.addresses();
        let tokens = addresses.iter().map(|(role, address)| (*role, address.split_once("token=").unwrap().1.to_owned())).collect();
        let fingerprint = server.fingerprint().map(str::to_owned);
        let host = addresses[0].1.split_once("://127.0.0.1:").unwrap().1;
        let port = host.split('/').next().unwrap().parse().unwrap();
        let watched = Arc::<Mutex<Watched>>::default();
        let (stop, stopped) = oneshot::channel();
        let rig = Arc::clone(&watched);
        let thread = std::thread::spawn(move || {
            let opener = Box::new(move || {
                if rig.lock().unwrap().cut {
                    return Err(dashboard::Problem::Gone("no such port".to_owned()));
                }
                Ok(Box::new(Fake::new(Arc::clone(&rig))) as Box<dyn dashboard::Rig>)
            });
            server.run_until(opener, async { drop(stopped.await) }).unwrap();
        });
        let bench = Self { port, tokens, fingerprint, watched, folder, stop: Some(stop), thread: Some(thread) };
        bench.wait("the rig", |watched| watched.phase() == Phase::Idle);
        bench
    }

    pub fn token(&self, role: Role) -> &str {
        &self.tokens.iter().find(|(known, _)| *known == role).unwrap().1
    }

    /// Ends the server.
    pub fn stop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    /// Waits until something holds of the rig, and says how long it took.
    pub fn wait(&self, what: &str, holds: impl Fn(&Watched) -> bool) -> Duration {
        let begun = Instant::now();
        while !holds(&self.watched.lock().unwrap()) {
            assert!(begun.elapsed() < Duration::from_secs(5), "waited in vain for {what}: {:?}", self.watched.lock().unwrap().phases);
            std::thread::sleep(Duration::from_millis(1));
        }
        begun.elapsed()
    }

    /// A request with these headers; status, headers and body.
    pub fn raw(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> (u16, String, String) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let mut text = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n", body.len());
        if !headers.iter().any(|(name, _)| *name == "Host") {
            text += &format!("Host: 127.0.0.1:{}\r\n", self.port);
        }
        headers.iter().for_each(|(name, value)| text += &format!("{name}: {value}\r\n"));
        stream.write_all(format!("{text}\r\n{body}").as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), head.to_lowercase(), body.to_owned())
    }

    /// A request of the API as a script makes it.
    pub fn api(&self, role: Role, lease: &str, method: &str, path: &str, body: Value) -> (u16, Value) {
        let bearer = format!("Bearer {}", self.token(role));
        let headers = [("Authorization", bearer.as_str()), ("X-Lease", lease), ("Content-Type", "application/json")];
        let body = if body.is_null() { String::new() } else { body.to_string() };
        let (code, _, text) = self.raw(method, path, &headers, &body);
        (code, serde_json::from_str(&text).unwrap_or(Value::String(text)))
    }

    pub fn audit(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("audit.jsonl")).unwrap()
    }

    pub async fn page(&self, role: Role) -> Page {
        self.page_from(self.token(role), None).await.unwrap()
    }

    /// A page's connection; with another origin, or a token that is none, it is refused.
    pub async fn page_from(&self, token: &str, origin: Option<&str>) -> Result<Page, String> {
        let mut request = format!("ws://127.0.0.1:{}/live", self.port).into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("Sec-WebSocket-Protocol", format!("catheter.1, token.{token}").parse().unwrap());
        headers.insert("Origin", origin.map_or_else(|| format!("http://127.0.0.1:{}", self.port), str::to_owned).parse().unwrap());
        let (socket, _) = tokio_tungstenite::connect_async(request).await.map_err(|error| error.to_string())?;
        let mut page = Page { socket, client: String::new() };
        let hello = page.word("hello").await;
        page.client = hello["client"].as_str().unwrap().to_owned();
        Ok(page)
    }

    /// A viewer's connection, with this behind its address.
    pub async fn viewer(&self, query: &str, protocol: &str) -> Result<Page, String> {
        let mut request = format!("ws://127.0.0.1:{}/foxglove{query}", self.port).into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", protocol.parse().unwrap());
        Self::connect(request).await
    }

    /// The same of a page from elsewhere, which may name another server.
    pub async fn viewer_from(&self, token: &str, origin: &str, host: Option<&str>) -> Result<Page, String> {
        let mut request = format!("ws://127.0.0.1:{}/foxglove?token={token}", self.port).into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().unwrap());
        headers.insert("Origin", origin.parse().unwrap());
        if let Some(host) = host {
            headers.insert("Host", host.parse().unwrap());
        }
        Self::connect(request).await
    }

    async fn connect(request: tokio_tungstenite::tungstenite::handshake::client::Request) -> Result<Page, String> {
        let (socket, _) = tokio_tungstenite::connect_async(request).await.map_err(|error| error.to_string())?;
        Ok(Page { socket, client: String::new() })
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.stop.take());
    }
}

pub fn config(folder: &Path) -> Config {
    Config {
        listen: "127.0.0.1:0".parse().unwrap(),
        names: Vec::new(),
        role: Role::Configure,
        tls: Tls::Off,
        folder: folder.to_owned(),
        jobs: Jobs { program: PathBuf::from("/bin/sh"), kinds: vec![KIND] },
        loader: read,
    }
}

/// A page without a browser.
pub struct Page {
    pub socket: WebSocketStream<MaybeTlsStream<Stream>>,
    /// The secret of its connection.
    pub client: String,
}

impl Page {
    pub async fn say(&mut self, word: &str) {
        self.socket.send(Message::text(word)).await.unwrap();
    }

    async fn next(&mut self) -> Message {
        tokio::time::timeout(Duration::from_secs(5), self.socket.next()).await.expect("something comes").unwrap().unwrap()
    }

    /// The next text, whatever it is.
    pub async fn said(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.next().await {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    /// The next word of this kind.
    pub async fn word(&mut self, kind: &str) -> Value {
        loop {
            if let Message::Text(text) = self.next().await {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["kind"] == kind {
                    return value;
                }
            }
        }
    }

    /// The next frame of samples.
    pub async fn frame(&mut self) -> Vec<u8> {
        loop {
            if let Message::Binary(bytes) = self.next().await {
                return bytes.to_vec();
            }
        }
    }

    /// Heartbeats for so long.
    pub async fn live_for(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until {
            self.say("beat").await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }
}
