//! Requests over HTTP, with or without TLS.

use reqwest::Client;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderValue, LOCATION};
use reqwest::redirect::Policy;
use serde::de::DeserializeOwned;
use tokio::sync::Semaphore;

use super::address::Server;
use super::refusal::{Refused, broken};
use super::{CONNECTING, ChainError, IDLE, Limits, TOGETHER, TransportError, WIDE_TOGETHER, answer};
use crate::model::clean;

/// The longest page of an error that is looked at, bytes.
const LONGEST_PAGE: usize = 64 << 10;

/// A node that is asked over HTTP.
pub(super) struct Http {
    client: Client,
    server: Server,
    /// Each request needs a connection to itself, and a node has only so many.
    places: Semaphore,
    wide_places: Semaphore,
}

impl Http {
    /// Not connected yet.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if the client cannot be built.
    pub(super) fn new(server: Server) -> Result<Self, ChainError> {
        // Redirects are not followed: only the node that was named gets requests and credentials.
        let client = Client::builder().no_proxy().redirect(Policy::none()).tls_built_in_root_certs(false);
        // Shared among the addresses of a name, so that one which is silent leaves time for the others.
        let client = client.connect_timeout(CONNECTING);
        let client = client.pool_max_idle_per_host(TOGETHER).pool_idle_timeout(IDLE);
        let client = match &server.tls {
            Some(config) => client.use_preconfigured_tls((**config).clone()),
            None => client,
        };
        let client = client.build().map_err(|error| ChainError::Internal(clean(&error.to_string(), 120)))?;
        let (places, wide_places) = (Semaphore::new(TOGETHER), Semaphore::new(WIDE_TOGETHER));
        Ok(Self { client, server, places, wide_places })
    }

    /// Makes a request and reads the result in its answer.
    ///
    /// # Errors
    /// [`TransportError`].
    pub(super) async fn ask<R: DeserializeOwned>(&self, body: String, limits: Limits) -> Result<R, TransportError> {
        let places = if limits.is_wide() { &self.wide_places } else { &self.places };
        // It is never closed.
        let _place = places.acquire().await.map_err(|error| TransportError::Broken(error.to_string()))?;
        let mut request = self.client.post(self.server.url.clone()).header(CONTENT_TYPE, "application/json");
        if let Some(credentials) = &self.server.credentials {
            request = request.header(AUTHORIZATION, credentials.clone());
        }
        let mut response = request.body(body).send().await.map_err(|error| broken(&error))?;
        let status = response.status();
        // A page that says what went wrong may be as long as it likes; more than its beginning is not read.
        let most = if status.is_success() { limits.bytes } else { LONGEST_PAGE.min(limits.bytes) };
        let mut bytes = Vec::new();
        while let Some(piece) = response.chunk().await.map_err(|error| broken(&error))? {
            if bytes.len() + piece.len() > most {
                if status.is_success() {
                    return Err(TransportError::TooLong(most));
                }
                break;
            }
            bytes.extend_from_slice(&piece);
        }
        if !status.is_success() && !answer::is_one(&bytes) {
            let location = response.headers().get(LOCATION).and_then(|place: &HeaderValue| place.to_str().ok());
            return Err(Refused { status: status.as_u16(), location, page: &bytes }.words(&self.server));
        }
        answer::read(&bytes).map_err(|error| if is_page(&bytes) { web_page() } else { error })
    }
}

fn is_page(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().starts_with(b"<")
}

/// Its text tells nothing, and a fault of JSON is not what is wrong.
fn web_page() -> TransportError {
    TransportError::Malformed("a web page: what stands before the node refused the request".to_owned())
}
