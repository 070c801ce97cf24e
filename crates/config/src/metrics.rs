//! Where a running site's figures are served, according to the settings.

use std::net::SocketAddr;
use std::path::PathBuf;

use super::error::ConfigError;
use super::read::{Values, switch, value, wrong};

/// Where figures are served.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum FiguresPlace {
    /// An address; on this machine only, unless `open` allows others to reach it.
    Address { address: SocketAddr, open: bool },
    /// A socket in the file system, protected by its folder's permissions.
    Socket(PathBuf),
}

/// What the settings say about figures.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MetricsSettings {
    /// Where they are served; `None` = nowhere.
    pub listen: Option<FiguresPlace>,
    /// Whether topics have figures under their names.
    pub topics: bool,
}

impl MetricsSettings {
    pub(super) fn read(values: &Values) -> Result<Self, ConfigError> {
        let open = switch(values, "metrics.open", ("yes", "no"))?;
        let topics = switch(values, "metrics.topics", ("yes", "no"))?;
        let listen = value(values, "metrics.listen").map(|text| place(values, text, open)).transpose()?;
        Ok(Self { listen, topics })
    }
}

fn place(values: &Values, text: &str, open: bool) -> Result<FiguresPlace, ConfigError> {
    if text.starts_with('/') {
        return Ok(FiguresPlace::Socket(text.into()));
    }
    let wrong = |what| wrong(values, "metrics.listen", what);
    let address: SocketAddr =
        text.parse().map_err(|_| wrong("use 127.0.0.1:PORT, or an absolute path for a socket"))?;
    if !open && !address.ip().is_loopback() {
        return Err(wrong("other machines can reach this address; use 127.0.0.1, or also set metrics.open = 'yes'"));
    }
    Ok(FiguresPlace::Address { address, open })
}
