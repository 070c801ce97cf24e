//! The chain through a gateway: who may ask, what passes, what it costs.

use std::time::Duration;

use serde_json::{Value, json};

use super::stage::{Stage, refusal};
use super::*;
use crate::gateway::command::messages::LONGEST_PARAMETERS;
use crate::model::Domain;

const PATIENCE: Duration = Duration::from_secs(30);

async fn visit(stage: &Stage) -> Result<Client, GatewayError> {
    Client::visit(&stage.endpoint, &mut stage.trust(), &"visitor".parse().expect("a name")).await
}

#[tokio::test]
async fn a_stranger_learns_the_network_and_nothing_else() {
    let stage = Stage::new().await;
    let told = Client::inquire(&stage.endpoint.addresses, PATIENCE).await.expect("tells");
    assert_eq!(told, network());
    assert_eq!(told.domain(), crate::crypto::domain(7, &told.genesis, &told.contract));
    // The hello proves it: on a network that was only claimed the gateway signs nothing.
    let mut claimed = stage.endpoint.clone();
    claimed.context.domain = Domain([0x99; 32]);
    let refused = Client::visit(&claimed, &mut stage.trust(), &"visitor".parse().expect("a name")).await;
    assert_eq!(refusal(refused), Some(Code::Network));
    assert_eq!(stage.desk.state().changes, 0);
}

#[tokio::test]
async fn a_visitor_reads_the_chain_for_longer_than_it_may_allocate() {
    let stage = Stage::new().await;
    let mut visitor = visit(&stage).await.expect("visits");
    for number in 0..40 {
        let relayed = visitor.relay("eth_call", &json!([number])).await.expect("answers");
        assert_eq!(relayed, Relayed::Result(format!("[{number}]")));
    }
    let Relayed::Result(code) = visitor.relay("eth_getCode", &json!([])).await.expect("in parts") else {
        panic!("a result")
    };
    assert_eq!(code.len(), (3 << 20) + 2);
    assert!(stage.desk.state().relayed.iter().all(|(caller, _)| caller.is_none()));
    // Everything else is for sessions under a transport key.
    assert_eq!(refusal(visitor.missing(&[crate::model::Digest([1; 32])]).await), Some(Code::NotHere));
    assert_eq!(stage.desk.state().changes, 0);
}

#[tokio::test]
async fn a_session_under_a_transport_key_reads_the_chain_in_its_name() {
    let stage = Stage::new().await;
    let alice = Member::new("alice", 0x11);
    let credentials = stage.enrol(&alice).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    client.relay("eth_chainId", &json!([])).await.expect("answers");
    assert_eq!(stage.desk.state().relayed, [(Some(alice.account()), "eth_chainId".to_owned())]);
    // A suspended account can still read the chain, which is open to everyone.
    stage.desk.state().accounts.clear();
    client.relay("eth_chainId", &json!([])).await.expect("answers");
    let raw = json!([format!("0x{}", "00".repeat(32 * 1024))]);
    let Relayed::Result(text) = client.relay("eth_sendRawTransaction", &raw).await.expect("the longest") else {
        panic!("a result")
    };
    assert_eq!(serde_json::from_str::<Value>(&text).expect("JSON"), raw);
}

#[tokio::test]
async fn what_is_not_passed_on_or_fails_is_said() {
    let stage = Stage::new().await;
    let mut visitor = visit(&stage).await.expect("visits");
    for method in ["eth_sign", "eth_accounts", "anvil_mine", "admin_peers", "eth_newFilter"] {
        assert_eq!(refusal(visitor.relay(method, &json!([])).await), Some(Code::Method), "{method}");
    }
    assert_eq!(refusal(visitor.relay("eth_call", &json!({ "to": 1 })).await), Some(Code::Method));
    assert_eq!(refusal(visitor.relay("eth call", &json!([])).await), Some(Code::Malformed));
    let fault = visitor.relay("eth_gasPrice", &json!(["0x08c379a0"])).await.expect("answers");
    let words = "execution reverted: no grant".to_owned();
    assert_eq!(fault, Relayed::Fault { code: 3, words, data: "[\"0x08c379a0\"]".into() });
    assert_eq!(refusal(visitor.relay("net_version", &json!([])).await), Some(Code::Stale));
    let long = json!(["x".repeat(LONGEST_PARAMETERS)]);
    assert!(matches!(visitor.relay("eth_call", &long).await, Err(GatewayError::TooLarge(_))));
    visitor.relay("eth_call", &json!([])).await.expect("the session goes on");
}

