//! The live connection: samples and state to the page, heartbeats and vent from it.
//!
//! From the page, as text: `beat` (a heartbeat), `vent`, `take` and `release` (the lease), `here` (a watcher lives). To the page: binary frames of samples
//! ([`crate::frame`]), and JSON with `kind` `hello`, `state`, `lease` or `missed`.

use std::time::Duration;

use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{mpsc, oneshot};

use crate::access::Role;
use crate::client::Client;
use crate::rig::Action;
use crate::session::{Event, Order};
use crate::shared::Shared;
use crate::tls::Peer;

/// The name of what is spoken.
const PROTOCOL: &str = "catheter.1";
/// A page that says nothing for so long is gone.
const SILENCE: Duration = Duration::from_secs(10);
/// No page sends more than a word.
const LONGEST: usize = 1024;

/// The page's token stands among the protocols it offers: a browser lets no page send other headers here, and an address would be written to logs.
fn token(headers: &HeaderMap) -> Option<&str> {
    let offered = headers.get(header::SEC_WEBSOCKET_PROTOCOL)?.to_str().ok()?;
    offered.split(',').find_map(|offer| offer.trim().strip_prefix("token."))
}

pub(crate) async fn upgrade(
    State(shared): State<Shared>,
    ConnectInfo(Peer(peer)): ConnectInfo<Peer>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    let Some(role) = token(&headers).and_then(|token| shared.tokens.role(token)) else {
        return (StatusCode::UNAUTHORIZED, "the address lacks its token").into_response();
    };
    upgrade.protocols([PROTOCOL]).max_message_size(LONGEST).on_upgrade(move |socket| serve(shared, socket, role, format!("page at {peer}")))
}

async fn serve(shared: Shared, socket: WebSocket, role: Role, name: String) {
    let Some((client, secret)) = shared.clients.enter(name, role, false) else { return };
    let (mut out, mut from) = socket.split();
    let (words, mut to_say) = mpsc::unbounded_channel::<Value>();
    let _ = words.send(json!({ "kind": "hello", "client": secret, "number": client.number, "role": role }));
    let watched = shared.clone();
    // Beside each other: a page that takes samples slowly must not lose its heartbeats.
    let sender = tokio::spawn(async move {
        let (answer, watching) = oneshot::channel();
        if watched.orders.send(Order::Watch(answer)).is_err() {
            return;
        }
        let Ok(watching) = watching.await else { return };
        let mut events = watching.events;
        if let Some(hello) = to_say.recv().await
            && out.send(text(&hello)).await.is_err()
        {
            return;
        }
        for event in watching.past {
            if out.send(message(event)).await.is_err() {
                return;
            }
        }
        loop {
            let next = tokio::select! {
                word = to_say.recv() => match word {
                    Some(word) => text(&word),
                    None => return,
                },
                event = events.recv() => match event {
                    Ok(event) => message(event),
                    Err(RecvError::Lagged(frames)) => text(&json!({ "kind": "missed", "frames": frames })),
                    Err(RecvError::Closed) => return,
                },
            };
            if out.send(next).await.is_err() {
                return;
            }
        }
    });
    while let Ok(Some(Ok(message))) = tokio::time::timeout(SILENCE, from.next()).await {
        let Message::Text(word) = message else { continue };
        if !heed(&shared, &client, word.as_str(), &words).await {
            break;
        }
    }
    sender.abort();
    shared.clients.leave(&secret);
    let _ = shared.orders.send(Order::Release(client));
}

/// Does what the page says; whether the session is still there.
async fn heed(shared: &Shared, client: &Client, word: &str, words: &mpsc::UnboundedSender<Value>) -> bool {
    match word {
        "beat" => shared.orders.send(Order::Renew(client.number, None)).is_ok(),
        "vent" => {
            let (answer, _) = oneshot::channel();
            shared.orders.send(Order::Act(client.clone(), Action::Vent, answer)).is_ok()
        }
        "take" => {
            let (answer, taken) = oneshot::channel();
            if shared.orders.send(Order::Take(client.clone(), answer)).is_err() {
                return false;
            }
            let Ok(taken) = taken.await else { return false };
            words.send(json!({ "kind": "lease", "taken": taken.is_ok(), "holder": taken.err() })).is_ok()
        }
        "release" => shared.orders.send(Order::Release(client.clone())).is_ok(),
        _ => true,
    }
}

fn text(value: &Value) -> Message {
    Message::Text(Utf8Bytes::from(value.to_string()))
}

fn message(event: Event) -> Message {
    match event {
        Event::Samples(bytes) => Message::Binary(bytes),
        Event::State(state) => Message::Text(Utf8Bytes::from(&*state)),
    }
}
