//! `gateway …`

use std::net::SocketAddr;

use clap::Subcommand;

/// `gateway …`
#[derive(Debug, Subcommand)]
pub enum GatewayVerb {
    /// Who is connected to the gateway of this home, its system keys, what it refused
    Status,
    /// Take sealed records from robots, anchor them with this profile's account, answer operators' queries
    Serve {
        /// Address and port; port 0 = any free one
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7420")]
        listen: SocketAddr,
        /// Take owners whom nobody admitted as well, each within the quotas of the settings
        #[arg(long)]
        open: bool,
    },
    /// Let an owner use the gateway of this home: have names there, send records, read what is granted to it
    Admit {
        /// Account (0x and 40 hex), or a contact
        owner: String,
    },
    /// Let an owner use it no more; what it sent is kept
    Dismiss {
        /// Account (0x and 40 hex), or a contact
        owner: String,
    },
    /// Who may use the gateway, besides this home's own profiles
    Admitted,
}
