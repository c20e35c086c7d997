//! The server: what listens where, which routes there are, and what every answer carries.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, mpsc};

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{any, get, post};
use tokio::sync::{broadcast, oneshot};

use crate::access::{Names, Role, Tokens};
use crate::audit::Audit;
use crate::client::Clients;
use crate::jobs::{self, Jobs};
use crate::load::Loader;
use crate::opening::Opener;
use crate::session::{Event, Order, Session};
use crate::shared::Shared;
use crate::tls::{self, Listener, Peer, Tls};
use crate::{api, assets, socket, viewer};

/// Events that a slow watcher may lag behind: ten seconds of frames.
const EVENTS: usize = 512;

/// The page loads nothing from elsewhere, runs no inline script, and stands in nobody's frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// What a server is told.
pub struct Config {
    /// Where to listen; port 0 picks a free one.
    pub listen: SocketAddr,
    /// Names under which others reach this machine.
    pub names: Vec<String>,
    /// The most that anybody may do; a token is made for each role up to it.
    pub role: Role,
    /// TLS; off is refused beyond loopback.
    pub tls: Tls,
    /// Recordings, what was computed of them, and the audit log.
    pub folder: PathBuf,
    /// What can be computed of recordings.
    pub jobs: Jobs,
    /// How a recording is read that somebody has.
    pub loader: Loader,
}

/// Why nothing is served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address cannot be used.
    #[error("{address}: cannot listen there ({problem}); another port is picked with --port 0")]
    Listen {
        /// Which.
        address: SocketAddr,
        /// What the system said.
        problem: std::io::Error,
    },
    /// A rig is not for everybody on the network.
    #[error("{0} is beyond this machine, where nobody may operate a rig without TLS")]
    Bare(SocketAddr),
    /// Certificate or key.
    #[error("TLS: {0}")]
    Tls(String),
    /// The folder cannot be written.
    #[error("{path}: cannot be written ({problem})")]
    Folder {
        /// Which.
        path: PathBuf,
        /// What the system said.
        problem: std::io::Error,
    },
    /// Something of the system.
    #[error("{0}")]
    System(#[from] std::io::Error),
    /// No random numbers.
    #[error("the system gives no random numbers: {0}")]
    Random(#[from] getrandom::Error),
}

/// A server that listens and serves nothing yet.
pub struct Server {
    listener: std::net::TcpListener,
    address: SocketAddr,
    identity: Option<tls::Identity>,
    config: Config,
    tokens: Tokens,
}

impl Server {
    /// Listens.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub fn bind(config: Config) -> Result<Self, ServeError> {
        if !config.listen.ip().is_loopback() && config.tls == Tls::Off {
            return Err(ServeError::Bare(config.listen));
        }
        std::fs::create_dir_all(&config.folder).map_err(|problem| ServeError::Folder { path: config.folder.clone(), problem })?;
        let listener = std::net::TcpListener::bind(config.listen);
        let listener = listener.map_err(|problem| ServeError::Listen { address: config.listen, problem })?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let mut names = vec![address.ip().to_string(), "localhost".to_owned()];
        names.extend(config.names.iter().cloned());
        let identity = tls::identity(&config.tls, names).map_err(ServeError::Tls)?;
        let tokens = Tokens::new(config.role)?;
        Ok(Self { listener, address, identity, config, tokens })
    }

    /// The address of each role, the one that may do most first.
    #[must_use]
    pub fn addresses(&self) -> Vec<(Role, String)> {
        let scheme = if self.identity.is_some() { "https" } else { "http" };
        // An unspecified address is one to listen at, not one to go to.
        let host = match self.config.names.first() {
            Some(name) => format!("{name}:{}", self.address.port()),
            None if self.address.ip().is_unspecified() => format!("localhost:{}", self.address.port()),
            None => self.address.to_string(),
        };
        self.tokens.iter().rev().map(|(role, token)| (role, format!("{scheme}://{host}/?token={token}"))).collect()
    }

    /// The address for viewers of robotics data; with the token of the least role.
    #[must_use]
    pub fn viewer_address(&self) -> Option<String> {
        let (_, address) = self.addresses().pop()?;
        let (page, token) = address.split_once("/?")?;
        Some(format!("{}{}?{token}", page.replacen("http", "ws", 1), viewer::PATH))
    }

    /// SHA-256 of the certificate, for people to compare.
    #[must_use]
    pub fn fingerprint(&self) -> Option<&str> {
        self.identity.as_ref().map(|identity| identity.fingerprint.as_str())
    }

    /// Serves until the program is interrupted; then the rig is vented and left as it was.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub fn run(self, opener: Opener) -> Result<(), ServeError> {
        self.run_until(opener, interrupted())
    }

    /// Serves until `stop` is ready.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub fn run_until(self, opener: Opener, stop: impl Future<Output = ()>) -> Result<(), ServeError> {
        let Self { listener, address, identity, config, tokens } = self;
        let audit = config.folder.join("audit.jsonl");
        let audit = Audit::open(&audit).map_err(|problem| ServeError::Folder { path: audit, problem })?;
        let (orders, received) = mpsc::channel();
        let (events, _) = broadcast::channel::<Event>(EVENTS);
        let folder = config.folder.clone();
        // A rig stays in the thread where it was opened.
        let session = move || Session::new(opener, received, events, audit, folder).run();
        let thread = std::thread::Builder::new().name("session".to_owned()).spawn(session)?;
        let shared = Shared {
            orders: orders.clone(),
            tokens: Arc::new(tokens),
            names: Arc::new(Names::new(address, identity.is_some(), &config.names)),
            clients: Clients::default(),
            jobs: jobs::Runner::new(config.jobs, config.folder.clone()),
            folder: Arc::new(config.folder),
            loader: config.loader,
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        runtime.block_on(async move {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            let listener = Listener::begin(listener, address, identity.map(|identity| identity.acceptor));
            let service = routes(shared).into_make_service_with_connect_info::<Peer>();
            tokio::select! {
                served = std::future::IntoFuture::into_future(axum::serve(listener, service)) => served,
                () = stop => {
                    let (answer, closed) = oneshot::channel();
                    if orders.send(Order::Close(answer)).is_ok() {
                        let _ = closed.await;
                    }
                    Ok(())
                }
            }
        })?;
        drop(runtime);
        let _ = thread.join();
        Ok(())
    }
}

