//! Live samples for viewers of robotics data, in the WebSocket protocol of Foxglove, version 1, which PlotJuggler speaks too.
//!
//! There is one channel, with names and schema of the messages in an MCAP recording. To the viewer: `serverInfo`, `advertise` and `status` as JSON, samples in
//! binary messages. From it: `subscribe` and `unsubscribe`. <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use axum::body::Bytes;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use futures_util::{SinkExt, StreamExt};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::oneshot;

use crate::access::Role;
use crate::frame;
use crate::rig::{Phase, Sample};
use crate::session::{Event, Order};
use crate::shared::Shared;
use crate::tls::Peer;

/// Names of the protocol: of Foxglove's own programs, and of those before them and of PlotJuggler.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Where it is served.
pub(crate) const PATH: &str = "/foxglove";
/// No viewer says more at once.
const LONGEST: usize = 16 << 10;
/// A viewer is asked so often whether it is there, and is gone when it has said nothing for three times as long.
const ASKED: Duration = Duration::from_secs(10);
/// Most subscriptions of a viewer: it needs one.
const MOST_SUBSCRIPTIONS: usize = 16;
/// The channel's number.
const CHANNEL: u32 = 1;
/// First byte of a message with data.
const DATA: u8 = 1;

#[derive(Deserialize)]
pub(crate) struct Address {
    token: Option<String>,
}

/// What a viewer says.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Word {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u32,
}

/// A sample with the names that a recording has; what is not there is left out.
#[derive(Serialize)]
struct Named {
    time_s: f64,
    pressure_bar: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    displacement_mm: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pressure_measured_bar: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    estimate_mm: Option<f32>,
    sequence: u32,
    output_bar: f32,
    set_point: f32,
    state: Phase,
    fault: u8,
    notices: u32,
}

impl From<&Sample> for Named {
    fn from(sample: &Sample) -> Self {
        Self {
            time_s: sample.time_ms as f64 * 1e-3,
            pressure_bar: sample.command_bar,
            displacement_mm: sample.displacement_mm,
            pressure_measured_bar: sample.pressure_bar,
            estimate_mm: sample.estimate_mm,
            sequence: sample.sequence,
            output_bar: sample.output_bar,
            set_point: sample.set_point,
            state: sample.phase,
            fault: sample.fault,
            notices: sample.notices,
        }
    }
}

fn schema() -> String {
    let number = json!({ "type": "number" });
    let names = [
        "time_s",
        "pressure_bar",
        "displacement_mm",
        "pressure_measured_bar",
        "estimate_mm",
        "sequence",
        "output_bar",
        "set_point",
        "fault",
        "notices",
    ];
    let mut properties: serde_json::Map<String, serde_json::Value> =
        names.map(|name| (name.to_owned(), number.clone())).into_iter().collect();
    properties.insert("state".to_owned(), json!({ "type": "string" }));
    json!({ "title": "catheter.Sample", "type": "object", "properties": properties }).to_string()
}

/// The device's time on the viewer's clock, ns since 1970.
#[derive(Default)]
struct Clock {
    begun_ns: u64,
    last_ms: Option<u64>,
}

impl Clock {
    fn at(&mut self, time_ms: u64, now: SystemTime) -> u64 {
        // A device that has started again begins anew.
        if self.last_ms.is_none_or(|last| time_ms < last) {
            let now_ns = u64::try_from(now.duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos()).unwrap_or(u64::MAX);
            self.begun_ns = now_ns.saturating_sub(time_ms.saturating_mul(1_000_000));
        }
        self.last_ms = Some(time_ms);
        self.begun_ns.saturating_add(time_ms.saturating_mul(1_000_000))
    }
}

pub(crate) async fn upgrade(
    State(shared): State<Shared>,
    ConnectInfo(Peer(peer)): ConnectInfo<Peer>,
    Query(address): Query<Address>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if address.token.and_then(|token| shared.tokens.role(&token)).is_none() {
        return (StatusCode::UNAUTHORIZED, "the address lacks its token").into_response();
    }
    // Whatever the token allows, a viewer only watches.
    let serve = move |socket| async move {
        if let Some((client, secret)) = shared.clients.enter(format!("viewer at {peer}"), Role::Observe, false) {
            let _ = serve(&shared, socket, client.number).await;
            shared.clients.leave(&secret);
        }
    };
    upgrade.protocols(PROTOCOLS).max_message_size(LONGEST).on_upgrade(serve)
}

