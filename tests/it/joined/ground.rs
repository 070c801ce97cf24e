//! The chain that gateways stand on: the embedded one served from a home of its own, or anvil.

use serde_json::{Value, json};

use super::support::anvil::{self, Anvil};
use super::support::{Authros, Home, Running, text};

/// What seals the blocks.
enum Sealer {
    Served { home: Home, site: Option<Running> },
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

impl Ground {
    /// The embedded chain.
    pub fn new() -> Self {
        let home = Home::new();
        let founder = home.profile("founder").with(&["--robots", "0"]);
        let mut site = founder.with(&["--json"]).spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
        let said = site.wait_for_text("serving", 60);
        let told: Value = said.lines().find_map(|line| serde_json::from_str(line).ok()).expect("one JSON line");
        let url = text(&told["serving"], "url");
        let contract = text(&founder.json(&["chain", "deploy"]), "contract");
        Self { sealer: Sealer::Served { home, site: Some(site) }, port: port_of(&url), url, contract, founder }
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

    /// The embedded chain's node dies, as if its machine did.
    pub fn kill_node(&mut self) {
        if let Sealer::Served { site, .. } = &mut self.sealer {
            site.take().expect("running").stop("KILL", 10);
        }
    }

    /// It is back, at the same address.
    pub fn start_node(&mut self) {
        if let Sealer::Served { home, site } = &mut self.sealer {
            let founder = home.profile("founder").with(&["--robots", "0", "--json"]);
            let mut node = founder.spawn(&["chain", "serve", "--listen", &format!("127.0.0.1:{}", self.port)]);
            node.wait_for_text("serving", 60);
            *site = Some(node);
        }
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
