//! To keep newcomers and admitted readers out: eight addresses take every visitor's place at a gateway and keep it.

use std::time::Duration;

use authros::gateway::{Client, GatewayError, Trust};
use serde_json::json;

use super::support::gate::Gate;
use super::support::member::Gateway;
use super::support::source::line_from;
use super::support::{Home, wait_until};
use super::{Outcome, judge};

/// The visitors' places of one address, and the addresses that take them all.
const EACH: usize = 8;
const ADDRESSES: u8 = 8;
/// The address of the newcomer.
const NEWCOMER: u8 = 20;

/// The gateway as seen from 127.0.0.`last`.
async fn seen_from(last: u8, gateway: &Gateway) -> Gateway {
    let to = gateway.address.parse().expect("an address");
    Gateway { address: line_from(last, to).await.to_string(), ..gateway.clone() }
}

/// A visitor's place, taken by a small request; it is kept by one every few seconds.
async fn visit(from: &Gateway) -> Result<Client, GatewayError> {
    let mut trust = Trust::pinned(from.id);
    let mut client = Client::visit(&from.endpoint(), &mut trust, &"visitor".parse().expect("a name")).await?;
    client.relay("eth_chainId", &json!([])).await?;
    Ok(client)
}

/// Keeps a place for as long as it lasts, and takes another one when it is lost.
async fn keep(from: Gateway, mut client: Client) {
    loop {
        tokio::time::sleep(Duration::from_secs(2)).await;
        if client.relay("eth_chainId", &json!([])).await.is_err()
            && let Ok(again) = visit(&from).await
        {
            client = again;
        }
    }
}

/// Takes up to `EACH` places from 127.0.0.`last` and keeps them; returns how many there were.
async fn hold(last: u8, gateway: &Gateway) -> usize {
    let (from, mut held) = (seen_from(last, gateway).await, 0);
    for _ in 0..EACH {
        if let Ok(client) = visit(&from).await {
            held += 1;
            tokio::spawn(keep(from.clone(), client));
        }
    }
    held
}

#[tokio::test(flavor = "multi_thread")]
async fn eight_addresses_hold_every_visitors_place() {
    let (gate, away) = (Gate::new(), Home::new());
    let bob = away.profile("bob").with(&gate.options());
    let address = bob.enrol();
    gate.home.profile("gateway").with(&["--robots", "0"]).json(&["gateway", "allow", &address]);
    // Allocates the transport key, in its own time.
    let site = bob.serve(&away);
    let key = away.path().join("profiles/bob/transport-key");
    wait_until(60, "a transport key", || key.exists().then_some(()));
    site.stop("TERM", 30).expect_code(0);

    let mut held = 0;
    for last in 1..=ADDRESSES {
        held += hold(last, &gate.gateway).await;
    }
    assert_eq!(held, EACH * usize::from(ADDRESSES), "every place is held");

    let listed = bob.run(&["received", "list", "--oldest"]);
    let newcomer = visit(&seen_from(NEWCOMER, &gate.gateway).await).await;
    let mut stays = true;
    if let Ok(mut newcomer) = newcomer {
        for _ in 0..5 {
            tokio::time::sleep(Duration::from_secs(1)).await;
            stays &= newcomer.relay("eth_chainId", &json!([])).await.is_ok();
        }
    } else {
        stays = false;
    }
    let outcome = match (listed.code, stays) {
        (Some(0), true) => Outcome::Refused(format!(
            "beside {held} held places an admitted reader lists what is shared, and a newcomer has a place and keeps it"
        )),
        (code, stays) => Outcome::Succeeded(format!(
            "with {held} held places an admitted reader's list ends with {code:?} ({}), and a newcomer has a place: {stays}",
            listed.stderr.trim()
        )),
    };
    judge("fill_the_visitors_places", outcome);
}
