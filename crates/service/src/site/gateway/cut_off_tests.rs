//! A gateway whose chain is taken away from it and comes back, on a chain that another site serves.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::oneshot;

use crate::chain::{Chain, serve};
use crate::command::{Administration, GrantFrom};
use crate::gateway::{Caller, Code, Desk as _, Feed, Place};
use crate::model::Party;
use crate::pipeline::Owner;
use crate::site::Needs;
use crate::site::testing::{registered, site_of, site_with_chain};

/// A served chain; it ends with this.
struct Served {
    address: SocketAddr,
    stop: oneshot::Sender<()>,
    ended: tokio::task::JoinHandle<()>,
}

async fn served(chain: &Chain, address: &str) -> Served {
    let listener = serve::listen(address.parse().expect("an address")).await.expect("free");
    let address = listener.local_addr().expect("bound");
    let (stop, stopped) = oneshot::channel::<()>();
    let chain = chain.clone();
    let ended = tokio::spawn(async move {
        chain.serve(listener, async { drop(stopped.await) }).await.expect("serves");
    });
    Served { address, stop, ended }
}

impl Served {
    async fn end(self) -> SocketAddr {
        drop(self.stop);
        self.ended.await.expect("ended");
        self.address
    }
}

fn caller(owner: &Owner) -> Caller {
    Caller {
        name: owner.profile.clone(),
        account: owner.address,
        signing: owner.signing().public,
        device: None,
        peer: "127.0.0.1:1".parse().expect("an address"),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_gateway_that_was_cut_off_refuses_until_its_chain_is_fresh() {
    let (ground, _folder) = site_with_chain();
    let founder = registered(&ground, "founder").await;
    let chain = ground.network().await.expect("a chain").chain;
    let contract = chain.pin().expect("deployed").contract.to_string();
    let line = served(&chain, "127.0.0.1:0").await;
    let url = format!("http://{}", line.address);
    let settings = [("chain.url", url.as_str()), ("chain.contract", contract.as_str()), ("confirmations", "1")];
    let (site, _second) = site_of(&settings, Needs { ros: false, chain: true });
    let keeper = registered(&site, "keeper").await;
    let (alice, bob) = (registered(&site, "alice").await, registered(&site, "bob").await);
    let (carol, to) = (registered(&site, "carol").await, |owner: &Arc<Owner>| Party::Address(owner.address));
    for reader in [&bob, &carol] {
        site.sharing.grant(&alice, &to(reader), &[], GrantFrom::Current, None).await.expect("given");
    }
    let (_running, ended) = oneshot::channel();
    let serving = site.gateway.serve(&keeper, "127.0.0.1:0".parse().expect("an address"), false, ended).await;
    serving.expect("serves");
    let desk = site.gateway.desk_of(&keeper, ground.network().await.expect("a chain").domain);
    let ask = async |reader: &Owner| {
        desk.feed(&caller(reader), &Feed::of(alice.address), false).await.map_err(|refusal| refusal.code)
    };
    while ask(&bob).await == Err(Code::NotAuthorised) || ask(&carol).await == Err(Code::NotAuthorised) {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert!(ask(&bob).await.is_ok(), "{:?}", ask(&bob).await);
    // Carol goes by another grant than the gateway knows: what it told her would count as all that hers gives.
    let grants = site.network().await.expect("a chain").directory.grants_to(carol.address);
    let known = Place::grant_of(&grants[0].transaction);
    for (grant, told) in [(known, Ok(())), (0, Ok(())), (known + 1, Err(Code::NotAuthorised))] {
        let asked = Feed { places: vec![Place { owner: alice.address, after: 0, grant }], ..Feed::of(alice.address) };
        let page = desk.feed(&caller(&carol), &asked, false).await;
        assert_eq!(page.map(drop).map_err(|refusal| refusal.code), told, "by grant {grant}");
    }

    let address = line.end().await;
    let act = Administration::Suspend { account: Party::Address(bob.address) };
    ground.administering.administer(&founder, &act).await.expect("suspended");
    while ask(&bob).await.is_ok() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    for (reader, whose) in [(&bob, "a reader"), (&alice, "the owner herself")] {
        assert_eq!(ask(reader).await.map(drop), Err(Code::Stale), "{whose}");
    }
    assert!(desk.account(&alice.address, None).await.is_ok(), "what robots bring is taken all the same");

    let _line = served(&chain, &address.to_string()).await;
    let answer = loop {
        match ask(&bob).await {
            Err(Code::Stale) => tokio::time::sleep(Duration::from_millis(50)).await,
            answer => break answer,
        }
    };
    assert_eq!(answer.map(drop), Err(Code::Suspended), "the first answer knows what happened meanwhile");
    assert!(ask(&carol).await.is_ok() && ask(&alice).await.is_ok(), "hers goes on");
    site.stop().await;
    ground.stop().await;
}

impl super::Gateway {
    /// The desk of a gateway that this profile keeps.
    pub(super) fn desk_of(self: &Arc<Self>, keeper: &Arc<Owner>, domain: crate::model::Domain) -> super::GatewayDesk {
        let (under, address) =
            (Arc::new(std::sync::RwLock::new(keeper.envelopes())), SocketAddr::from(([127, 0, 0, 1], 0)));
        let (home_accounts, guests, keeper) = (Arc::default(), Arc::default(), Arc::clone(keeper));
        let place = super::Place { keeper, under, domain, address, open: false, home_accounts, guests };
        super::GatewayDesk { gateway: Arc::clone(self), place }
    }
}
