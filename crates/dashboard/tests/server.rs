//! What the server gives to whom: tokens, Host and Origin, the page, frames, recordings, computations, TLS.

mod support;

use std::io::{Read, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use dashboard::{HEADER_BYTES, Role, SAMPLE_BYTES, ServeError, Server, Tls};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use support::{Bench, config};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use tokio_rustls::rustls::{ClientConfig, DigitallySignedStruct, Error as TlsError, SignatureScheme};

#[tokio::test]
async fn without_the_token_or_from_another_page_nothing_is_heard() {
    let bench = Bench::start();
    let token = bench.token(Role::Configure).to_owned();
    let bearer = format!("Bearer {token}");
    let (own, port) = (format!("http://127.0.0.1:{}", bench.port), bench.port);
    let code = |headers: &[(&str, &str)]| bench.raw("GET", "/api/state", headers, "").0;
    assert_eq!(code(&[("Authorization", &bearer)]), 200);
    assert_eq!(code(&[("Authorization", &bearer), ("Origin", &own)]), 200);
    assert_eq!(code(&[]), 401);
    assert_eq!(code(&[("Authorization", "Bearer 00000000000000000000000000000000")]), 401);
    assert_eq!(code(&[("Authorization", &bearer), ("Origin", "http://evil.example")]), 403);
    assert_eq!(code(&[("Authorization", &bearer), ("Host", "evil.example")]), 403);
    assert_eq!(code(&[("Authorization", &bearer), ("Host", &format!("evil.example:{port}"))]), 403);
    assert_eq!(bench.raw("GET", "/", &[("Host", "evil.example")], "").0, 403);

    assert!(bench.page_from(&token, None).await.is_ok());
    for (token, origin, code) in [(token.as_str(), Some("http://evil.example"), "403"), ("no token", None, "401"), ("", None, "401")] {
        let refused = bench.page_from(token, origin).await.err().unwrap();
        assert!(refused.contains(code), "{refused}");
    }
}

#[test]
fn the_page_needs_nothing_from_elsewhere_and_runs_no_inline_script() {
    let bench = Bench::start();
    let (code, head, page) = bench.raw("GET", "/", &[], "");
    assert_eq!(code, 200);
    assert!(head.contains("default-src 'none'; script-src 'self'") && head.contains("frame-ancestors 'none'"), "{head}");
    assert!(!page.contains("<style") && !page.contains(" style=") && !page.contains(" onclick"), "inline style or script");
    assert!(page.matches("<script").count() == page.matches("<script src=").count() + page.matches("<script type=\"module\" src=").count());
    let mut names: Vec<String> = page.split("/assets/").skip(1).map(|rest| rest.split('"').next().unwrap().to_owned()).collect();
    let mut seen = 0;
    while let Some(name) = names.get(seen).cloned() {
        seen += 1;
        let (code, head, text) = bench.raw("GET", &format!("/assets/{name}"), &[], "");
        assert_eq!(code, 200, "{name}");
        assert!(head.contains(if name.ends_with("js") { "text/javascript" } else { "text/css" }), "{head}");
        for address in text.split("://").skip(1) {
            let known = address.starts_with("www.w3.org/") || address.starts_with("github.com/leeoniya/uPlot") || address.starts_with("${");
            assert!(known, "{name} names {}", &address[..address.len().min(40)]);
        }
        for import in text.split("\"./").skip(1) {
            let module = import.split('"').next().unwrap().to_owned();
            if !names.contains(&module) {
                names.push(module);
            }
        }
    }
    assert!(names.len() >= 10, "{names:?}");
    assert_eq!(bench.raw("GET", "/assets/nothing.js", &[], "").0, 404);
}

#[tokio::test]
async fn four_watchers_get_every_sample_once_and_in_order() {
    let bench = Bench::start();
    let mut pages = Vec::new();
    for _ in 0..4 {
        pages.push(bench.page(Role::Observe).await);
    }
    let until = Instant::now() + Duration::from_secs(2);
    let mut watching = Vec::new();
    for mut page in pages {
        watching.push(tokio::spawn(async move {
            let (mut sequence, mut frames, mut samples) = (None, None, 0u32);
            while Instant::now() < until {
                let bytes = page.frame().await;
                let whole = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
                let (number, count) = (whole(4), whole(8));
                assert_eq!(bytes.len(), HEADER_BYTES + SAMPLE_BYTES * count as usize);
                assert!(frames.is_none_or(|last| number == last + 1 || number == last), "frame {number} after {frames:?}");
                frames = Some(number);
                for nth in 0..count as usize {
                    let own = whole(HEADER_BYTES + nth * SAMPLE_BYTES + 8);
                    assert!(sequence.is_none_or(|last| own == last + 1), "sample {own} after {sequence:?}");
                    sequence = Some(own);
                    samples += 1;
                }
            }
            samples
        }));
    }
    for watcher in watching {
        let samples = watcher.await.unwrap();
        assert!(samples >= 1900, "{samples} samples in two seconds");
    }
}

#[test]
fn the_list_of_recordings_tells_those_that_run_from_those_that_nobody_ended_and_from_files_of_others() {
    let bench = Bench::start();
    let (_, answer) = bench.api(Role::Operate, "", "POST", "/api/lease", Value::Null);
    let lease = answer["lease"].as_str().unwrap().to_owned();
    let act = |action: Value| bench.api(Role::Operate, &lease, "POST", "/api/act", action).0;
    let write = |name: &str, text: &[u8]| std::fs::write(bench.folder.path().join(name), text).unwrap();
    let listed = || {
        let list = bench.api(Role::Observe, "", "GET", "/api/recordings", Value::Null).1["recordings"].clone();
        let entry = |entry: &Value| (entry["name"].as_str().unwrap().to_owned(), entry["state"].as_str().unwrap().to_owned());
        list.as_array().unwrap().iter().map(entry).collect::<std::collections::BTreeMap<_, _>>()
    };
    assert_eq!(act(json!({ "do": "record", "name": "now" })), 200);
    // What a server leaves that dies now: everything that it wrote so far, and nothing beside it.
    let left = std::fs::read(bench.folder.path().join("now.csv")).unwrap();
    assert!(left.starts_with(b"time_s,"), "a recording is known by its header from the first moment");
    write("died.csv", &left);
    write("damaged.csv", &left);
    write("damaged.json", b"{\"samples\": 3,");
    write("other.csv", b"t,u,y\n0,1,2\n");
    write("other.json", b"{\"a\": 1}");
    write("empty.csv", b"");
    write("other.txt", b"");
    let now = listed();
    let state = |name: &str| now.get(name).map(String::as_str);
    assert_eq!(["now", "died", "damaged"].map(state), [Some("running"), Some("interrupted"), Some("interrupted")], "{now:?}");
    assert_eq!(["other", "empty"].map(state), [Some("foreign"); 2], "{now:?}");
    assert_eq!(now.len(), 5, "{now:?}");
    assert_eq!(act(json!({ "do": "end-record" })), 200);
    let ended = listed();
    assert_eq!((ended["now"].as_str(), ended["died"].as_str()), ("complete", "interrupted"), "{ended:?}");
}

#[test]
fn recordings_are_files_that_the_other_commands_read_and_computations_run_on_them() {
    let bench = Bench::start();
    let (_, answer) = bench.api(Role::Operate, "", "POST", "/api/lease", Value::Null);
    let lease = answer["lease"].as_str().unwrap().to_owned();
    let act = |action: Value| bench.api(Role::Operate, &lease, "POST", "/api/act", action);
    for wrong in ["", "../secret", ".hidden", "a/b", "a b"] {
        assert_eq!(act(json!({ "do": "record", "name": wrong })).0, 409, "{wrong}");
    }
    assert_eq!(act(json!({ "do": "record", "name": "first", "note": "a note" })).0, 200);
    std::thread::sleep(Duration::from_millis(300));
    let (code, answer) = act(json!({ "do": "end-record" }));
    assert_eq!(code, 200);
    let samples = answer["recorded"]["samples"].as_u64().unwrap();
    assert!(samples > 200, "{samples}");
    assert_eq!(act(json!({ "do": "record", "name": "first" })).0, 409, "nothing is written over");
    let (_, text) = bench.api(Role::Observe, "", "GET", "/api/recordings/first", Value::Null);
    let lines: Vec<&str> = text.as_str().unwrap().lines().collect();
    assert_eq!(lines[0], "time_s,pressure_bar,displacement_mm,pressure_measured_bar,sequence");
    assert_eq!(lines.len() as u64, samples + 1);
    assert!(lines[1].starts_with("0,") && lines[11].starts_with("0.01,"), "{:?}", &lines[..12]);
    let (_, list) = bench.api(Role::Observe, "", "GET", "/api/recordings", Value::Null);
    assert_eq!(list["recordings"][0]["about"]["note"], "a note");
    assert_eq!(bench.api(Role::Observe, "", "GET", "/api/recordings/..%2Faudit", Value::Null).0, 404);

    let job = json!({ "kind": "count", "recordings": ["first"] });
    assert_eq!(bench.api(Role::Observe, "", "POST", "/api/jobs", job.clone()).0, 403);
    assert_eq!(bench.api(Role::Operate, "", "POST", "/api/jobs", json!({ "kind": "count", "recordings": ["none"] })).0, 409);
    assert_eq!(bench.api(Role::Operate, "", "POST", "/api/jobs", job).0, 200);
    let begun = Instant::now();
    let done = loop {
        let (_, jobs) = bench.api(Role::Observe, "", "GET", "/api/jobs", Value::Null);
        if jobs["jobs"][0]["running"] == false && jobs["jobs"][0]["lines"].as_array().unwrap().len() >= 3 {
            break jobs["jobs"][0].clone();
        }
        assert!(begun.elapsed() < Duration::from_secs(5), "{jobs}");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(done["exit_code"], 0);
    let said: Vec<&str> = done["lines"].as_array().unwrap().iter().map(|line| line.as_str().unwrap()).collect();
    assert_eq!(said, ["twenty", "lines of it", &(samples + 1).to_string()]);
    let (code, head, report) = bench.raw("GET", done["report"].as_str().unwrap(), &[], "");
    assert_eq!((code, report.as_str()), (200, "<script>1</script>"));
    assert!(head.contains("sandbox allow-scripts allow-downloads;"), "{head}");

    // What the second command made goes to the device with the settings that belong to it, for who may configure it.
    assert_eq!(done["model"], true, "{done}");
    let use_it = |role, number| bench.api(role, &lease, "POST", &format!("/api/jobs/{number}/use"), Value::Null);
    assert_eq!(use_it(Role::Configure, 7).0, 409);
    let (code, answer) = use_it(Role::Operate, 1);
    assert!(code == 409 && answer["error"].as_str().unwrap().contains("configure"), "{answer}");
    // The first lease may have run out meanwhile.
    bench.api(Role::Operate, &lease, "DELETE", "/api/lease", Value::Null);
    let (_, answer) = bench.api(Role::Configure, "", "POST", "/api/lease", Value::Null);
    let lease = answer["lease"].as_str().unwrap().to_owned();
    assert_eq!(bench.api(Role::Configure, &lease, "POST", "/api/jobs/1/use", Value::Null).0, 200);
    let (_, settings) = bench.api(Role::Observe, "", "GET", "/api/settings", Value::Null);
    assert_eq!(settings["settings"][0]["value"], 400);
}

#[test]
fn a_recording_that_somebody_has_is_read_or_refused_and_takes_part_like_another() {
    let bench = Bench::start();
    let send = |role: Role, path: &str, body: &str| {
        let bearer = format!("Bearer {}", bench.token(role));
        let (code, _, text) = bench.raw("POST", &format!("/api/recordings/{path}"), &[("Authorization", &bearer)], body);
        (code, serde_json::from_str::<Value>(&text).unwrap_or(Value::String(text)))
    };
    let files = || std::fs::read_dir(bench.folder.path()).unwrap().count();
    let before = files();
    assert_eq!(send(Role::Observe, "mine", "a\n1\n").0, 403);
    for wrong in ["..%2Fmine", ".mine", "a%20b", &"a".repeat(81)] {
        assert_eq!(send(Role::Operate, wrong, "a\n1\n").0, 409, "{wrong}");
    }
    // The reader's own words, with the name that the file has; and nothing is left of it.
    assert_eq!(send(Role::Operate, "mine?file=my%20run.csv", "a\n"), (409, json!({ "error": "my run.csv: no samples" })));
    assert_eq!(files(), before);

    let (code, told) = send(Role::Operate, "mine?file=run.csv&columns=time%3Dt%3Ams", "a\n1\n2\n");
    assert_eq!((code, &told["samples"], &told["notes"]), (200, &json!(2), &json!(["read as time=t:ms"])));
    let (code, told) = send(Role::Operate, "mine", "a\n1\n");
    assert!(code == 409 && told["error"].as_str().unwrap().contains("there is a recording mine already"), "{told}");
    let (_, text) = bench.api(Role::Observe, "", "GET", "/api/recordings/mine", Value::Null);
    assert_eq!(text, "a\n1\n2\n");
    let (_, list) = bench.api(Role::Observe, "", "GET", "/api/recordings", Value::Null);
    let about = &list["recordings"][0]["about"];
    assert_eq!((&about["note"], &about["source"]["columns"]), (&json!("loaded from run.csv"), &json!("time=t:ms")));
    // The session writes the log; it answers after that.
    bench.api(Role::Observe, "", "GET", "/api/state", Value::Null);
    assert!(bench.audit().contains("load of 6 bytes as mine") && bench.audit().contains("no samples"), "{}", bench.audit());
    assert_eq!(bench.api(Role::Operate, "", "POST", "/api/jobs", json!({ "kind": "count", "recordings": ["mine"] })).0, 200);

    // One that is too large is refused by its announced length, before it is sent.
    let most = list["most_bytes"].as_u64().unwrap();
    let bearer = format!("Bearer {}", bench.token(Role::Operate));
    let mut stream = std::net::TcpStream::connect(("127.0.0.1", bench.port)).unwrap();
    let head = format!(
        "POST /api/recordings/large HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: close\r\nAuthorization: {bearer}\r\nContent-Length: {}\r\n\r\n",
        bench.port,
        most + 1
    );
    stream.write_all(head.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 413") && answer.contains("more than 128 MB"), "{answer}");
    assert!(!bench.folder.path().join("large.csv").exists());

    // One that breaks off is not too large: it did not arrive.
    let mut stream = std::net::TcpStream::connect(("127.0.0.1", bench.port)).unwrap();
    let head = format!(
        "POST /api/recordings/broken HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: close\r\nAuthorization: {bearer}\r\nContent-Length: 100\r\n\r\na\n1\n",
        bench.port
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 400") && answer.contains("did not arrive whole"), "{answer}");
    assert!(!bench.folder.path().join("broken.csv").exists());
}

#[tokio::test]
async fn a_viewer_of_robotics_data_sees_every_sample_and_can_do_nothing() {
    let bench = Bench::start();
    let token = bench.token(Role::Configure).to_owned();
    for wrong in ["", "?token=", "?token=00000000000000000000000000000000"] {
        let refused = bench.viewer(wrong, "foxglove.websocket.v1").await.err().unwrap();
        assert!(refused.contains("401"), "{refused}");
    }
    for protocol in ["foxglove.websocket.v1", "foxglove.sdk.v1"] {
        let mut viewer = bench.viewer(&format!("?token={token}"), protocol).await.unwrap();
        let (info, channels) = (viewer.said().await, viewer.said().await);
        assert_eq!((&info["op"], &info["capabilities"]), (&json!("serverInfo"), &json!([])));
        let channel = &channels["channels"][0];
        assert_eq!(
            (&channels["op"], &channel["encoding"], &channel["schemaEncoding"]),
            (&json!("advertise"), &json!("json"), &json!("jsonschema"))
        );
        let schema: Value = serde_json::from_str(channel["schema"].as_str().unwrap()).unwrap();
        let properties = schema["properties"].as_object().unwrap();
        // No word of a viewer moves anything.
        for word in ["vent", "take", "beat", r#"{"op":"advertise","channels":[]}"#] {
            viewer.say(word).await;
        }
        viewer.say(&json!({ "op": "subscribe", "subscriptions": [{ "id": 40, "channelId": channel["id"] }] }).to_string()).await;
        let mut last: Option<(u64, u64)> = None;
        for _ in 0..300 {
            let bytes = viewer.frame().await;
            assert_eq!((bytes[0], &bytes[1..5]), (1, &[40, 0, 0, 0][..]));
            let time_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
            let sample: Value = serde_json::from_slice(&bytes[13..]).unwrap();
            assert!(sample.as_object().unwrap().keys().all(|name| properties.contains_key(name)), "{sample}");
            let sequence = sample["sequence"].as_u64().unwrap();
            assert!(last.is_none_or(|last| last == (sequence - 1, time_ns - 1_000_000)), "{last:?}, then {sequence} at {time_ns} ns");
            assert!(sample["pressure_bar"].is_number() && sample["state"] == "idle", "{sample}");
            last = Some((sequence, time_ns));
        }
        let now_ns = std::time::UNIX_EPOCH.elapsed().unwrap().as_nanos();
        assert!(u128::from(last.unwrap().1).abs_diff(now_ns) < 2_000_000_000, "{last:?} is not now, {now_ns}");
        viewer.say(r#"{"op":"unsubscribe","subscriptionIds":[40]}"#).await;
    }
    assert!(bench.api(Role::Observe, "", "GET", "/api/state", Value::Null).1["lease"].is_null());
    // Somebody else's page may be one, where it knows the token; a name that is not this server's may not.
    assert!(bench.viewer_from(&token, "https://viewer.example", None).await.is_ok());
    let refused = bench.viewer_from(&token, "https://viewer.example", Some("evil.example")).await.err().unwrap();
    assert!(refused.contains("403"), "{refused}");
}

#[test]
fn a_printable_page_is_kept_in_the_folder_and_opened_by_its_secret() {
    let bench = Bench::start();
    assert_eq!(bench.api(Role::Observe, "", "POST", "/api/calibration/page", Value::Null).0, 403);
    let (code, answer) = bench.api(Role::Operate, "", "POST", "/api/calibration/page", Value::Null);
    assert_eq!(code, 200, "{answer}");
    let name = answer["name"].as_str().unwrap();
    assert_eq!(std::fs::read_to_string(bench.folder.path().join(format!("{name}.html"))).unwrap(), "<script>2</script>");
    let (code, head, page) = bench.raw("GET", answer["report"].as_str().unwrap(), &[], "");
    assert_eq!((code, page.as_str()), (200, "<script>2</script>"));
    assert!(head.contains("sandbox allow-scripts"), "{head}");
    assert_eq!(bench.raw("GET", "/reports/00000000000000000000000000000000", &[], "").0, 404);
}

/// Trusts one certificate and no other.
#[derive(Debug)]
struct Pinned {
    fingerprint: String,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, TlsError> {
        let found = Sha256::digest(certificate.as_ref()).iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":");
        if found == self.fingerprint { Ok(ServerCertVerified::assertion()) } else { Err(TlsError::General(format!("certificate {found}"))) }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        verify_tls12_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, TlsError> {
        verify_tls13_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

/// `GET /api/state` in TLS by a client that trusts this fingerprint.
async fn get_in_tls(port: u16, token: &str, fingerprint: &str) -> std::io::Result<String> {
    let provider = Arc::new(ring::default_provider());
    let trusted = Pinned { fingerprint: fingerprint.to_owned(), provider: Arc::clone(&provider) };
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(trusted))
        .with_no_client_auth();
    let stream = TcpStream::connect(("127.0.0.1", port)).await?;
    let name = ServerName::try_from("localhost").unwrap();
    let mut stream = TlsConnector::from(Arc::new(config)).connect(name, stream).await?;
    let request =
        format!("GET /api/state HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    // A server may end without the last word of TLS.
    match stream.read_to_end(&mut answer).await {
        Err(error) if error.kind() != std::io::ErrorKind::UnexpectedEof => Err(error),
        _ => Ok(String::from_utf8_lossy(&answer).into_owned()),
    }
}

#[tokio::test]
async fn tls_accepts_the_printed_certificate_and_no_other_and_no_bare_word_is_heard() {
    let bench = Bench::start_with(|config| config.tls = Tls::SelfSigned);
    let fingerprint = bench.fingerprint.clone().expect("a certificate");
    let token = bench.token(Role::Observe).to_owned();
    // Somebody who begins a handshake and never goes on keeps nobody waiting.
    let _silent = TcpStream::connect(("127.0.0.1", bench.port)).await.unwrap();
    let begun = Instant::now();
    let answer = get_in_tls(bench.port, &token, &fingerprint).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("\"board\":\"fake\""), "{answer}");
    assert!(begun.elapsed() < Duration::from_secs(5), "it waited {:?}", begun.elapsed());
    assert!(get_in_tls(bench.port, "no token", &fingerprint).await.unwrap().starts_with("HTTP/1.1 401"));
    let other = get_in_tls(bench.port, &token, &fingerprint.replace(':', "-")).await.unwrap_err();
    assert!(other.to_string().contains("certificate"), "{other}");
    let mut bare = TcpStream::connect(("127.0.0.1", bench.port)).await.unwrap();
    let request = format!("GET /api/state HTTP/1.1\r\nHost: localhost:{}\r\nAuthorization: Bearer {token}\r\n\r\n", bench.port);
    bare.write_all(request.as_bytes()).await.unwrap();
    let mut answer = Vec::new();
    // An alert of TLS, or a closed connection.
    let _ = bare.read_to_end(&mut answer).await;
    assert!(!answer.starts_with(b"HTTP"), "{}", String::from_utf8_lossy(&answer));
}

#[test]
fn nobody_beyond_this_machine_is_served_without_tls() {
    let folder = tempfile::tempdir().unwrap();
    let bare = Server::bind(dashboard::Config { listen: "0.0.0.0:0".parse().unwrap(), ..config(folder.path()) });
    assert!(matches!(bare.err(), Some(ServeError::Bare(_))));
    let tls = dashboard::Config {
        listen: "0.0.0.0:0".parse().unwrap(),
        tls: Tls::SelfSigned,
        role: Role::Operate,
        names: vec!["rig.lab".to_owned()],
        ..config(folder.path())
    };
    let server = Server::bind(tls).unwrap();
    let addresses = server.addresses();
    assert_eq!(addresses.len(), 2, "no token for configure");
    assert!(addresses[0].1.starts_with("https://rig.lab:") && addresses[0].0 == Role::Operate, "{addresses:?}");
    assert_eq!(server.fingerprint().unwrap().len(), 32 * 3 - 1);
}

#[test]
fn an_upload_of_a_model_needs_the_role_and_the_lease() {
    let bench = Bench::start();
    assert_eq!(bench.api(Role::Configure, "", "POST", "/api/model", json!("blob")).0, 409);
    let (_, answer) = bench.api(Role::Configure, "", "POST", "/api/lease", Value::Null);
    let lease = answer["lease"].as_str().unwrap().to_owned();
    assert_eq!(bench.api(Role::Operate, &lease, "POST", "/api/model", json!("blob")).0, 409);
    assert_eq!(bench.api(Role::Configure, &lease, "POST", "/api/model", json!("blob")).0, 200);
    assert_eq!(bench.api(Role::Configure, &lease, "POST", "/api/act", json!({ "do": "arm" })).0, 200);
    let (code, answer) = bench.api(Role::Configure, &lease, "POST", "/api/model", json!("blob"));
    assert_eq!(code, 409);
    assert!(answer["error"].as_str().unwrap().contains("armed"), "{answer}");
}
