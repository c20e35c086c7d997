//! Tabs, pages, networks and servers that die while the rig is under pressure: the board vents, measured by its own clock.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::board::Board;
use crate::browser::{Browser, Look, Served};
use crate::network::{Failure, Network};

/// The default of `limits.host_timeout_ms`, and the margin.
const SAFE_WITHIN: Duration = Duration::from_millis(250 + 50);
/// How often a rig that vented because the machine was busy is started anew.
const ATTEMPTS: u32 = 8;

/// What runs on the board when somebody dies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    /// A set-point, by hand.
    Hold,
    /// The valve's step of the calibration.
    Calibrate,
    /// A reference, by a controller.
    Follow,
}

impl Work {
    /// The button that begins it, as a selector, and the pressure that shows that it has begun, bar.
    fn begins(self) -> (&'static str, &'static str, f64) {
        match self {
            Self::Hold => ("excitation", "#arm", 1.4),
            Self::Calibrate => ("calibrate", "#calibrate-steps button[data-step=valve]", 0.4),
            Self::Follow => ("reference", "#reference-go", 0.2),
        }
    }
}

/// Runs the board from a page, at the default timeout. On a busy machine a heartbeat may come too late, and it is begun anew.
async fn run_board(board: &Board, browser: &Browser, work: Work) {
    let (tab, button, enough_bar) = work.begins();
    browser.click(&format!("tab-{tab}")).await;
    let next = format!(
        "const shown = (it) => it && !it.hidden && !it.disabled;
         document.getElementById('slider').value = 1.5;
         for (const it of ['#take', '#acknowledge', '{button}', '#start'].map((it) => document.querySelector(it)))
           if (shown(it)) {{ it.click(); return it.id; }}"
    );
    for attempt in 1..=ATTEMPTS {
        let until = Instant::now() + Duration::from_secs(5);
        while Instant::now() < until {
            browser.run(&next).await;
            tokio::time::sleep(Duration::from_millis(250)).await;
            let now = board.last();
            if now.energised && now.pressure_bar > enough_bar {
                return;
            }
        }
        println!("attempt {attempt}: this machine is too busy for the heartbeats");
    }
    panic!("the board does not keep running");
}

/// Makes a page hang for three seconds: its connection is open and it says nothing; it tells afterwards since when.
async fn hang(browser: &Browser) -> Instant {
    browser.run("setTimeout(() => { window.hungAt = Date.now(); while (Date.now() < window.hungAt + 3000); }, 0)").await;
    let hung_ms = browser.run("return window.hungAt").await.as_f64().expect("a time");
    let now_ms = SystemTime::now().duration_since(UNIX_EPOCH).expect("a clock").as_secs_f64() * 1e3;
    Instant::now() - Duration::from_secs_f64((now_ms - hung_ms) * 1e-3)
}

/// When the outputs were safe after something died, and the pressure a second later.
fn measure(board: &Board, what: &str, died: Instant) {
    assert!(board.first_since(died, |_| true).energised, "{what}: it had vented before; this machine is too busy");
    let safe = board.first_since(died, |tick| !tick.energised);
    let later = board.first_since(safe.at + Duration::from_secs(1), |_| true);
    println!("{what}: outputs safe after {} ms, {:.4} bar one second later", (safe.at - died).as_millis(), later.pressure_bar);
    assert!(safe.at - died <= SAFE_WITHIN, "{what}: outputs safe only after {:?}", safe.at - died);
    assert!(later.pressure_bar < 0.1, "{what}: {} bar a second later", later.pressure_bar);
    assert!(!board.was_energised(safe.at, later.at), "{what}: it went on");
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_killed_server_leaves_a_rig_that_vents_by_itself() {
    let board = Board::start();
    let mut served = Served::start(&["--backend", &format!("serial:{}", board.port)]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    run_board(&board, &browser, Work::Hold).await;
    let died = Instant::now();
    served.child.kill().expect("the server can be killed");
    measure(&board, "server killed", died);
    browser.until("the message", "return document.getElementById('banner').textContent.includes('No connection')").await;
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_killed_tab_leaves_a_rig_that_vents() {
    let board = Board::start();
    let served = Served::start(&["--backend", &format!("serial:{}", board.port)]);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    run_board(&board, &browser, Work::Hold).await;
    let died = Instant::now();
    browser.client.close_window().await.expect("the tab closes");
    measure(&board, "tab closed", died);

    let browser = Browser::open(Look::Desktop, &served.address).await;
    run_board(&board, &browser, Work::Hold).await;
    let hung = hang(&browser).await;
    measure(&board, "page hangs", hung);
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_cut_network_leaves_a_rig_that_vents() {
    network_fails(Failure::Silent).await;
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_network_that_closes_every_connection_leaves_a_rig_that_vents() {
    network_fails(Failure::Closed).await;
}

async fn network_fails(failure: Failure) {
    let board = Board::start();
    let port = format!("serial:{}", board.port);
    let served = Served::start(&["--backend", &port, "--listen", "127.0.0.1", "--role", "configure", "--name", "127.0.0.2"]);
    let between = Ipv4Addr::new(127, 0, 0, 2);
    let network = Network::before(served.port(), between);
    let browser = Browser::open(Look::Desktop, &served.address.replace("127.0.0.1", &between.to_string())).await;
    run_board(&board, &browser, Work::Hold).await;
    let died = network.fail(failure);
    measure(&board, &format!("network {failure:?}"), died);
    browser.until("the message", "return document.getElementById('banner').textContent.includes('No connection')").await;
}

/// A killed server, a closed tab and a page that hangs, each while this runs.
async fn everybody_dies_during(work: Work) {
    let board = Board::start();
    let arguments = ["--backend", &format!("serial:{}", board.port)];
    let mut served = Served::start(&arguments);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    run_board(&board, &browser, work).await;
    let hung = hang(&browser).await;
    measure(&board, &format!("page hangs, {work:?}"), hung);

    run_board(&board, &browser, work).await;
    let died = Instant::now();
    browser.client.close_window().await.expect("the tab closes");
    measure(&board, &format!("tab closed, {work:?}"), died);
    assert!(served.audit().contains("vent: the operator"), "{}", served.audit());
    assert!(served.api("/api/state")["rig"]["task"].is_null(), "the task outlives its operator");

    drop(browser);
    let browser = Browser::open(Look::Desktop, &served.address).await;
    run_board(&board, &browser, work).await;
    let died = Instant::now();
    served.child.kill().expect("the server can be killed");
    measure(&board, &format!("server killed, {work:?}"), died);
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_calibration_whose_operator_dies_leaves_a_rig_that_vents() {
    everybody_dies_during(Work::Calibrate).await;
}

#[tokio::test]
#[ignore = "needs Chromium and its driver: cargo xtask setup"]
async fn a_reference_whose_operator_dies_leaves_a_rig_that_vents() {
    everybody_dies_during(Work::Follow).await;
}
