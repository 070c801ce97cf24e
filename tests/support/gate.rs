//! A gateway with its own home, served by the program.

use super::member::Gateway;
use super::{Home, Running};

/// A running gateway; it ends on drop.
pub struct Gate {
    pub home: Home,
    pub gateway: Gateway,
    key: String,
    process: Running,
}

impl Gate {
    /// One on any free port, kept by the profile `gateway`.
    pub fn new() -> Self {
        Self::with("")
    }

    /// The same with settings for its home.
    pub fn with(settings: &str) -> Self {
        let home = Home::new();
        std::fs::create_dir_all(home.path()).expect("a home");
        std::fs::set_permissions(home.path(), std::os::unix::fs::PermissionsExt::from_mode(0o700)).expect("its mode");
        std::fs::write(home.path().join("config.toml"), settings).expect("settings");
        let keeper = home.profile("gateway").with(&["--json", "--robots", "0"]);
        let mut process = keeper.spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
        let told = process.wait_for_text("\"joined\"", 120);
        let line = told.lines().find(|line| line.contains("\"joined\"")).expect("one line");
        let told: serde_json::Value = serde_json::from_str(line).expect("JSON");
        let key = super::text(&told["gateway"], "gateway");
        Self { home, gateway: Gateway::of(&told), key, process }
    }

    /// Memory of its process, without pages of files, MiB.
    pub fn held(&self) -> u64 {
        super::process::own_memory(self.process.id()) / 1024
    }

    /// What it wrote for its keeper so far.
    pub fn stderr(&self) -> String {
        self.process.stderr()
    }

    /// Options with which another home joins it.
    pub fn options(&self) -> [&str; 4] {
        ["--site", &self.gateway.address, "--gateway-key", &self.key]
    }

    /// Its fingerprint, 64 hex.
    pub fn key(&self) -> &str {
        &self.key
    }
}
