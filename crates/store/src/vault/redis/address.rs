//! The address of a Redis: one server, the master named by sentinels, or the nodes of a cluster.

use crate::model::clean;
use crate::store::StoreError;

/// A vault's URL, parsed.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Address {
    /// Its name, without secrets.
    pub shown: String,
    /// `USER:PASSWORD@` as written; empty if there is none.
    credentials: String,
    /// What it leads to.
    pub place: Place,
}

/// The kind of address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Place {
    /// One server, at a URL that the client understands.
    Server(String),
    /// Sentinels as HOST:PORT, their name for the master, its database.
    Sentinels(Vec<String>, String, String),
    /// Nodes of a cluster as HOST:PORT; the rest are learnt from them.
    Cluster(Vec<String>),
}

impl Address {
    /// Parses `redis://[USER:PASSWORD@]HOST:PORT/DB`, `redis+unix:///PATH[?db=N]`,
    /// `redis+sentinel://[USER:PASSWORD@]HOST:PORT,HOST:PORT/MASTER[/DB]` or
    /// `redis+cluster://[USER:PASSWORD@]HOST:PORT,HOST:PORT`.
    ///
    /// # Errors
    /// [`StoreError::VaultUrl`].
    pub(super) fn parse(url: &str) -> Result<Self, StoreError> {
        let shown = redact(url);
        let wrong = |detail: &str| StoreError::VaultUrl { url: shown.clone(), detail: detail.to_owned() };
        let (scheme, rest) = url.split_once("://").unwrap_or(("", url));
        let (credentials, rest) = match rest.rsplit_once('@') {
            Some((credentials, rest)) if scheme.starts_with("redis+") => (format!("{credentials}@"), rest),
            _ => (String::new(), rest),
        };
        let place = match scheme {
            "redis+sentinel" => {
                let mut parts = rest.split('/');
                let hosts = hosts(parts.next().unwrap_or_default()).map_err(wrong)?;
                let master = parts.next().filter(|name| !name.is_empty());
                let master = master.ok_or_else(|| wrong("the master's name is missing after the sentinels"))?;
                let database = parts.next().unwrap_or("0");
                if database.parse::<u16>().is_err() || parts.next().is_some() {
                    return Err(wrong("the database must be a number"));
                }
                Place::Sentinels(hosts, master.to_owned(), database.to_owned())
            }
            "redis+cluster" => Place::Cluster(hosts(rest.trim_end_matches('/')).map_err(wrong)?),
            _ => Place::Server(url.to_owned()),
        };
        Ok(Self { shown, credentials, place })
    }

    /// The URL of one server of a cluster, or of a master.
    pub(super) fn server(&self, host: &str, database: &str) -> String {
        format!("redis://{}{host}/{database}", self.credentials)
    }
}

fn hosts(text: &str) -> Result<Vec<String>, &'static str> {
    let good = |host: &str| {
        let port = host.rsplit_once(':').filter(|(name, _)| !name.is_empty()).map(|(_, port)| port.parse::<u16>());
        matches!(port, Some(Ok(1..))) && host.bytes().all(|byte| byte.is_ascii_graphic() && !b"/?#@".contains(&byte))
    };
    let hosts: Vec<String> = text.split(',').map(str::to_owned).collect();
    if hosts.iter().all(|host| good(host)) { Ok(hosts) } else { Err("servers must be HOST:PORT, separated by commas") }
}

/// The URL without user, password and query, safe to show.
pub(super) fn redact(url: &str) -> String {
    let plain = url.split_once(['?', '#']).map_or(url, |(before, _)| before);
    let Some((scheme, rest)) = plain.split_once("://") else { return clean(plain, 80) };
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    let hidden = if host.len() == rest.len() { "" } else { "***@" };
    clean(&format!("{scheme}://{hidden}{host}"), 120)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentinels_and_clusters_are_understood_and_secrets_hidden() {
        let place = |url: &str| Address::parse(url).map(|address| address.place).ok();
        let two = vec!["a:1".to_owned(), "[::1]:2".to_owned()];
        assert_eq!(place("redis+cluster://a:1,[::1]:2"), Some(Place::Cluster(two.clone())));
        let sentinels = |database: &str| Place::Sentinels(two.clone(), "mine".to_owned(), database.to_owned());
        assert_eq!(place("redis+sentinel://u:p@a:1,[::1]:2/mine"), Some(sentinels("0")));
        assert_eq!(place("redis+sentinel://a:1,[::1]:2/mine/3"), Some(sentinels("3")));
        assert_eq!(place("redis://h:1/0"), Some(Place::Server("redis://h:1/0".to_owned())));
        for bad in ["cluster://", "cluster://a", "cluster://a:0", "cluster://a:1,", "cluster://a:1/x", "sentinel://a:1"]
        {
            assert_eq!(place(&format!("redis+{bad}")), None, "{bad}");
        }
        assert_eq!(place("redis+sentinel://a:1/mine/x"), None);
        let address = Address::parse("redis+cluster://me:s3cret@a:1,b:2").expect("good");
        assert_eq!(address.server("b:2", "0"), "redis://me:s3cret@b:2/0");
        assert!(!address.shown.contains("s3cret") && address.shown.contains("a:1,b:2"), "{}", address.shown);
        let error = Address::parse("redis+sentinel://me:s3cret@a:1").map(drop).expect_err("no master");
        assert!(!error.to_string().contains("s3cret"), "{error}");
    }
}
