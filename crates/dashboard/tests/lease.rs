//! The lease from end to end: who operates, and what becomes of the rig when the operator is gone.

mod support;

use std::time::{Duration, Instant};

use dashboard::{Phase, Role};
use serde_json::{Value, json};
use support::fake::HOST_TIMEOUT;
use support::{Bench, Page};

/// 50 ms for whatever runs between the operator and the device, and as much for a busy machine.
const MARGIN: Duration = Duration::from_millis(100);

/// A page that operates a running rig.
async fn running(bench: &Bench) -> Page {
    let mut page = bench.page(Role::Operate).await;
    page.say("take").await;
    assert_eq!(page.word("lease").await["taken"], true);
    let act = |action: Value| bench.api(Role::Operate, &page.client, "POST", "/api/act", action);
    assert_eq!(act(json!({ "do": "arm" })).0, 200);
    assert_eq!(act(json!({ "do": "start", "value": 1.0 })).0, 200);
    page
}

fn safe_at(bench: &Bench) -> Instant {
    bench.wait("the rig to be safe", |watched| !watched.phase().is_energised());
    bench.watched.lock().unwrap().phases.last().unwrap().0
}

#[tokio::test]
async fn heartbeats_keep_the_rig_running_and_nothing_else_does() {
    let bench = Bench::start();
    let mut page = running(&bench).await;
    page.live_for(Duration::from_millis(800)).await;
    assert_eq!(bench.watched.lock().unwrap().phase(), Phase::Running);
    let spoke = Instant::now();
    // The connection stays open, and watchers' words are no heartbeats.
    for _ in 0..10 {
        page.say("here").await;
        tokio::time::sleep(Duration::from_millis(40)).await;
    }
    let safe = safe_at(&bench) - spoke;
    assert!(safe <= HOST_TIMEOUT + MARGIN, "safe {safe:?} after the last heartbeat");
    let last = *bench.watched.lock().unwrap().renewals.last().unwrap();
    assert!(last <= spoke + Duration::from_millis(20), "renewed {:?} after the last heartbeat", last - spoke);
    assert!(bench.audit().contains("ran out"));
}

#[tokio::test]
async fn a_page_that_is_gone_vents_the_rig() {
    let bench = Bench::start();
    let mut page = running(&bench).await;
    page.live_for(Duration::from_millis(200)).await;
    let gone = Instant::now();
    drop(page);
    let safe = safe_at(&bench) - gone;
    assert!(safe <= HOST_TIMEOUT + MARGIN, "safe {safe:?} after the page was gone");
}

#[tokio::test]
async fn a_server_that_is_asked_to_end_leaves_the_rig_vented() {
    let mut bench = Bench::start();
    let page = running(&bench).await;
    bench.stop();
    let watched = bench.watched.lock().unwrap();
    assert!(watched.closed && watched.phase() == Phase::Idle);
    drop(page);
}

#[tokio::test]
async fn one_operates_the_others_watch_and_all_may_vent() {
    let bench = Bench::start();
    let mut first = running(&bench).await;
    let mut second = bench.page(Role::Configure).await;
    second.say("take").await;
    let refused = second.word("lease").await;
    assert_eq!((&refused["taken"], &refused["holder"]["client"]), (&json!(false), &json!(1)));
    first.say("beat").await;
    let (code, answer) = bench.api(Role::Configure, &second.client, "POST", "/api/act", json!({ "do": "hold", "value": 2.0 }));
    assert_eq!(code, 409);
    assert!(answer["error"].as_str().unwrap().contains("operates the rig"), "{answer}");
    first.say("beat").await;
    let (code, _) = bench.api(Role::Operate, &first.client, "POST", "/api/act", json!({ "do": "hold", "value": 0.5 }));
    assert_eq!(code, 200);
    assert_eq!(bench.watched.lock().unwrap().held, [0.5]);
    let mut third = bench.page(Role::Observe).await;
    third.say("take").await;
    assert_eq!(third.word("lease").await["taken"], false);
    first.say("beat").await;
    third.say("vent").await;
    bench.wait("the vent", |watched| watched.phase() == Phase::Idle);
    // The first gives control back, and the second takes it.
    first.say("release").await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    second.say("take").await;
    assert_eq!(second.word("lease").await["taken"], true);
}

