//! What the server gives to whom: tokens, Host and Origin, the page, frames, recordings, computations, TLS.

mod support;

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
