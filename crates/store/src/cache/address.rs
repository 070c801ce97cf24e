//! The address of a cache: one server, the master named by sentinels, or the nodes of a cluster.

use redis::{ConnectionInfo, IntoConnectionInfo as _};

use crate::StoreError;
use crate::model::clean;

#[derive(Clone)]
pub(super) struct Address {
    pub shown: String,
    pub is_tls: bool,
    /// `USER:PASSWORD@` as written; empty if there is none.
    pub credentials: String,
    pub place: Place,
}

#[derive(Clone)]
pub(super) enum Place {
    Server(Box<ConnectionInfo>),
    /// Sentinels, master's name, database.
    Sentinels(Vec<ConnectionInfo>, String, String),
    /// HOST:PORT of seeds; the cluster names the rest.
    Cluster(Vec<String>),
}

impl Address {
    pub(super) fn parse(url: &str) -> Result<Self, StoreError> {
        let shown = redact(url);
        let wrong = |detail: &str| StoreError::CacheUrl { url: shown.clone(), detail: clean(detail, 120) };
        let (scheme, rest) = url.split_once("://").ok_or_else(|| wrong("it has no scheme"))?;
        let (is_tls, kind) = match scheme.strip_prefix("rediss") {
            Some(kind) => (true, kind),
            None => (false, scheme.strip_prefix("redis").unwrap_or(scheme)),
        };
        let of_many = matches!(kind, "+cluster" | "+sentinel");
        let (credentials, hosts_part) = match rest.rsplit_once('@').filter(|_| of_many) {
            Some((credentials, rest)) => (format!("{credentials}@"), rest),
            None => (String::new(), rest),
        };
        let place = match (is_tls, kind) {
            (_, "") => Place::Server(Box::new(server(&format!("redis://{rest}")).map_err(|why| wrong(&why))?)),
            (false, "+unix" | "unix") => {
                Place::Server(Box::new(server(&format!("redis+unix://{rest}")).map_err(|why| wrong(&why))?))
            }
            (_, "+cluster") => Place::Cluster(hosts(hosts_part.trim_end_matches('/')).map_err(wrong)?),
            (_, "+sentinel") => sentinels(hosts_part).map_err(|why| wrong(&why))?,
            _ => return Err(wrong("its scheme is not one of these")),
        };
        let address = Self { shown: shown.clone(), is_tls, credentials, place };
        // Unusable credentials fail here, not at the first request.
        if !address.credentials.is_empty() {
            address.server("localhost:1", "0").map_err(|why| wrong(&why))?;
        }
        Ok(address)
    }

    pub(super) fn server(&self, host: &str, database: &str) -> Result<ConnectionInfo, String> {
        server(&format!("redis://{}{host}/{database}", self.credentials))
    }
}

fn server(url: &str) -> Result<ConnectionInfo, String> {
    url.into_connection_info().map_err(|error| error.detail().unwrap_or(error.category()).to_owned())
}

fn sentinels(text: &str) -> Result<Place, String> {
    let mut parts = text.split('/');
    let hosts = hosts(parts.next().unwrap_or_default())?;
    let master = parts.next().filter(|name| !name.is_empty());
    let master = master.ok_or("the master's name is missing after the sentinels")?;
    let database = parts.next().unwrap_or("0");
    if database.parse::<u16>().is_err() || parts.next().is_some() {
        return Err("the database must be a number".to_owned());
    }
    let sentinels = hosts.iter().map(|host| server(&format!("redis://{host}/"))).collect::<Result<_, _>>()?;
    Ok(Place::Sentinels(sentinels, master.to_owned(), database.to_owned()))
}

fn hosts(text: &str) -> Result<Vec<String>, &'static str> {
    let good = |host: &str| {
        let port = host.rsplit_once(':').filter(|(name, _)| !name.is_empty()).map(|(_, port)| port.parse::<u16>());
        matches!(port, Some(Ok(1..))) && host.bytes().all(|byte| byte.is_ascii_graphic() && !b"/?#@".contains(&byte))
    };
    let hosts: Vec<String> = text.split(',').map(str::to_owned).collect();
    if hosts.iter().all(|host| good(host)) { Ok(hosts) } else { Err("servers must be HOST:PORT, separated by commas") }
}

/// Without user, password and query.
fn redact(url: &str) -> String {
    let plain = url.split_once(['?', '#']).map_or(url, |(before, _)| before);
    let Some((scheme, rest)) = plain.split_once("://") else { return "(no URL)".to_owned() };
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    let hidden = if host.len() == rest.len() { "" } else { "***@" };
    clean(&format!("{scheme}://{hidden}{host}"), 120)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind;

    #[test]
    fn every_kind_of_place_is_understood() {
        for (url, is_tls) in [
            ("redis://h:1/0", false),
            ("redis://h", false),
            ("rediss://h:1", true),
            ("redis+unix:///run/redis.sock?db=2", false),
            ("unix:///run/redis.sock", false),
        ] {
            let address = Address::parse(url).expect(url);
            assert!(matches!(address.place, Place::Server(_)) && address.is_tls == is_tls, "{url}");
        }
        let cluster = Address::parse("rediss+cluster://a:1,[::1]:2").expect("a cluster");
        assert!(cluster.is_tls && matches!(cluster.place, Place::Cluster(hosts) if hosts == ["a:1", "[::1]:2"]));
        let master = |url: &str| match Address::parse(url).expect(url).place {
            Place::Sentinels(hosts, master, database) => (hosts.len(), master, database),
            _ => panic!("{url} has sentinels"),
        };
        assert_eq!(master("redis+sentinel://u:p@a:1,[::1]:2/mine"), (2, "mine".to_owned(), "0".to_owned()));
        assert_eq!(master("redis+sentinel://a:1/mine/3"), (1, "mine".to_owned(), "3".to_owned()));
    }

    #[test]
    fn a_wrong_url_is_refused_with_a_way_out_and_without_its_secrets() {
        for url in [
            "redis://",
            "http://u:s3cret@x",
            "s3cret",
            "redis://u:s3cret@h/x",
            "redis+unix://",
            "rediss+unix:///x?pass=s3cret",
            "redis+cluster://",
            "redis+cluster://a",
            "redis+cluster://a:0",
            "redis+cluster://me:s3cret@a:1,",
            "redis+cluster://a:1/x",
            "redis+sentinel://me:s3cret@a:1",
            "redis+sentinel://a:1/mine/x",
            "redis+%zz://a:1",
        ] {
            let error = Address::parse(url).map(drop).expect_err(url);
            assert_eq!(error.kind(), ErrorKind::Input, "{url}");
            let text = error.to_string();
            assert!(text.contains("cache.url") && text.contains("redis://HOST:PORT"), "{text}");
            assert!(!text.contains("s3cret") && !text.contains("me:"), "{text}");
        }
    }

    #[test]
    fn nodes_get_the_credentials_of_the_url() {
        let address = Address::parse("redis+cluster://me:s3cret@a:1,b:2").expect("good");
        let node = address.server("b:2", "0").expect("a server");
        assert_eq!(node.redis_settings().password(), Some("s3cret"));
        assert!(!address.shown.contains("s3cret") && address.shown.contains("a:1,b:2"), "{}", address.shown);
    }
}