/// Until the program is asked to end.
async fn interrupted() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminated) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminated.recv() => {}
            }
            return;
        }
    }
    let _ = tokio::signal::ctrl_c().await;
}

fn routes(shared: Shared) -> Router {
    Router::new()
        .route("/", get(assets::index))
        .route("/assets/{name}", get(assets::asset))
        .route("/reports/{secret}", get(api::report))
        .route("/live", any(socket::upgrade))
        .route(viewer::PATH, any(viewer::upgrade))
        .route("/api/state", get(api::state))
        .route("/api/samples", get(api::samples))
        .route("/api/settings", get(api::settings))
        .route("/api/lease", post(api::take).delete(api::release))
        .route("/api/lease/renew", post(api::renew))
        .route("/api/act", post(api::act))
        .route("/api/preview", post(api::preview))
        .route("/api/reference", post(api::reference))
        .route("/api/controllers", get(api::controllers))
        .route("/api/calibration", get(api::calibration))
        .route("/api/calibration/page", post(api::calibration_page))
        .route("/api/model", post(api::upload))
        .route("/api/recordings", get(api::recordings))
        .route("/api/recordings/{name}", get(api::recording).post(api::load))
        .route("/api/jobs", get(api::jobs).post(api::begin_job).delete(api::end_job))
        .route("/api/jobs/{number}/use", post(api::use_result))
        .layer(middleware::from_fn_with_state(shared.clone(), guard))
        .with_state(shared)
}

/// Refuses what names another server or comes from another page, and adds what every answer carries.
async fn guard(State(shared): State<Shared>, request: Request, next: Next) -> Response {
    // A viewer may be somebody else's page: its token stands in the address that it was given, and it can do nothing but watch.
    let is_viewer = request.uri().path() == viewer::PATH;
    let checked = if is_viewer { shared.names.check_host(request.headers()) } else { shared.names.check(request.headers()) };
    if let Err(problem) = checked {
        return (StatusCode::FORBIDDEN, problem).into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let carried: [(HeaderName, &'static str); 5] = [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in carried {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}
