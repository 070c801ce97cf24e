//! Plain words for a server that refuses before its node gets to see the request.

use std::error::Error;

use super::TransportError;
use super::address::Server;
use crate::web;

/// The setting that names authorities.
const ROOTS: &str = "`chain.roots`";

/// An answer of HTTP that is none of JSON-RPC.
pub(super) struct Refused<'a> {
    pub status: u16,
    pub location: Option<&'a str>,
    /// The beginning of its text.
    pub page: &'a [u8],
}

impl Refused<'_> {
    /// What it means, and what to do.
    pub(super) fn words(&self, server: &Server) -> TransportError {
        let (what, advice) = match self.status {
            401 if server.credentials.is_some() => (
                "does not accept the user name and password in its URL",
                "correct them in `chain.url`; write characters other than letters and digits as %40 and the like",
            ),
            401 => {
                ("wants a user name and password", "write them into `chain.url`, as https://USER:PASSWORD@HOST:PORT")
            }
            403 => ("forbids the request", "ask who runs it to allow this machine and this host name"),
            404 => ("serves nothing at this path", "correct the path in `chain.url`"),
            405 | 426 => (
                "does not take requests of this kind at this path",
                "check the path in `chain.url`, and whether it is ws:// (wss://) or http:// (https://)",
            ),
            413 => (
                "finds the request too large",
                "raise the limit of what stands before the node (nginx: client_max_body_size)",
            ),
            429 => ("limits how often it may be asked", "wait, or ask who runs it for a higher limit"),
            502..=504 => {
                ("cannot be reached by the server that stands before it", "start the node, or give it more time there")
            }
            500..=599 => ("has a fault", "look into its log, or into that of what stands before it"),
            301..=303 | 307 | 308 => return self.redirect(server),
            400 if self.is_plain_to_tls() => ("speaks TLS at this port", "write https:// or wss:// in `chain.url`"),
            _ => ("answers with a page instead of JSON-RPC", "check that `chain.url` is an Ethereum node"),
        };
        TransportError::Unusable { reason: format!("{what} (HTTP {})", self.status), advice: advice.to_owned() }
    }

    fn redirect(&self, server: &Server) -> TransportError {
        let place = web::redirected(&server.url, self.location);
        let reason = format!("points at {place} (HTTP {}), which is not followed", self.status);
        TransportError::Unusable { reason, advice: "write that address into `chain.url`".to_owned() }
    }

    /// nginx and Go's servers say so in words only.
    fn is_plain_to_tls(&self) -> bool {
        let text = String::from_utf8_lossy(self.page).to_lowercase();
        text.contains("https port") || text.contains("https server")
    }
}

/// A connection that broke: by TLS, or by something else.
pub(super) fn broken(error: &(dyn Error + 'static)) -> TransportError {
    match web::tls_fault(error, ROOTS) {
        Some(fault) => TransportError::Unusable { reason: fault.reason, advice: fault.advice },
        None => TransportError::Broken(web::innermost(error)),
    }
}