fn text(value: &serde_json::Value) -> Message {
    Message::Text(Utf8Bytes::from(value.to_string()))
}

async fn serve(shared: &Shared, socket: WebSocket, number: u64) -> Result<(), axum::Error> {
    let (mut out, mut from) = socket.split();
    let channel = json!({
        "id": CHANNEL, "topic": "/catheter/recording", "encoding": "json", "schemaName": "catheter.Sample", "schemaEncoding": "jsonschema", "schema": schema(),
    });
    out.send(text(&json!({ "op": "serverInfo", "name": "catheter dashboard", "capabilities": [], "sessionId": number.to_string() })))
        .await?;
    out.send(text(&json!({ "op": "advertise", "channels": [channel] }))).await?;
    let (answer, watching) = oneshot::channel();
    if shared.orders.send(Order::Watch(answer)).is_err() {
        return Ok(());
    }
    let Ok(watching) = watching.await else { return Ok(()) };
    let mut events = watching.events;
    let (mut subscribed, mut clock) = (Vec::new(), Clock::default());
    let mut asks = tokio::time::interval(ASKED);
    let mut silent = 0;
    loop {
        tokio::select! {
            said = from.next() => {
                let Some(said) = said.transpose()? else { return Ok(()) };
                silent = 0;
                if let Message::Text(word) = said {
                    heed(&word, &mut subscribed);
                }
            }
            event = events.recv() => match event {
                Ok(Event::Samples(bytes)) if !subscribed.is_empty() => {
                    let now = SystemTime::now();
                    for sample in frame::samples(&bytes) {
                        let time_ns = clock.at(sample.time_ms, now);
                        let data = serde_json::to_vec(&Named::from(&sample)).unwrap_or_default();
                        for id in &subscribed {
                            out.feed(Message::Binary(message(*id, time_ns, &data))).await?;
                        }
                    }
                    out.flush().await?;
                }
                Ok(_) => {}
                Err(RecvError::Lagged(frames)) => {
                    out.send(text(&json!({ "op": "status", "level": 1, "message": format!("{frames} frames of samples were missed") }))).await?;
                }
                Err(RecvError::Closed) => return Ok(()),
            },
            _ = asks.tick() => {
                silent += 1;
                if silent > 3 {
                    return Ok(());
                }
                out.send(Message::Ping(Bytes::new())).await?;
            }
        }
    }
}

fn message(subscription: u32, time_ns: u64, data: &[u8]) -> Bytes {
    let mut bytes = Vec::with_capacity(13 + data.len());
    bytes.push(DATA);
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(time_ns.to_le_bytes());
    bytes.extend(data);
    bytes.into()
}

/// Does what a viewer says; what it does not know it leaves alone.
fn heed(word: &str, subscribed: &mut Vec<u32>) {
    match serde_json::from_str(word) {
        Ok(Word::Subscribe { subscriptions }) => {
            for Subscription { id, channel_id } in subscriptions {
                if channel_id == CHANNEL && !subscribed.contains(&id) && subscribed.len() < MOST_SUBSCRIPTIONS {
                    subscribed.push(id);
                }
            }
        }
        Ok(Word::Unsubscribe { subscription_ids }) => subscribed.retain(|id| !subscription_ids.contains(id)),
        Ok(Word::Other) | Err(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_devices_time_runs_evenly_and_begins_anew_with_it() {
        let at = |seconds| UNIX_EPOCH + Duration::from_secs(seconds);
        let mut clock = Clock::default();
        assert_eq!(clock.at(5_000, at(100)), 100_000_000_000);
        // Whenever the frame arrives.
        assert_eq!(clock.at(5_001, at(107)), 100_001_000_000);
        assert_eq!(clock.at(3, at(200)), 200_000_000_000);
    }

    #[test]
    fn viewers_subscribe_and_other_words_do_nothing() {
        let mut subscribed = Vec::new();
        heed(r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":1},{"id":8,"channelId":2}]}"#, &mut subscribed);
        assert_eq!(subscribed, [7]);
        for word in [
            "",
            "[]",
            r#"{"op":"getParameters"}"#,
            r#"{"op":"subscribe"}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}"#,
        ] {
            heed(word, &mut subscribed);
            assert_eq!(subscribed, [7], "{word}");
        }
        heed(r#"{"op":"unsubscribe","subscriptionIds":[8,7]}"#, &mut subscribed);
        assert!(subscribed.is_empty());
    }
}
