//! To stall a chain that the attacker does not own: frames of a hundred bytes, through the gateway's connection to it,
//! that occupy the chain's only thread for seconds and its memory forever.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use authros::chain::Call;
use authros::gateway::{Client, Code, GatewayError, Relayed};
use authros::model::{Address, Scope, Token};
use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest};
use ethers_signers::{LocalWallet, Signer as _};
use serde_json::{Value, json};

use super::parts::Parts;
use super::support::gate::Gate;
use super::support::member::{Gateway, Member, connect};
use super::support::source::line_from;
use super::support::{hex, long, text, unhex};
use super::{Outcome, judge};

const NAME: &str = "brick_the_chain_through_the_gateway";
/// Enough to be noticed, and little enough to finish on a build that accepts it.
const GAS: u64 = 30_000_000;
/// No block may come later, while transactions wait.
const LATE: Duration = Duration::from_secs(2);
/// How much more memory it may hold after a minute, MiB.
const ROOM: u64 = 32;

/// Creation code that burns all its gas.
fn payloads(gas: u64) -> [(&'static str, Vec<u8>); 3] {
    // A call gets 63 of 64 parts.
    let rounds = u32::try_from(gas / 64 * 60).unwrap_or(u32::MAX).to_be_bytes();
    let blake = [&[0x63][..], &rounds, &unhex("60e01b6000526040600060d5600060095afa5000")].concat();
    // A fresh slot, while more than 50,000 gas is left.
    let store = unhex("5b5a805561c3505a1160005700");
    // Lengths of 64 bytes each, base, exponent and modulus all ones; again while more than 50,000 gas is left.
    let lengths = "604060005260406020526040604052";
    let ones = "600019606052600019608052600019 60a05260001960c05260001960e052600019610100 52".replace(' ', "");
    let power = unhex(&format!("{lengths}{ones}5b6040610120610120600060055afa5061c3505a1160345700"));
    [("BLAKE2F", blake), ("SSTORE", store), ("modexp", power)]
}

/// A call of `to`, or a creation.
fn signed(key: &LocalWallet, chain: u64, nonce: u64, gas: u64, to: Option<H160>, data: &[u8]) -> String {
    let mut request = TransactionRequest::new().nonce(nonce).gas(gas).gas_price(0).value(0).chain_id(chain);
    request.to = to.map(Into::into);
    let typed = TypedTransaction::Legacy(request.data(data.to_vec()));
    let signature = key.clone().with_chain_id(chain).sign_transaction_sync(&typed).expect("signs");
    format!("0x{}", hex(&typed.rlp_signed(&signature)))
}

/// The refusal of a creation, by any sender.
const NOT_TO_THE_CONTRACT: &str = "only transactions to the contract";
/// The refusal of a call of the contract with more gas than any call needs.
const TOO_MUCH_GAS: &str = "is forwarded";
/// The pool's refusal of a nonce that is not the next one.
const ORDER: [&str; 3] = ["nonce", "already known", "underpriced"];
/// The gateways' refusals of clients that ask too much.
const BOUNDS: [Code; 4] = [Code::Quota, Code::Busy, Code::TooSlow, Code::Session];

/// Sends a frame; returns its hash if it was passed on. A client that comes too often may also be refused by one of
/// `bounds`.
async fn send(
    parts: &mut Parts,
    client: &mut Client,
    (what, words): (&str, &str),
    bounds: &[Code],
    raw: String,
) -> Option<String> {
    match client.relay("eth_sendRawTransaction", &json!([raw])).await {
        Ok(Relayed::Result(hash)) => return Some(hash),
        Ok(Relayed::Fault { words: read, .. }) => parts.refused(what, &read, words),
        Err(error) => bounded(parts, what, error, bounds),
    }
    None
}

/// All payloads as creations by unknown accounts: none must pass.
async fn send_all(parts: &mut Parts, client: &mut Client, who: &str, bounds: &[Code], chain: u64, gas: u64) {
    for (name, code) in payloads(gas) {
        let key = LocalWallet::new(&mut ethers::rand::thread_rng());
        let raw = signed(&key, chain, 0, gas, None, &code);
        if let Some(hash) = send(parts, client, (who, NOT_TO_THE_CONTRACT), bounds, raw).await {
            mined(client, &hash).await;
            parts.reached(format!("{gas} gas of {name} were mined, of a {who}"));
        }
    }
}

async fn mined(client: &mut Client, hash: &str) {
    let hash: Value = serde_json::from_str(hash).expect("JSON");
    let end = Instant::now() + Duration::from_secs(120);
    while Instant::now() < end {
        let receipt = client.relay("eth_getTransactionReceipt", &json!([hash])).await;
        if matches!(receipt, Ok(Relayed::Result(ref text)) if text != "null") {
            return;
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

async fn chain_id(client: &mut Client) -> u64 {
    let Ok(Relayed::Result(text)) = client.relay("eth_chainId", &json!([])).await else { panic!("no chain id") };
    u64::from_str_radix(text.trim_matches('"').trim_start_matches("0x"), 16).expect("hex")
}

async fn visit(gateway: &Gateway) -> Result<Client, GatewayError> {
    Client::visit(&gateway.endpoint(), &mut gateway.trust(), &"visitor".parse().expect("a name")).await
}

/// The account of a profile, whose key signs transactions.
fn wallet(member: &Member) -> LocalWallet {
    LocalWallet::from_bytes(&member.keyring.eoa.expose()[..]).expect("a key")
}

#[tokio::test(flavor = "multi_thread")]
async fn visitors_and_registered_accounts_send_what_never_ends() {
    let gate = Gate::new();
    let alice = gate.home.profile("alice");
    alice.enrol();
    let contract: H160 = text(&alice.json(&["chain", "status"]), "contract").parse().expect("an address");
    let alice = Member::of(&gate.home, "alice", gate.gateway.domain);
    let credentials = alice.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut visitor = visit(&gate.gateway).await.expect("visits");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let chain = chain_id(&mut visitor).await;
    let mut parts = Parts::default();
    send_all(&mut parts, &mut visitor, "visitor", &[], chain, GAS).await;
    send_all(&mut parts, &mut robot, "registered account", &[], chain, GAS).await;
    // By the registered account itself, to the contract, with more gas than a call needs.
    let raw = signed(&wallet(&alice), chain, 1_000, GAS, Some(contract), &[1; 4]);
    let what = "registered account, to the contract";
    if send(&mut parts, &mut robot, (what, TOO_MUCH_GAS), &[], raw).await.is_some() {
        parts.reached(format!("{GAS} gas of a registered account were passed on"));
    }
    judge(NAME, parts.outcome());
}

/// What was observed in a minute under attack.
struct Seen {
    sent: u64,
    refused: Vec<String>,
    /// Between two blocks, while anchors wait all the time.
    longest: Duration,
    /// Memory before and after, MiB.
    held: [u64; 2],
}

/// A robot uploads until `end`, while the blocks are watched.
async fn upload(gate: &Gate, owner: &Member, end: Instant) -> Seen {
    let of_robot = owner.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let of_eyes = owner.allocate(&gate.gateway, "robot-8").await.expect("allocates");
    let (mut robot, mut eyes) = (connect(&gate.gateway, &of_robot).await, connect(&gate.gateway, &of_eyes).await);
    let (mut seen, mut block, mut since) = (
        Seen { sent: 0, refused: Vec::new(), longest: Duration::ZERO, held: [gate.held(); 2] },
        String::new(),
        Instant::now(),
    );
    while Instant::now() < end {
        // Anchors of the uploads are always waiting, so that a block is always due.
        if let Ok(Relayed::Result(newest)) = eyes.relay("eth_blockNumber", &json!([])).await
            && newest != block
        {
            seen.longest = seen.longest.max(if block.is_empty() { Duration::ZERO } else { since.elapsed() });
            (block, since) = (newest, Instant::now());
        }
        seen.sent += 1;
        let record = owner.record(&owner.keyring.signing, "/robot7/log", seen.sent, b"a line of the log");
        if let Err(error) = robot.upload(vec![record]).await {
            seen.refused.push(error.to_string());
            robot = connect(&gate.gateway, &of_robot).await;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    seen.held[1] = gate.held();
    seen
}

/// How the minute ended: refusals of the attackers count only if nobody else was kept out.
fn minute(name: &str, seen: &Seen, attackers: Vec<Parts>, told: &str) {
    let figures = format!(
        "{} uploads in a minute, {} refused, {:.1} s between two blocks at most, {} MiB before, {} MiB after; {told}",
        seen.sent,
        seen.refused.len(),
        seen.longest.as_secs_f64(),
        seen.held[0],
        seen.held[1]
    );
    let mut parts = Parts::default();
    attackers.into_iter().for_each(|more| parts.add(more));
    if !seen.refused.is_empty() || seen.longest > LATE || seen.held[1] > seen.held[0] + ROOM {
        parts.reached(format!("{figures}; {:?}", seen.refused.first()));
    }
    let outcome = match parts.outcome() {
        Outcome::Refused(refusals) => Outcome::Refused(format!("{figures}; {refusals}")),
        Outcome::Otherwise(happened) => Outcome::Otherwise(format!("{figures}; {happened}")),
        Outcome::Succeeded(reached) => Outcome::Succeeded(reached),
    };
    judge(name, outcome);
}

/// Three connections to the gateway, each from its own address.
async fn three_lines(gate: &Gate) -> Vec<Gateway> {
    let to = gate.gateway.address.parse().expect("an address");
    let mut lines = Vec::new();
    for last in 1..=3 {
        lines.push(Gateway { address: line_from(last, to).await.to_string(), ..gate.gateway.clone() });
    }
    lines
}

/// Three addresses for a minute, each frame with all available gas or with as much as is admitted, two of visitors and
/// one of a registered robot, while another robot uploads.
#[tokio::test(flavor = "multi_thread")]
async fn three_addresses_for_a_minute_while_a_robot_uploads() {
    if !long() {
        return;
    }
    let gate = Gate::new();
    gate.home.profile("alice").enrol();
    let alice = Member::of(&gate.home, "alice", gate.gateway.domain);
    let chain = chain_id(&mut visit(&gate.gateway).await.expect("visits")).await;
    let end = Instant::now() + Duration::from_secs(60);
    let mut attackers = Vec::new();
    for (number, through) in three_lines(&gate).await.into_iter().enumerate() {
        let registered = match number {
            2 => Some(alice.allocate(&gate.gateway, "robot-9").await.expect("allocates")),
            _ => None,
        };
        attackers.push(tokio::spawn(async move {
            let (mut parts, who) =
                (Parts::default(), if registered.is_some() { "registered account" } else { "visitor" });
            while Instant::now() < end {
                let entered = match &registered {
                    Some(credentials) => Client::connect(&through.endpoint(), &mut through.trust(), credentials).await,
                    None => visit(&through).await,
                };
                let mut client = match entered {
                    Ok(client) => client,
                    Err(error) => {
                        bounded(&mut parts, who, error, &BOUNDS);
                        tokio::time::sleep(Duration::from_millis(100)).await;
                        continue;
                    }
                };
                for gas in [4_294_967_295, 10_000_000] {
                    send_all(&mut parts, &mut client, who, &BOUNDS, chain, gas).await;
                }
            }
            parts
        }));
    }
    let seen = upload(&gate, &alice, end).await;
    let mut all = Vec::new();
    for attacker in attackers {
        all.push(attacker.await.expect("ends"));
    }
    minute(NAME, &seen, all, "no creation passed on");
}

/// A client that comes too often is refused by name, in clear too: before a session there is no other way.
fn bounded(parts: &mut Parts, what: &str, error: GatewayError, bounds: &[Code]) {
    match error {
        GatewayError::RefusedInClear(code) if bounds.contains(&code) => parts.refused(what, code.text(), ""),
        error => parts.answered(what, Err(error), bounds),
    }
}

/// A registered account for a minute from three addresses: what it may send, calls of the contract with all the gas
/// that a transaction may have, each as expensive as the contract allows, as fast as the gateway accepts them.
#[tokio::test(flavor = "multi_thread")]
async fn a_registered_account_sends_all_it_may_for_a_minute() {
    if !long() {
        return;
    }
    let gate = Gate::new();
    let (alice, mallory) = (gate.home.profile("alice"), gate.home.profile("mallory"));
    let grantee = alice.enrol().parse().expect("an address");
    mallory.enrol();
    let contract: H160 = text(&alice.json(&["chain", "status"]), "contract").parse().expect("an address");
    let first = mallory.json(&["chain", "status"])["nonce"].as_u64().expect("a nonce");
    let [alice, mallory] = ["alice", "mallory"].map(|name| Member::of(&gate.home, name, gate.gateway.domain));
    let chain = chain_id(&mut visit(&gate.gateway).await.expect("visits")).await;
    let (key, end) = (wallet(&mallory), Instant::now() + Duration::from_secs(60));
    let (nonces, passed) = (Arc::new(AtomicU64::new(first)), Arc::new(AtomicU64::new(0)));
    let mut attackers = Vec::new();
    for (number, through) in three_lines(&gate).await.into_iter().enumerate() {
        let name = format!("mallory-{number}");
        let credentials = mallory.allocate(&gate.gateway, &name).await.expect("allocates");
        let (key, nonces, passed) = (key.clone(), Arc::clone(&nonces), Arc::clone(&passed));
        attackers.push(tokio::spawn(async move {
            let mut parts = Parts::default();
            let mut entered = None;
            while Instant::now() < end {
                let Some(client) = entered.as_mut() else {
                    let again = Client::connect(&through.endpoint(), &mut through.trust(), &credentials).await;
                    entered = again.map_err(|error| bounded(&mut parts, "mallory", error, &BOUNDS)).ok();
                    continue;
                };
                let nonce = nonces.fetch_add(1, Ordering::SeqCst);
                let call = dear_call(nonce - first, grantee);
                let raw = signed(&key, chain, nonce, 10_000_000, Some(contract), &call);
                match client.relay("eth_sendRawTransaction", &json!([raw])).await {
                    Ok(Relayed::Result(_)) => {
                        passed.fetch_add(1, Ordering::SeqCst);
                    }
                    // The pool has enough of this account, or a nonce before it was refused.
                    Ok(Relayed::Fault { words, .. }) if words.contains("txpool is full") => {
                        parts.refused("mallory", &words, "txpool is full");
                        nonces.fetch_min(nonce, Ordering::SeqCst);
                        tokio::time::sleep(Duration::from_millis(50)).await;
                    }
                    Ok(Relayed::Fault { words, .. }) if ORDER.iter().any(|word| words.contains(word)) => {
                        parts.refused("mallory", "a nonce out of its order", "nonce");
                    }
                    Ok(Relayed::Fault { words, .. }) => parts.otherwise(words),
                    Err(error) => {
                        bounded(&mut parts, "mallory", error, &BOUNDS);
                        entered = None;
                    }
                }
            }
            parts
        }));
    }
    let seen = upload(&gate, &alice, end).await;
    let mut all = Vec::new();
    for attacker in attackers {
        all.push(attacker.await.expect("ends"));
    }
    let passed = passed.load(Ordering::SeqCst);
    assert!(passed > 0, "what it may send was passed on");
    minute("send_all_that_a_registered_account_may", &seen, all, &format!("{passed} calls passed on"));
}

/// Grants with the longest envelope, then revokes.
fn dear_call(number: u64, grantee: Address) -> Vec<u8> {
    let call = if number.is_multiple_of(2) {
        let (scope, envelope) = (Scope::All, vec![7; 4_096]);
        Call::AuthorityGrant { grantee, epoch: 1 + number / 2, expiry: None, scope, envelope }
    } else {
        Call::AuthorityRevoke {
            grantee,
            new_token: Token([number.to_be_bytes(); 4].concat().try_into().expect("32")),
            envelope: Vec::new(),
        }
    };
    call.encode().expect("encodes")
}
