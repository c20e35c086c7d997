//! The same state and actions for scripts, as JSON under `/api/`; `docs/reference/dashboard-interface.md` describes them.

use axum::Json;
use axum::body::Bytes;
use axum::extract::{ConnectInfo, FromRequestParts, Path, Query, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt as _;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::oneshot;

use crate::access::Role;
use crate::client::Client;
use crate::folder;
use crate::jobs::{Wanted, recording_path};
use crate::load::{self, Foreign, MOST_BYTES};
use crate::rig::{Action, Problem, Sample};
use crate::session::{Answer, Order};
use crate::shared::Shared;
use crate::tls::Peer;

/// Header with the secret of a client: that of a lease, or that of a page.
const LEASE: &str = "x-lease";

/// A refusal with its reason.
pub(crate) struct Refused(StatusCode, String);

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        (self.0, Json(json!({ "error": self.1 }))).into_response()
    }
}

impl From<Problem> for Refused {
    fn from(problem: Problem) -> Self {
        let code = match problem {
            Problem::Refused(_) => StatusCode::CONFLICT,
            Problem::Gone(_) => StatusCode::SERVICE_UNAVAILABLE,
        };
        Self(code, problem.to_string())
    }
}

type Answered<T = Json<Value>> = Result<T, Refused>;

/// A role that a token has proven.
pub(crate) struct Proven(Role);

impl FromRequestParts<Shared> for Proven {
    type Rejection = Refused;

    async fn from_request_parts(parts: &mut Parts, shared: &Shared) -> Result<Self, Refused> {
        let token =
            parts.headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok()).and_then(|value| value.strip_prefix("Bearer "));
        let role = token.and_then(|token| shared.tokens.role(token));
        role.map(Self).ok_or_else(|| Refused(StatusCode::UNAUTHORIZED, "`Authorization: Bearer TOKEN` is wanted".to_owned()))
    }
}

/// Gives an order and waits for the answer.
async fn ask<T>(shared: &Shared, order: impl FnOnce(Answer<T>) -> Order) -> Answered<T> {
    let closed = || Refused(StatusCode::SERVICE_UNAVAILABLE, "the session has ended".to_owned());
    let (answer, answered) = oneshot::channel();
    shared.orders.send(order(answer)).map_err(|_| closed())?;
    answered.await.map_err(|_| closed())
}

/// The client that the header names. What only needs a role is done in the name of a client without a lease.
fn client(shared: &Shared, headers: &HeaderMap, role: Role, peer: Peer) -> Client {
    let named = headers.get(LEASE).and_then(|secret| secret.to_str().ok()).and_then(|secret| shared.clients.find(secret));
    // The token decides: a client's secret gives no more than it.
    named.filter(|client| client.role <= role).unwrap_or_else(|| Client {
        number: 0,
        name: format!("script at {}", peer.0),
        role,
        script: true,
    })
}

pub(crate) async fn state(_: Proven, State(shared): State<Shared>) -> Answered<Response> {
    let state = ask(&shared, Order::State).await?;
    Ok(([(header::CONTENT_TYPE, "application/json")], state.to_string()).into_response())
}

#[derive(Deserialize)]
pub(crate) struct Last {
    last: Option<usize>,
}

pub(crate) async fn samples(_: Proven, State(shared): State<Shared>, Query(query): Query<Last>) -> Answered {
    let count = query.last.unwrap_or(1);
    let samples = ask(&shared, |answer| Order::Samples(count, answer)).await?;
    let column = |value: fn(&Sample) -> Value| samples.iter().map(value).collect::<Vec<_>>();
    Ok(Json(json!({
        "time_ms": column(|sample| sample.time_ms.into()),
        "sequence": column(|sample| sample.sequence.into()),
        "state": column(|sample| json!(sample.phase)),
        "fault": column(|sample| sample.fault.into()),
        "notices": column(|sample| sample.notices.into()),
        "command_bar": column(|sample| sample.command_bar.into()),
        "output_bar": column(|sample| sample.output_bar.into()),
        "set_point": column(|sample| sample.set_point.into()),
        "pressure_bar": column(|sample| sample.pressure_bar.into()),
        "displacement_mm": column(|sample| sample.displacement_mm.into()),
        "estimate_mm": column(|sample| sample.estimate_mm.into()),
        "laser_code": column(|sample| sample.laser_code.into()),
        "pressure_code": column(|sample| sample.pressure_code.into()),
        "late_ticks": column(|sample| sample.late_ticks.into()),
        "longest_tick_cycles": column(|sample| sample.longest_tick_cycles.into()),
    })))
}

pub(crate) async fn settings(_: Proven, State(shared): State<Shared>) -> Answered {
    let settings = ask(&shared, Order::Settings).await??;
    Ok(Json(json!({ "settings": settings })))
}

