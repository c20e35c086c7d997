//! What the server gives to whom: tokens, Host and Origin, the page, frames, recordings, computations, TLS.

mod support;

use std::time::{Duration, Instant};

use dashboard::{HEADER_BYTES, Role, SAMPLE_BYTES, ServeError, Server, Tls};
use serde_json::{Value, json};
use support::{Bench, config};

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