#[tokio::test]
async fn visitors_are_few_and_their_answers_are_charged() {
    let limits = Limits { visits_of_peer: 2, quota_of_peer: 1 << 20, ..Limits::default() };
    let stage = Stage::with(limits).await;
    let mut visitors = [visit(&stage).await.expect("one"), visit(&stage).await.expect("two")];
    let mut third = visit(&stage).await.expect("connects");
    for visitor in &mut visitors {
        visitor.relay("eth_call", &json!([])).await.expect("answers");
    }
    assert_eq!(refusal(third.relay("eth_call", &json!([])).await), Some(Code::Busy));
    assert_eq!(refusal(visitors[0].relay("eth_getCode", &json!([])).await), Some(Code::Quota), "3 MiB");
    drop(visitors);
    let mut later = visit(&stage).await.expect("connects");
    let mut answered = later.relay("eth_call", &json!([])).await;
    for _ in 0..100 {
        // The gateway soon notices that the others are gone.
        if answered.is_ok() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
        later = visit(&stage).await.expect("connects");
        answered = later.relay("eth_call", &json!([])).await;
    }
    answered.expect("a place was given back");
}

fn line(stage: &Stage, trust: KeptTrust) -> ChainLine {
    ChainLine::new(stage.endpoint.clone(), std::sync::Arc::new(trust), "visitor".parse().expect("a name"))
}

#[tokio::test]
async fn a_line_to_the_chain_heals_and_proves_itself_as_soon_as_it_can() {
    use crate::model::relay::{Relay as _, RelayError};
    let home = tempfile::tempdir().expect("folder");
    let (stage, alice) = (Stage::new().await, Member::new("alice", 0x11));
    let credentials = stage.enrol(&alice).await;
    let file = home.path().join("gateway.json");
    let line = line(&stage, KeptTrust::open(file.clone(), Some(stage.server.id()), false).expect("opens"));
    assert_eq!(line.ask("eth_call", json!([1])).await, Ok(json!([1])));
    assert!(file.exists(), "what was seen of the gateway is kept");
    let fault = line.ask("eth_gasPrice", json!([2])).await.expect_err("reverted");
    let message = "execution reverted: no grant".to_owned();
    assert_eq!(fault, RelayError::Answered { code: 3, message, data: Some(json!([2])) });
    assert_eq!(line.ask("eth_sign", json!([])).await, Err(RelayError::NotAllowed));
    assert!(matches!(line.ask("net_version", json!([])).await, Err(RelayError::Silent(_))));
    // Abandoned halfway: the next request gets its own answer. Occasionally the answer is quicker, which is fine.
    drop(tokio::time::timeout(Duration::ZERO, line.ask("eth_call", json!(["given up"]))).await);
    assert_eq!(line.ask("eth_call", json!([3])).await, Ok(json!([3])));
    line.prove_by(credentials.clone());
    assert_eq!(line.ask("eth_chainId", json!([])).await, Ok(json!([])));
    assert_eq!(stage.desk.state().relayed.last().expect("asked").0, Some(alice.account()));
    // A void key: the chain can still be read.
    line.prove_by(Credentials { key: crate::crypto::TransportKey::new([1; 32]), ..credentials });
    stage.desk.state().bindings.clear();
    assert_eq!(line.meet().await.expect("connected").gateway, stage.server.id());
    stage.server.stop(Duration::from_secs(5)).await;
    assert!(matches!(line.ask("eth_call", json!([4])).await, Err(RelayError::Silent(_))), "the gateway is gone");
}

#[tokio::test]
async fn a_line_to_another_gateway_is_refused() {
    let home = tempfile::tempdir().expect("folder");
    let stage = Stage::new().await;
    let other = crate::model::SignerId([7; 32]);
    let trust = KeptTrust::open(home.path().join("gateway.json"), Some(other), false).expect("opens");
    let refused = line(&stage, trust).meet().await;
    assert!(matches!(refused, Err(GatewayError::NotTheGateway { pinned, .. }) if pinned == other));
    assert!(!home.path().join("gateway.json").exists(), "nothing was learnt");
    let nobody = KeptTrust::open(home.path().join("gateway.json"), None, false).expect("opens");
    assert!(matches!(line(&stage, nobody).meet().await, Err(GatewayError::NotPinned(_))));
}