pub(crate) async fn preview(_: Proven, State(shared): State<Shared>, Json(excitation): Json<Value>) -> Answered {
    let preview = ask(&shared, |answer| Order::Preview(excitation, answer)).await??;
    Ok(Json(json!(preview)))
}

pub(crate) async fn reference(_: Proven, State(shared): State<Shared>, Json(reference): Json<Value>) -> Answered {
    Ok(Json(ask(&shared, |answer| Order::Reference(reference, answer)).await??))
}

pub(crate) async fn controllers(_: Proven, State(shared): State<Shared>) -> Answered {
    Ok(Json(ask(&shared, Order::Controllers).await??))
}

pub(crate) async fn calibration(_: Proven, State(shared): State<Shared>) -> Answered {
    Ok(Json(ask(&shared, Order::Calibration).await??))
}

/// Writes the page of the calibration into the folder, and tells where it can be opened.
pub(crate) async fn calibration_page(Proven(role): Proven, State(shared): State<Shared>) -> Answered {
    operates(role)?;
    let page = ask(&shared, Order::CalibrationPage).await??;
    let name = format!("calibration-{}", crate::audit::now().replace([':', '.'], "-"));
    let path = shared.folder.join(format!("{name}.html"));
    let written = path.clone();
    let problem = |error: std::io::Error| Refused(StatusCode::INTERNAL_SERVER_ERROR, error.to_string());
    aside(move || std::fs::write(written, page)).await?.map_err(problem)?;
    let report = shared.jobs.publish(path).map_err(|error| Refused(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    Ok(Json(json!({ "name": name, "report": report })))
}

pub(crate) async fn take(Proven(role): Proven, State(shared): State<Shared>, ConnectInfo(peer): ConnectInfo<Peer>) -> Answered {
    let full = || Refused(StatusCode::SERVICE_UNAVAILABLE, "there are too many clients".to_owned());
    let (client, secret) = shared.clients.enter(format!("script at {}", peer.0), role, true).ok_or_else(full)?;
    let taken = ask(&shared, |answer| Order::Take(client, answer)).await?;
    match taken {
        Ok(()) => Ok(Json(json!({ "lease": secret }))),
        Err(holder) => {
            shared.clients.leave(&secret);
            Err(Refused(StatusCode::CONFLICT, format!("{} operates the rig", holder.name)))
        }
    }
}

pub(crate) async fn renew(
    Proven(role): Proven,
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    headers: HeaderMap,
) -> Answered {
    let client = client(&shared, &headers, role, peer);
    if ask(&shared, |answer| Order::Renew(client.number, Some(answer))).await? {
        Ok(Json(json!({ "renewed": true })))
    } else {
        Err(Refused(StatusCode::CONFLICT, "this lease has run out; take control again".to_owned()))
    }
}

pub(crate) async fn release(
    Proven(role): Proven,
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    headers: HeaderMap,
) -> Answered {
    let client = client(&shared, &headers, role, peer);
    if let Some(secret) = headers.get(LEASE).and_then(|secret| secret.to_str().ok())
        && client.script
    {
        shared.clients.leave(secret);
    }
    let _ = shared.orders.send(Order::Release(client));
    Ok(Json(json!({ "released": true })))
}

pub(crate) async fn act(
    Proven(role): Proven,
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    headers: HeaderMap,
    Json(action): Json<Action>,
) -> Answered {
    let client = client(&shared, &headers, role, peer);
    Ok(Json(ask(&shared, |answer| Order::Act(client, action, answer)).await??))
}

pub(crate) async fn upload(
    Proven(role): Proven,
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    headers: HeaderMap,
    blob: Bytes,
) -> Answered {
    let client = client(&shared, &headers, role, peer);
    Ok(Json(ask(&shared, |answer| Order::Upload(client, blob, Vec::new(), answer)).await??))
}

/// Does what waits for the disk elsewhere: this thread brings heartbeats.
async fn aside<T: Send + 'static>(does: impl FnOnce() -> T + Send + 'static) -> Answered<T> {
    let ended = |_| Refused(StatusCode::INTERNAL_SERVER_ERROR, "the server failed at a file".to_owned());
    tokio::task::spawn_blocking(does).await.map_err(ended)
}

pub(crate) async fn recordings(_: Proven, State(shared): State<Shared>) -> Answered {
    let folder = shared.folder.clone();
    // Asked before and after: one may begin or end while the folder is read.
    let before = ask(&shared, Order::Recording).await?;
    let mut recordings = aside(move || folder::list(&folder)).await?;
    let after = ask(&shared, Order::Recording).await?;
    before.iter().chain(&after).for_each(|name| folder::mark_running(&mut recordings, name));
    Ok(Json(json!({ "folder": shared.folder.display().to_string(), "most_bytes": MOST_BYTES, "recordings": recordings })))
}

pub(crate) async fn recording(_: Proven, State(shared): State<Shared>, Path(name): Path<String>) -> Answered<Response> {
    let missing = || Refused(StatusCode::NOT_FOUND, "there is no such recording".to_owned());
    let path = recording_path(&shared.folder, name.trim_end_matches(".csv")).ok_or_else(missing)?;
    let text = aside(move || std::fs::read(path)).await?.map_err(|_| missing())?;
    Ok(([(header::CONTENT_TYPE, "text/csv")], text).into_response())
}

#[derive(Deserialize)]
pub(crate) struct Source {
    /// Name of the file, for what is said of it.
    file: Option<String>,
    /// As `--columns`.
    columns: Option<String>,
}

/// A recording that somebody has: read, refused or written beside the others.
pub(crate) async fn load(
    Proven(role): Proven,
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    Path(name): Path<String>,
    Query(source): Query<Source>,
    request: Request,
) -> Answered {
    operates(role)?;
    let too_large = || {
        let remedy = format!("a file of more than {} MB is not loaded; put it into {}", MOST_BYTES >> 20, shared.folder.display());
        Refused(StatusCode::PAYLOAD_TOO_LARGE, remedy)
    };
    // What is announced as too large is refused before it is sent.
    let (parts, body) = request.into_parts();
    let announced = parts.headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<usize>().ok());
    if announced.is_some_and(|length| length > MOST_BYTES) {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    let mut pieces = body.into_data_stream();
    while let Some(piece) = pieces.next().await {
        let broken_off = |_| Refused(StatusCode::BAD_REQUEST, "the file did not arrive whole; load it again".to_owned());
        bytes.extend_from_slice(&piece.map_err(broken_off)?);
        if bytes.len() > MOST_BYTES {
            return Err(too_large());
        }
    }
    let who = client(&shared, &parts.headers, role, peer).name;
    let what = format!("load of {} bytes as {name}", bytes.len());
    let (loader, folder) = (shared.loader, std::sync::Arc::clone(&shared.folder));
    let read = move || {
        let (file, columns) = (source.file.as_deref().unwrap_or(&name), source.columns.as_deref().filter(|text| !text.is_empty()));
        load::load(loader, &folder, &name, &Foreign { name: file, bytes: &bytes, columns })
    };
    let loaded = aside(read).await?;
    let outcome = loaded.as_ref().map_or_else(Clone::clone, |_| "done".to_owned());
    let _ = shared.orders.send(Order::Note { who, what, outcome });
    loaded.map(|loaded| Json(json!(loaded))).map_err(|problem| Refused(StatusCode::CONFLICT, problem))
}

pub(crate) async fn jobs(_: Proven, State(shared): State<Shared>) -> Answered {
    Ok(Json(json!({ "kinds": shared.jobs.kinds(), "jobs": shared.jobs.told() })))
}

fn operates(role: Role) -> Answered<()> {
    if role >= Role::Operate { Ok(()) } else { Err(Refused(StatusCode::FORBIDDEN, "this needs the role operate".to_owned())) }
}

pub(crate) async fn begin_job(Proven(role): Proven, State(shared): State<Shared>, Json(wanted): Json<Wanted>) -> Answered {
    operates(role)?;
    let told = shared.jobs.begin(&wanted).map_err(|problem| Refused(StatusCode::CONFLICT, problem))?;
    Ok(Json(json!(told)))
}

/// Puts what a computation made onto the device: its model, and the settings that belong to it.
pub(crate) async fn use_result(
    Proven(role): Proven,
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    headers: HeaderMap,
    Path(number): Path<u32>,
) -> Answered {
    let client = client(&shared, &headers, role, peer);
    let files = shared.jobs.result(number).map_err(|problem| Refused(StatusCode::CONFLICT, problem))?;
    let read = aside(move || files.read()).await?.map_err(|problem| Refused(StatusCode::CONFLICT, problem))?;
    Ok(Json(ask(&shared, |answer| Order::Upload(client, read.0.into(), read.1, answer)).await??))
}

pub(crate) async fn end_job(Proven(role): Proven, State(shared): State<Shared>) -> Answered {
    operates(role)?;
    Ok(Json(json!({ "ended": shared.jobs.end() })))
}

/// A report, which has scripts of its own: in a sandbox, where it can reach nothing; it may hand its plots and tables to the person who asks for them.
pub(crate) async fn report(State(shared): State<Shared>, Path(secret): Path<String>) -> Response {
    let Some(path) = shared.jobs.report(&secret) else { return StatusCode::NOT_FOUND.into_response() };
    let Ok(Ok(text)) = aside(move || std::fs::read(path)).await else { return StatusCode::NOT_FOUND.into_response() };
    let policy = "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'";
    ([(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, policy)], text).into_response()
}
