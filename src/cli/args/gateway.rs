//! `gateway …`

use std::net::SocketAddr;

use clap::Subcommand;

/// `gateway …`
#[derive(Debug, Subcommand)]
pub enum GatewayVerb {
    /// Show this home's gateway: connections, system keys, refusals
    Status,
    /// Accept sealed records from robots, anchor them with this profile's account, answer operators' queries
    Serve {
        /// Address and port; port 0 = any free port
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7420")]
        listen: SocketAddr,
        /// Also accept owners who are not admitted, each within the quotas in the settings
        #[arg(long)]
        open: bool,
    },
    /// Admit an owner to this home's gateway: it can register names, send records and read what is granted to it
    Admit {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// Revoke an owner's admission; what it sent is kept
    Dismiss {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// List who may use the gateway besides this home's own profiles
    Admitted,
}
