//! The settings that all workers of a gateway share, as a join file brings them: without passwords of the database.

use std::collections::BTreeMap;

use crate::Config;
use crate::read::Source;

/// Where chain and database are; each worker may reach them in its own way.
const PLACES: [&str; 5] = ["chain.url", "chain.roots", "chain.contract", "store.url", "store.roots"];

const ALIKE: [&str; 14] = [
    "chain.max_fee",
    "chain.min_price",
    "retention",
    "anchor.mode",
    "anchor.lanes",
    "audit.anchor_every",
    "audit.scrub",
    "time.authorities",
    "confirmations",
    "gateway.admission",
    "gateway.addresses",
    "gateway.quota_bytes",
    "gateway.quota_names",
    "gateway.quota_streams",
];

impl Config {
    /// `config.toml` of another worker.
    pub fn of_workers(&self) -> String {
        let line = |name: &&str| {
            let (value, source) = self.values.get(*name)?;
            let value = if *name == "store.url" { without_password(value) } else { value.clone() };
            (*source != Source::Default).then(|| format!("{name} = {}\n", toml::Value::String(value)))
        };
        PLACES.iter().chain(&ALIKE).filter_map(line).collect()
    }

    /// What all workers are to do alike, by name.
    pub fn alike(&self) -> BTreeMap<String, String> {
        let value = |name: &&str| Some(((*name).to_owned(), self.values.get(*name)?.0.clone()));
        ALIKE.iter().filter_map(value).collect()
    }

    /// Names of the settings that another worker has otherwise.
    pub fn unlike(&self, other: &BTreeMap<String, String>) -> Vec<String> {
        let differs = |(name, value): &(String, String)| other.get(name).is_some_and(|theirs| theirs != value);
        self.alike().into_iter().filter(differs).map(|(name, _)| name).collect()
    }
}

/// In both places that PostgreSQL's URLs have for one.
fn without_password(url: &str) -> String {
    let (before, parameters) = url.split_once('?').map_or((url, None), |(before, rest)| (before, Some(rest)));
    let (scheme, rest) = before.split_once("://").unwrap_or(("postgres", before));
    let rest = match rest.rsplit_once('@') {
        Some((user, place)) => format!("{}@{place}", user.split(':').next().unwrap_or_default()),
        None => rest.to_owned(),
    };
    let kept = parameters.into_iter().flat_map(|all| all.split('&')).filter(|one| !one.starts_with("password="));
    let kept: Vec<&str> = kept.collect();
    let mark = if kept.is_empty() { "" } else { "?" };
    format!("{scheme}://{rest}{mark}{}", kept.join("&"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_get_what_they_share_and_no_password_of_the_database() {
        let text = "robots = 0\nconsole.mouse = \"yes\"\nconfirmations = 3\ngateway.addresses = \"a:1,b:1\"\n\
                    store.url = \"postgres://u:hunter2@db1,db2/fleet?password=hunter2&sslmode=require\"\n";
        let file = Some((std::path::Path::new("config.toml"), text));
        let config = Config::resolve(&|_| None, &|_| None, file).expect("settings");
        let shared = config.of_workers();
        assert_eq!(
            shared,
            "store.url = \"postgres://u@db1,db2/fleet?sslmode=require\"\nconfirmations = \"3\"\n\
             gateway.addresses = \"a:1,b:1\"\n"
        );
        let file = Some((std::path::Path::new("config.toml"), shared.as_str()));
        let again = Config::resolve(&|_| None, &|_| None, file).expect("the same settings");
        assert_eq!((again.of_workers(), again.confirmations), (shared, 3));
        assert_eq!(again.unlike(&config.alike()), [""; 0], "which it need not hold itself");
        let other = Config::resolve(&|_| None, &|_| None, None).expect("settings");
        assert_eq!(other.unlike(&config.alike()), ["confirmations", "gateway.addresses"]);
        assert!(!format!("{:?}", config.alike()).contains("postgres"), "each reaches its database in its own way");
    }

    #[test]
    fn a_url_keeps_its_user() {
        for (url, without) in [
            ("postgres://u:p@h/x", "postgres://u@h/x"),
            ("postgresql://u:p%40q@h:5433,i/x?password=p", "postgresql://u@h:5433,i/x"),
            ("postgres://u:p@q@h/x", "postgres://u@h/x"),
            ("postgres:///x?host=/run/pg", "postgres:///x?host=/run/pg"),
            ("postgres://h/x", "postgres://h/x"),
        ] {
            assert_eq!(without_password(url), without);
        }
    }
}
