//! To keep everyone else out: three addresses open connections and say nothing, until every place is taken.

use std::time::{Duration, Instant};

use authros::gateway::{Code, GatewayError};
use tokio::net::TcpStream;

use super::support::gate::Gate;
use super::support::member::{Gateway, Member};
use super::support::source::{connect_from, line_from};
use super::{Outcome, judge};

/// What one address may open at once on any build.
const EACH: usize = 190;
/// The fourth must be in before the first places are given back by themselves, after ten seconds.
const SOON: Duration = Duration::from_secs(5);

#[tokio::test(flavor = "multi_thread")]
async fn three_addresses_hold_every_place() {
    let gate = Gate::new();
    gate.home.profile("alice").enrol();
    let alice = Member::of(&gate.home, "alice", gate.gateway.domain);
    let to = gate.gateway.address.parse().expect("an address");
    let mut held: Vec<TcpStream> = Vec::new();
    for _ in 0..EACH {
        for last in 1..=3 {
            held.extend(connect_from(last, to).await);
        }
    }
    // The gateway takes them one after the other.
    tokio::time::sleep(Duration::from_millis(500)).await;
    let fourth = Gateway { address: line_from(4, to).await.to_string(), ..gate.gateway.clone() };
    let begun = Instant::now();
    let entered = alice.allocate(&fourth, "fourth").await;
    let (took, beside) = (begun.elapsed(), held.len());
    let told = format!("a fourth was allocated a name beside {beside} silent connections in {} ms", took.as_millis());
    let outcome = match entered {
        Ok(_) if took < SOON => Outcome::Refused(told),
        Ok(_) => Outcome::Succeeded(format!("{told}, when places were given back")),
        Err(
            error @ (GatewayError::Unreachable { .. }
            | GatewayError::Closed
            | GatewayError::TimedOut
            | GatewayError::Refused(Code::Busy)
            | GatewayError::RefusedInClear(Code::Busy)),
        ) => Outcome::Succeeded(format!("{beside} connections of three addresses, and a fourth: {error}")),
        Err(error) => Outcome::Otherwise(format!("the fourth: {error}")),
    };
    judge("hold_all_handshake_places", outcome);
}
