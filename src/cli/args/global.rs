//! Global flags, and the settings they stand for.

use std::path::PathBuf;

use clap::Args;

use crate::cli::logging::LogForm;

/// Flags of every command, listed behind a command's own.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Options of every command")]
pub struct Global {
    /// Directory of this site, including settings [default: $XDG_DATA_HOME/authros or ~/.local/share/authros]
    #[arg(long, global = true, value_name = "DIR", env = "AUTHROS_HOME")]
    pub home: Option<PathBuf>,
    /// Profile (identity on this machine) [default: default]
    #[arg(long, global = true, value_name = "NAME", env = "AUTHROS_PROFILE")]
    pub profile: Option<String>,
    /// Print the result as one JSON document on stdout (streams: one per line)
    #[arg(long, global = true)]
    pub json: bool,
    /// Format of lines on stderr
    #[arg(long, global = true, value_enum, value_name = "FORM", default_value = "text")]
    pub log: LogForm,
    /// File with the keyring's passphrase (first line)
    #[arg(long, global = true, value_name = "FILE", conflicts_with = "passphrase_fd")]
    pub passphrase_file: Option<PathBuf>,
    /// File descriptor to read the keyring's passphrase from
    #[arg(long, global = true, value_name = "N")]
    pub passphrase_fd: Option<u32>,
    /// Join somebody else's running site as an operator, at the socket that its owner named in operators.socket
    #[arg(
        long,
        global = true,
        value_name = "PATH",
        env = "AUTHROS_SITE_SOCKET",
        conflicts_with_all = ["passphrase_file", "passphrase_fd"]
    )]
    pub site_socket: Option<PathBuf>,
    /// Real ROS master, such as http://host:11311
    #[arg(long, global = true, value_name = "URI")]
    pub ros_master: Option<String>,
    /// Also capture ROS 2 in this domain [without a number: $ROS_DOMAIN_ID, else 0]
    #[arg(long, global = true, value_name = "DOMAIN", num_args = 0..=1, require_equals = false, default_missing_value = "")]
    pub ros2: Option<String>,
    /// Node of a real chain: http://, https://, ws://, wss:// or IPC path
    #[arg(long, global = true, value_name = "URL")]
    pub chain: Option<String>,
    /// Address of the `AuthROS` contract on that chain
    #[arg(long, global = true, value_name = "ADDRESS")]
    pub contract: Option<String>,
    /// How the embedded chain seals: poa, poa:SIGNERS:PERIOD_MS, pow or pow:DIFFICULTY
    #[arg(long, global = true, value_name = "NAME")]
    pub consensus: Option<String>,
    /// Real Redis, such as redis://host:6379
    #[arg(long, global = true, value_name = "URL")]
    pub vault: Option<String>,
    /// Simulated robots on the embedded master, 0 to 32
    #[arg(long, global = true, value_name = "N")]
    pub robots: Option<String>,
    /// What they are: own (nodes of this process) or rosrust (each a process of the program authros-rosrust)
    #[arg(long, global = true, value_name = "NAME")]
    pub robots_by: Option<String>,
    /// Number of blocks until an anchor counts as confirmed
    #[arg(long, global = true, value_name = "N")]
    pub confirmations: Option<String>,
    /// authros (its own kernels), rustcrypto or libsm
    #[arg(long, global = true, value_name = "NAME")]
    pub crypto_provider: Option<String>,
    /// Join a remote site through its gateway, which supplies records and chain; further addresses of the same gateway
    /// may follow, each after another --site
    #[arg(long, global = true, value_name = "HOST:PORT")]
    pub site: Vec<String>,
    /// That gateway's identity key, 64 hex digits, from its operator (not the eight-group fingerprint printed beside
    /// it)
    #[arg(long, global = true, value_name = "KEY", conflicts_with = "trust_first")]
    pub gateway_key: Option<String>,
    /// Pin the first gateway that answers
    #[arg(long, global = true)]
    pub trust_first: bool,
    /// batch (Merkle roots) or each (one transaction per record)
    #[arg(long, global = true, value_name = "MODE")]
    pub anchor_mode: Option<String>,
}

impl Global {
    /// The flag's value for a setting.
    pub fn setting(&self, name: &str) -> Option<String> {
        match name {
            "ros.master" => self.ros_master.clone(),
            "ros.domain" => self.ros2.clone().map(domain),
            "chain.url" => self.chain.clone(),
            "chain.contract" => self.contract.clone(),
            "chain.consensus" => self.consensus.clone(),
            "vault.url" => self.vault.clone(),
            "robots" => self.robots.clone(),
            "ros.robots_by" => self.robots_by.clone(),
            "confirmations" => self.confirmations.clone(),
            "crypto.provider" => self.crypto_provider.clone(),
            "anchor.mode" => self.anchor_mode.clone(),
            "site.address" => (!self.site.is_empty()).then(|| self.site.join(",")),
            "site.gateway_key" => self.gateway_key.clone(),
            "site.trust_first" => self.trust_first.then(|| "yes".to_owned()),
            _ => None,
        }
    }
}

/// The domain that a flag without a number means.
fn domain(written: String) -> String {
    let of_environment = || std::env::var("ROS_DOMAIN_ID").ok().filter(|value| !value.is_empty());
    Some(written).filter(|written| !written.is_empty()).or_else(of_environment).unwrap_or_else(|| "0".to_owned())
}

#[cfg(test)]
mod tests {
    use crate::cli::args::Arguments;
    use clap::Parser;

    fn domain(arguments: &[&str]) -> Option<String> {
        let read = Arguments::try_parse_from(["authros"].iter().chain(arguments)).expect("arguments");
        read.global.setting("ros.domain")
    }

    #[test]
    fn the_domain_may_be_left_out_and_takes_no_command_for_a_number() {
        assert_eq!(domain(&["--ros2", "7"]).as_deref(), Some("7"));
        assert_eq!(domain(&["topics", "list", "--ros2", "7"]).as_deref(), Some("7"));
        assert_eq!(domain(&["topics", "list"]), None);
        for without in [&["--ros2"][..], &["--ros2", "topics", "list"], &["doctor", "--ros2"]] {
            assert!(domain(without).is_some_and(|domain| domain.parse::<u16>().is_ok()), "{without:?}");
        }
    }
}