#[test]
fn scripts_operate_with_a_lease_of_their_own() {
    let bench = Bench::start();
    let (code, answer) = bench.api(Role::Operate, "", "POST", "/api/act", json!({ "do": "arm" }));
    assert_eq!((code, answer["error"].as_str().unwrap()), (409, "take control first"));
    let (code, answer) = bench.api(Role::Operate, "", "POST", "/api/lease", Value::Null);
    let lease = answer["lease"].as_str().unwrap().to_owned();
    assert_eq!((code, lease.len()), (200, 32));
    assert_eq!(bench.api(Role::Operate, "", "POST", "/api/lease", Value::Null).0, 409);
    assert_eq!(bench.api(Role::Operate, &lease, "POST", "/api/act", json!({ "do": "arm" })).0, 200);
    assert_eq!(bench.api(Role::Operate, &lease, "POST", "/api/act", json!({ "do": "start", "value": 0.5 })).0, 200);
    for _ in 0..8 {
        assert_eq!(bench.api(Role::Operate, &lease, "POST", "/api/lease/renew", Value::Null).0, 200);
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(bench.watched.lock().unwrap().phase(), Phase::Running);
    let (_, state) = bench.api(Role::Observe, "", "GET", "/api/state", Value::Null);
    assert_eq!(state["rig"]["phase"], "running");
    let (_, samples) = bench.api(Role::Observe, "", "GET", "/api/samples?last=3", Value::Null);
    assert_eq!(samples["pressure_bar"].as_array().unwrap().len(), 3);
    assert!(samples["pressure_bar"][2].as_f64().unwrap() > 0.4);
    let last = Instant::now();
    assert!(safe_at(&bench) - last <= HOST_TIMEOUT + MARGIN);
    assert_eq!(bench.api(Role::Operate, &lease, "POST", "/api/lease/renew", Value::Null).0, 409);
}

#[test]
fn roles_bound_what_may_be_done() {
    let bench = Bench::start();
    let set = json!({ "do": "set", "name": "limits.host_timeout_ms", "value": 300 });
    assert_eq!(bench.api(Role::Observe, "", "POST", "/api/lease", Value::Null).0, 409);
    let take = |role| bench.api(role, "", "POST", "/api/lease", Value::Null).1["lease"].as_str().unwrap().to_owned();
    let lease = take(Role::Operate);
    let (code, answer) = bench.api(Role::Operate, &lease, "POST", "/api/act", set.clone());
    assert_eq!(code, 409);
    assert!(answer["error"].as_str().unwrap().contains("configure"), "{answer}");
    // The secret of a better client does not make up for a worse token.
    assert_eq!(bench.api(Role::Operate, &lease, "DELETE", "/api/lease", Value::Null).0, 200);
    let lease = take(Role::Configure);
    assert_eq!(bench.api(Role::Operate, &lease, "POST", "/api/act", set.clone()).0, 409);
    assert_eq!(bench.api(Role::Configure, &lease, "POST", "/api/act", set).0, 200);
    let (_, settings) = bench.api(Role::Observe, "", "GET", "/api/settings", Value::Null);
    assert_eq!((&settings["settings"][0]["value"], &settings["settings"][0]["saved"]), (&json!(300), &json!(250)));
    let audit = bench.audit();
    assert!(audit.contains("host_timeout_ms") && audit.contains("needs the role configure"), "{audit}");
}

#[tokio::test]
async fn a_rig_that_is_gone_is_told_and_found_again() {
    let bench = Bench::start();
    let mut page = bench.page(Role::Observe).await;
    bench.watched.lock().unwrap().cut = true;
    let problem = loop {
        let state = page.word("state").await;
        if let Some(problem) = state["problem"].as_str() {
            break problem.to_owned();
        }
    };
    assert!(problem.contains("gone") || problem.contains("no such port"), "{problem}");
    bench.watched.lock().unwrap().cut = false;
    while !page.word("state").await["problem"].is_null() {}
    page.frame().await;
}

/// What became of a task, and when.
fn task_ended(bench: &Bench) -> String {
    bench.wait("the end of the task", |watched| watched.task_ended.is_some());
    bench.watched.lock().unwrap().task_ended.clone().unwrap()
}

#[tokio::test]
async fn a_task_is_the_operators_and_ends_with_the_lease_even_where_nothing_is_energised() {
    let bench = Bench::start();
    let begin = json!({ "do": "calibrate", "step": "laser" });
    let mut watcher = bench.page(Role::Configure).await;
    assert_eq!(bench.api(Role::Configure, &watcher.client, "POST", "/api/act", begin.clone()).0, 409);
    for (role, leaves) in [(Role::Operate, true), (Role::Operate, false)] {
        let mut page = bench.page(role).await;
        page.say("take").await;
        assert_eq!(page.word("lease").await["taken"], true);
        let act = |action: Value| bench.api(role, &page.client, "POST", "/api/act", action).0;
        assert_eq!(act(begin.clone()), 200);
        let told = loop {
            let state = watcher.word("state").await;
            if !state["rig"]["task"].is_null() {
                break state["rig"]["task"].clone();
            }
        };
        assert_eq!((&told["name"], &told["asks"]["value"]), (&json!("laser"), &json!(2.0)));
        assert_eq!(act(json!({ "do": "answer", "value": 2.5 })), 200);
        // What is found changes settings.
        assert_eq!(act(json!({ "do": "accept" })), 409);
        assert_eq!(bench.api(Role::Configure, &watcher.client, "POST", "/api/act", json!({ "do": "answer", "value": 9.0 })).0, 409);
        assert_eq!(bench.watched.lock().unwrap().held.last(), Some(&2.5));
        page.say("beat").await;
        if leaves {
            drop(page);
            assert_eq!(task_ended(&bench), "the operator left");
        } else {
            // A page that hangs beside a vented rig keeps its place for two seconds, and then loses task and lease.
            let spoke = Instant::now();
            assert_eq!(task_ended(&bench), "the operator fell silent");
            assert!(spoke.elapsed() <= Duration::from_secs(2) + MARGIN, "{:?}", spoke.elapsed());
            drop(page);
        }
        bench.watched.lock().unwrap().task_ended = None;
        watcher.say("here").await;
    }
}

#[tokio::test]
async fn anybody_may_vent_a_task() {
    let bench = Bench::start();
    let mut page = bench.page(Role::Operate).await;
    page.say("take").await;
    assert_eq!(page.word("lease").await["taken"], true);
    assert_eq!(bench.api(Role::Operate, &page.client, "POST", "/api/act", json!({ "do": "calibrate", "step": "noise" })).0, 200);
    let mut watcher = bench.page(Role::Observe).await;
    watcher.say("vent").await;
    assert_eq!(task_ended(&bench), "vented");
}
