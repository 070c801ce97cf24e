//! Sessions of the gateway's protocol in the test's own hands, for what a site would only tell later.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use authros::gateway::{Client, Code, Credentials, Feed, GatewayError};
use tokio::runtime::Runtime;

use super::Gateway;
use super::support::member::{self, Member as Keys};

/// The gateway as a client knows it.
pub(super) fn known(gateway: &Gateway) -> member::Gateway {
    let (id, domain) = (gateway.key.parse().expect("a key"), gateway.domain.parse().expect("a domain"));
    member::Gateway { address: gateway.address(), id, domain, account: String::new() }
}

/// For clients.
pub(super) fn runtime() -> Runtime {
    let built = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    built.expect("a runtime")
}

/// What a gateway answered: how many records it listed, or why it refused.
pub(super) type Answer = Result<usize, Code>;

/// Asks one gateway the same again and again, and notes each answer with its time.
pub(super) struct Asking {
    pub subject: &'static str,
    pub place: usize,
    heard: Arc<Mutex<Vec<(SystemTime, Answer)>>>,
}

impl Asking {
    /// Goes on until the runtime ends.
    pub fn begin(
        runtime: &Runtime,
        (subject, place): (&'static str, usize),
        (gateway, credentials): (member::Gateway, Credentials),
        feed: Feed,
    ) -> Self {
        let heard: Arc<Mutex<Vec<_>>> = Arc::default();
        let noted = Arc::clone(&heard);
        runtime.spawn(async move {
            let mut client = None;
            loop {
                let answer = ask(&gateway, &credentials, &mut client, &feed).await;
                if let Some(answer) = answer {
                    noted.lock().unwrap_or_else(PoisonError::into_inner).push((SystemTime::now(), answer));
                }
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        });
        Self { subject, place, heard }
    }

    /// The answers from this moment on.
    pub fn since(&self, moment: SystemTime) -> Vec<(SystemTime, Answer)> {
        let heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        heard.iter().filter(|(at, _)| *at >= moment).copied().collect()
    }

    pub fn newest(&self) -> Option<Answer> {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner).last().map(|(_, answer)| *answer)
    }
}

/// One question; nothing if the connection broke.
async fn ask(
    gateway: &member::Gateway,
    credentials: &Credentials,
    client: &mut Option<Client>,
    feed: &Feed,
) -> Option<Answer> {
    if client.as_ref().is_none_or(Client::is_spent) {
        *client = Client::connect(&gateway.endpoint(), &mut gateway.trust(), credentials).await.ok();
    }
    match client.as_mut()?.feed(feed).await {
        Ok(page) => Some(Ok(page.entries.len())),
        Err(GatewayError::Refused(code)) => Some(Err(code)),
        Err(_) => {
            *client = None;
            None
        }
    }
}

/// A session under a name of its own.
pub(super) async fn session(keys: &Keys, gateway: &member::Gateway, name: &str) -> (Client, Credentials) {
    let credentials = keys.allocate(gateway, name).await.expect("admitted");
    (member::connect(gateway, &credentials).await, credentials)
}
