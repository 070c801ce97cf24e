//! A gateway that a reader joins beside an honest one wants to keep his site busy: it lists for him and never lets him
//! subscribe, or ends each subscription as it begins, or its list has no end. He opens sessions and asks for pages in vain ever
//! more rarely, and the honest gateway's records come to him all the same.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use authros::gateway::{Code, HandedOver, HoldingPlace, Holdings, Page, Query, Wanted};

use super::read_while_suspended::send;
use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::stub_desk::{self, Tells};
use super::support::{Authros, Home, is_verified, poll};
use super::{Outcome, judge};

/// Sessions that a site may open within [`WINDOW`] for a gateway that ends each of them.
const FEW: usize = 5;
/// Pages of a list that goes on and brings nothing, within the same time.
const FEW_PAGES: usize = 200;
const WINDOW: Duration = Duration::from_secs(8);

#[derive(Default)]
struct Tease {
    ends_them: AtomicBool,
    subscriptions: AtomicUsize,
    has_no_end: AtomicBool,
    pages: AtomicUsize,
}

impl Tells for Tease {
    fn holdings(&self, _: &HoldingPlace) -> Option<Holdings> {
        None
    }

    fn hand_over(&self, _: &Wanted) -> HandedOver {
        HandedOver::default()
    }

    fn listed(&self, _: &Query) -> Option<Page> {
        let page = self.pages.fetch_add(1, Ordering::AcqRel) + 1;
        let next = self.has_no_end.load(Ordering::Acquire).then_some(page as u128);
        Some(Page { entries: Vec::new(), next })
    }

    fn refuses_subscriptions(&self) -> Option<Code> {
        self.subscriptions.fetch_add(1, Ordering::AcqRel);
        (!self.ends_them.load(Ordering::Acquire)).then_some(Code::NotAuthorised)
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
    let [owned, _, read] = [&alice, &mallory, &bob].map(Authros::enrol);
    gate.home.profile("gateway").json(&["gateway", "admit", &read]);
    alice.json(&["grant", &read]);
    let of = |home: &Home, name: &str| Member::of(home, name, gate.gateway.domain);
    let (owner, hostile, reader) = (of(&gate.home, "alice"), of(&away, "mallory"), of(&his, "bob"));

    let tease = Arc::new(Tease::default());
    let (context, folder) = (gate.gateway.endpoint().context, his.root().join("hostile"));
    let tells = Arc::clone(&tease) as Arc<dyn Tells>;
    let identity = hostile.keyring.signing.clone();
    let (server, key) = stub_desk::serve(context, &reader, identity, &folder, tells).await;
    let bob = bob.with_variable("AUTHROS_SITE_ALSO", &format!("{}={key}", server.address()));
    let site = bob.serve(&his);

    let refused = tease.asked(&tease.subscriptions).await;
    tease.ends_them.store(true, Ordering::Release);
    let ended = tease.asked(&tease.subscriptions).await;
    tease.has_no_end.store(true, Ordering::Release);
    let pages = tease.asked(&tease.pages).await;
    let credentials = owner.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&gate.gateway, &credentials).await;
    send(&owner, &mut robot, 1).await;
    let list = ["shared", "list", "--owner", &owned];
    let arrived = tokio::task::block_in_place(|| {
        poll(60, || {
            let records = bob.records_so_far(&list)?;
            (records.len() == 1 && records.iter().all(is_verified)).then_some(())
        })
    });
    drop(site);
    server.stop(Duration::from_secs(2)).await;
    let seconds = WINDOW.as_secs();
    let told = format!("asked for {refused} and {ended} subscriptions and {pages} pages in {seconds} s each");
    let outcome = if arrived.is_none() {
        Outcome::Succeeded(format!("the honest gateway's record did not come; {told}"))
    } else if refused.max(ended) > FEW || pages > FEW_PAGES {
        Outcome::Succeeded(told)
    } else if refused.min(ended).min(pages) == 0 {
        Outcome::Otherwise(format!("it is not asked again at all: {told}"))
    } else {
        Outcome::Refused(told)
    };
    judge("wear_a_reader_out", outcome);
}
