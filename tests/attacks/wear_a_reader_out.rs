//! The gateway that a reader joined wants to keep his site busy: it refuses to tell him anything, or its feed has no end and brings
//! nothing, or is another one each time. He opens sessions and asks for pages in vain ever more rarely.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use authros::gateway::{Client, Feed, FeedPage, Relayed};
use serde_json::Value;
use tokio::sync::Mutex;

use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::stub_desk::{self, Tells};
use super::support::{Authros, Home};
use super::{Outcome, judge};

/// Sessions that a site may open within [`WINDOW`] for a gateway that ends each of them.
const FEW: usize = 5;
/// Pages of a list that goes on and brings nothing, within the same time.
const FEW_PAGES: usize = 200;
const WINDOW: Duration = Duration::from_secs(8);

struct Tease {
    /// What it passes on to the chain goes through the honest gateway.
    honest: Mutex<Client>,
    /// It has pages; they are empty, and there is always another one.
    answers: AtomicBool,
    /// Each is of another feed.
    is_always_another: AtomicBool,
    pages: AtomicUsize,
}

#[async_trait]
impl Tells for Tease {
    async fn relayed(&self, method: &str, parameters: &Value) -> Option<Value> {
        match self.honest.lock().await.relay(method, parameters).await {
            Ok(Relayed::Result(text)) => serde_json::from_str(&text).ok(),
            _ => None,
        }
    }

    fn told(&self, asked: &Feed) -> Option<FeedPage> {
        let page = self.pages.fetch_add(1, Ordering::AcqRel) as u64 + 1;
        if !self.answers.load(Ordering::Acquire) {
            return None;
        }
        let id = if self.is_always_another.load(Ordering::Acquire) { [page.to_be_bytes()[7]; 16] } else { [7; 16] };
        let upto = asked.places.iter().map(|place| place.after + 1).max().unwrap_or(1);
        let page = FeedPage::new(id, (u64::MAX, upto), Vec::new(), Vec::new());
        Some(FeedPage { is_anew: id != asked.id, ..page })
    }
}

impl Tease {
    /// How often it was asked for what is counted, once it had been at it for a while.
    async fn asked(&self, counted: &AtomicUsize) -> usize {
        tokio::time::sleep(WINDOW).await;
        let before = counted.load(Ordering::Acquire);
        tokio::time::sleep(WINDOW).await;
        counted.load(Ordering::Acquire) - before
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn wear_a_reader_out() {
    let (gate, away, his) = (Gate::new(), Home::new(), Home::new());
    let joins = |home: &Home, name: &str| home.profile(name).with(&gate.options());
    let (alice, mallory, bob) = (gate.home.profile("alice"), joins(&away, "mallory"), joins(&his, "bob"));
    let [_, worn, read] = [&alice, &mallory, &bob].map(Authros::enrol);
    for account in [&read, &worn] {
        gate.home.profile("gateway").json(&["gateway", "allow", account]);
    }
    alice.json(&["grant", "add", &read]);
    let of = |home: &Home, name: &str| Member::of(home, name, gate.gateway.domain);
    let (hostile, reader) = (of(&away, "mallory"), of(&his, "bob"));

    let credentials = hostile.allocate(&gate.gateway, "mallory-2").await.expect("admitted");
    let tease = Arc::new(Tease {
        honest: Mutex::new(connect(&gate.gateway, &credentials).await),
        answers: AtomicBool::default(),
        is_always_another: AtomicBool::default(),
        pages: AtomicUsize::default(),
    });
    let (context, folder) = (gate.gateway.endpoint().context, his.root().join("hostile"));
    let tells = Arc::clone(&tease) as Arc<dyn Tells>;
    let identity = hostile.keyring.signing.clone();
    let (server, key) = stub_desk::serve(context, &reader, identity, &folder, tells).await;
    // He joins it from now on.
    std::fs::remove_file(his.path().join("gateway-trust.json")).expect("the honest gateway's key");
    let address = server.address().to_string();
    let site = his.profile("bob").with(&["--site", &address, "--gateway-key", &key]).serve(&his);

    let refused = tease.asked(&tease.pages).await;
    tease.answers.store(true, Ordering::Release);
    let pages = tease.asked(&tease.pages).await;
    tease.is_always_another.store(true, Ordering::Release);
    let anew = tease.asked(&tease.pages).await;
    drop(site);
    server.stop(Duration::from_secs(2)).await;
    let seconds = WINDOW.as_secs();
    let told = format!("asked {refused} times in vain, and for {pages} and {anew} pages in {seconds} s each");
    let outcome = if refused > FEW || pages.max(anew) > FEW_PAGES {
        Outcome::Succeeded(told)
    } else if refused.min(pages).min(anew) == 0 {
        Outcome::Otherwise(format!("it is not asked again at all: {told}"))
    } else {
        Outcome::Refused(told)
    };
    judge("wear_a_reader_out", outcome);
}
