//! What the handlers of requests share.

use std::path::PathBuf;
use std::sync::{Arc, mpsc};

use crate::access::{Names, Tokens};
use crate::client::Clients;
use crate::jobs::Runner;
use crate::load::Loader;
use crate::session::Order;

/// Where orders go, who may give them, and what there is to know beside the session.
#[derive(Clone)]
pub(crate) struct Shared {
    pub orders: mpsc::Sender<Order>,
    pub tokens: Arc<Tokens>,
    pub names: Arc<Names>,
    pub clients: Clients,
    pub folder: Arc<PathBuf>,
    pub jobs: Runner,
    pub loader: Loader,
}
