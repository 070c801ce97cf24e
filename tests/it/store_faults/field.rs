//! A site under load, and the law that its counts must obey at every check.

use serde_json::Value;

use crate::support::{Authros, Home, Running, count, wait_until};

/// A small topic at 20 Hz.
pub const ODOM: &str = "/robot1/odom";
/// Pictures.
pub const CAMERA: &str = "/robot1/camera/compressed";
/// The reason to skip without Redis.
pub const NO_REDIS: &str = "no redis-server and redis-cli";

/// A site that captures topics indefinitely.
pub struct Load {
    pub home: Home,
    pub authros: Authros,
    site: Running,
}

impl Load {
    /// Captures these topics with these options.
    pub fn start(options: &[&str], variables: &[(&str, &str)], topics: &[&str]) -> Self {
        Self::start_with("", options, variables, topics)
    }

    /// See [`Load::start`], with a `config.toml`.
    pub fn start_with(config: &str, options: &[&str], variables: &[(&str, &str)], topics: &[&str]) -> Self {
        let home = Home::new();
        if !config.is_empty() {
            std::fs::create_dir_all(home.path()).expect("a home");
            std::fs::write(home.path().join("config.toml"), config).expect("written");
        }
        let mut authros = home.authros().with(&["--robots", "1"]).with(options);
        for (name, value) in variables {
            authros = authros.with_variable(name, value);
        }
        let site = authros.serve(&home);
        authros.enrol();
        for topic in topics {
            authros.json(&["topics", "watch", topic]);
        }
        Self { home, authros, site }
    }

    /// The counts by state now; fails the test if they do not add up.
    pub fn life(&self) -> Value {
        let life = self.authros.json(&["status"])["life"].clone();
        let sum: u64 =
            ["verified", "pending", "quarantined", "dropped", "tampered"].map(|part| count(&life, part)).iter().sum();
        assert_eq!(count(&life, "captured"), sum, "the conservation law: {life}");
        assert_eq!((&life["conserved"], count(&life, "tampered")), (&Value::Bool(true), 0), "{life}");
        life
    }

    /// Checks the counts by state until they are as wanted.
    pub fn until(&self, what: &str, seconds: u64, wanted: impl Fn(&Value) -> bool) -> Value {
        let life = || Some(self.life()).filter(|life| wanted(life));
        wait_until(seconds, what, life)
    }

    /// Stops capturing; waits until everything captured is verified.
    pub fn settle(&self, topics: &[&str]) -> Value {
        for topic in topics {
            self.authros.json(&["topics", "unwatch", topic]);
        }
        self.until("all is verified", 90, |life| count(life, "pending") == 0 && count(life, "waiting") == 0)
    }

    /// Every record of the profile, of all kinds that a store holds.
    pub fn records(&self) -> Vec<Value> {
        let kinds = ["data", "definition", "gap", "audit", "retention"];
        kinds.iter().flat_map(|kind| self.authros.records(&["records", "list", "--oldest", "--kind", kind])).collect()
    }

    /// The id of the site's process.
    pub fn id(&self) -> u32 {
        self.site.id()
    }

    /// The site's messages to its operator.
    pub fn told(&self) -> String {
        self.site.stderr()
    }

    /// Ends the site by a signal.
    pub fn end(self) {
        self.site.stop("TERM", 30).expect_code(0);
    }
}

/// First, middle and last of some records.
pub fn sample(records: &[Value]) -> Vec<Value> {
    let last = records.len().saturating_sub(1);
    [0, last / 2, last].iter().filter_map(|index| records.get(*index).cloned()).collect()
}
