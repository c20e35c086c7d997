//! The page on a rig without firmware, to work on the page: `cargo run -p dashboard --example fake`.

#[allow(dead_code, reason = "tests look at more of it")]
#[path = "../tests/support/fake.rs"]
mod fake;

use std::sync::{Arc, Mutex};

use dashboard::{Config, Jobs, Role, Server, Tls};
use fake::{Fake, Watched};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let config = Config {
        listen: "127.0.0.1:8041".parse()?,
        names: Vec::new(),
        role: Role::Configure,
        tls: Tls::Off,
        folder: std::env::temp_dir().join("catheter-dashboard"),
        jobs: Jobs { program: "/bin/false".into(), kinds: Vec::new() },
        loader: |_, _| Err("this server reads no files".to_owned()),
    };
    let server = Server::bind(config)?;
    println!("listening on {}", server.addresses()[0].1);
    let watched = Arc::<Mutex<Watched>>::default();
    server.run(Box::new(move || Ok(Box::new(Fake::new(Arc::clone(&watched))))))?;
    Ok(())
}
