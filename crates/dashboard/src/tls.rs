//! Connections, bare on loopback and in TLS elsewhere; a handshake that takes its time keeps nobody waiting.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::connect_info::Connected;
use axum::serve::IncomingStream;
use sha2::{Digest, Sha256};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};

/// A handshake has to be over by then.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// Connections that wait to be served.
const WAITING: usize = 16;

/// Where certificate and key come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Tls {
    /// No TLS: on loopback only.
    Off,
    /// A certificate made for this run; its fingerprint is printed.
    SelfSigned,
    /// Files in PEM.
    Files {
        /// The certificate and those above it.
        certificate: PathBuf,
        /// Its key.
        key: PathBuf,
    },
}

/// A server's side of TLS.
pub(crate) struct Identity {
    pub acceptor: TlsAcceptor,
    /// SHA-256 of the certificate, as browsers show it.
    pub fingerprint: String,
}

/// Certificate and key for these names.
pub(crate) fn identity(tls: &Tls, names: Vec<String>) -> Result<Option<Identity>, String> {
    let (chain, key) = match tls {
        Tls::Off => return Ok(None),
        Tls::SelfSigned => {
            let made = rcgen::generate_simple_self_signed(names).map_err(|error| format!("a certificate cannot be made: {error}"))?;
            let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(made.signing_key.serialize_der()));
            (vec![made.cert.der().clone()], key)
        }
        Tls::Files { certificate, key } => {
            let problem = |path: &PathBuf, error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
            let chain = CertificateDer::pem_file_iter(certificate)
                .and_then(Iterator::collect::<Result<Vec<_>, _>>)
                .map_err(|error| problem(certificate, &error))?;
            (chain, PrivateKeyDer::from_pem_file(key).map_err(|error| problem(key, &error))?)
        }
    };
    let first = chain.first().ok_or("the file has no certificate")?;
    let fingerprint = Sha256::digest(first.as_ref()).iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":");
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(|error| format!("certificate and key do not go together: {error}"))?;
    Ok(Some(Identity { acceptor: TlsAcceptor::from(Arc::new(config)), fingerprint }))
}

/// What HTTP is spoken over.
pub(crate) trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}
impl<T: AsyncRead + AsyncWrite + Send + Unpin> Stream for T {}

/// Where a connection comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub SocketAddr);

impl Connected<IncomingStream<'_, Listener>> for Peer {
    fn connect_info(stream: IncomingStream<'_, Listener>) -> Self {
        Self(*stream.remote_addr())
    }
}

/// Gives out connections whose handshake is done.
pub(crate) struct Listener {
    ready: mpsc::Receiver<(Box<dyn Stream>, SocketAddr)>,
    address: SocketAddr,
}

impl Listener {
    /// Begins to accept.
    pub fn begin(listener: TcpListener, address: SocketAddr, acceptor: Option<TlsAcceptor>) -> Self {
        let (sender, ready) = mpsc::channel::<(Box<dyn Stream>, SocketAddr)>(WAITING);
        tokio::spawn(async move {
            loop {
                let Ok((stream, from)) = listener.accept().await else {
                    // Out of file descriptors, for example.
                    tokio::time::sleep(Duration::from_millis(100)).await;
                    continue;
                };
                // A heartbeat must not wait for company.
                let _ = stream.set_nodelay(true);
                let sender = sender.clone();
                let Some(acceptor) = acceptor.clone() else {
                    if sender.send((Box::new(stream), from)).await.is_err() {
                        return;
                    }
                    continue;
                };
                tokio::spawn(async move {
                    if let Ok(Ok(stream)) = tokio::time::timeout(HANDSHAKE, acceptor.accept(stream)).await {
                        let _ = sender.send((Box::new(stream), from)).await;
                    }
                });
            }
        });
        Self { ready, address }
    }
}

impl axum::serve::Listener for Listener {
    type Io = Box<dyn Stream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        match self.ready.recv().await {
            Some(connection) => connection,
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> std::io::Result<Self::Addr> {
        Ok(self.address)
    }
}
