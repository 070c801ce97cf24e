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
    },
}
