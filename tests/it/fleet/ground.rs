//! The chain that a fleet stands on: the embedded one served from a home of its own, or anvil.

use std::process::Command;

use serde_json::{Value, json};

use super::support::anvil::{self, Anvil};
use super::support::{Authros, Home, Running, text};

/// What seals the blocks.
enum Sealer {
    Served { home: Home, site: Running },
    Anvil { _home: Home, node: Anvil },
}

/// A chain with the contract, served to the gateways.
pub(super) struct Ground {
    sealer: Sealer,
    pub url: String,
    pub port: u16,
    pub contract: String,
    /// Who administers the contract.
    pub founder: Authros,
}

fn port_of(url: &str) -> u16 {
    url.rsplit(':').next().and_then(|port| port.trim_end_matches('/').parse().ok()).expect("a port")
}

fn serve(founder: &Authros, port: u16) -> (Running, String) {
    let listen = format!("127.0.0.1:{port}");
    let mut site = founder.with(&["--json"]).spawn(&["chain", "serve", "--listen", &listen]);
    let said = site.wait_for_text("serving", 60);
    let told: Value = said.lines().find_map(|line| serde_json::from_str(line).ok()).expect("one JSON line");
    (site, text(&told["serving"], "url"))
}

impl Ground {
    /// The embedded chain.
    pub fn new() -> Self {
        let home = Home::new();
        let founder = home.profile("founder").with(&["--robots", "0"]);
        let (site, url) = serve(&founder, 0);
        let contract = text(&founder.json(&["chain", "deploy"]), "contract");
        Self { sealer: Sealer::Served { home, site }, port: port_of(&url), url, contract, founder }
    }

    /// Anvil, a block each second; `None` if it is not installed.
    pub fn on_anvil() -> Option<Self> {
        let (home, node) = (Home::new(), Anvil::start(&["--block-time", "1"])?);
        let (url, port) = (node.http(), node.port());
        let founder = home.profile("founder").with(&["--robots", "0", "--chain", &url]);
        let made = founder.json(&["identity", "create"]);
        node.fund(&text(&made, "address"));
        let contract = text(&founder.json(&["chain", "deploy"]), "contract");
        Some(Self { sealer: Sealer::Anvil { _home: home, node }, url, port, contract, founder })
    }

    /// The chain as it is now, on a port of its own: nobody brings it anything from now on. Interrupts the served one.
    pub fn left_behind(&mut self) -> Self {
        let Sealer::Served { home, site } = &mut self.sealer else { panic!("only the served chain is copied") };
        site.signal("TERM");
        while site.is_running() {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        let copy = Home::new();
        let copied = Command::new("cp").arg("-a").arg(home.path()).arg(copy.root()).status();
        assert!(copied.expect("cp runs").success());
        *site = serve(&self.founder, self.port).0;
        let founder = copy.profile("founder").with(&["--robots", "0"]);
        let (site, url) = serve(&founder, 0);
        let contract = self.contract.clone();
        Self { sealer: Sealer::Served { home: copy, site }, port: port_of(&url), url, contract, founder }
    }

    /// Gas, where that costs something.
    pub fn fund(&self, address: &str) {
        if let Sealer::Anvil { node, .. } = &self.sealer {
            node.fund(address);
        }
    }

    /// The time of a block, seconds.
    pub fn time_of(&self, block: u64) -> u64 {
        let found = anvil::call(self.port, "eth_getBlockByNumber", &json!([format!("{block:#x}"), false]));
        anvil::number(&found["timestamp"])
    }
}
