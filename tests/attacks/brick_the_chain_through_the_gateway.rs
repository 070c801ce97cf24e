//! To stall a chain that the attacker does not own: frames of a hundred bytes, through the gateway's connection to it,
//! that occupy the chain's only thread for seconds and its memory forever.

use std::time::{Duration, Instant};

use authros::gateway::{Client, GatewayError, Relayed};
use ethers::signers::{LocalWallet, Signer as _};
use ethers::types::TransactionRequest;
use ethers::types::transaction::eip2718::TypedTransaction;
use serde_json::{Value, json};

use super::support::gate::Gate;
use super::support::member::{Gateway, Member, connect};
use super::support::source::line_from;
use super::support::{hex, long, unhex};
use super::{Outcome, judge};

const NAME: &str = "brick_the_chain_through_the_gateway";
/// Enough to be noticed, and little enough to finish on a build that accepts it.
const GAS: u64 = 30_000_000;

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

fn signed(key: &LocalWallet, chain: u64, nonce: u64, gas: u64, code: &[u8]) -> String {
    let request = TransactionRequest::new().nonce(nonce).gas(gas).gas_price(0).value(0).chain_id(chain);
    let typed = TypedTransaction::Legacy(request.data(code.to_vec()));
    let signature = key.clone().with_chain_id(chain).sign_transaction_sync(&typed).expect("signs");
    format!("0x{}", hex(&typed.rlp_signed(&signature)))
}

/// Which payloads the gateway passed on, and its words when it refused the last.
async fn send_all(client: &mut Client, chain: u64, gas: u64) -> (Vec<&'static str>, String) {
    let (mut passed, mut refusal) = (Vec::new(), String::new());
    for (name, code) in payloads(gas) {
        let key = LocalWallet::new(&mut ethers::core::rand::thread_rng());
        match client.relay("eth_sendRawTransaction", &json!([signed(&key, chain, 0, gas, &code)])).await {
            Ok(Relayed::Result(hash)) => {
                passed.push(name);
                mined(client, &hash).await;
            }
            Ok(Relayed::Fault { words, .. }) => refusal = words,
            Err(error) => refusal = error.to_string(),
        }
    }
    (passed, refusal)
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

#[tokio::test(flavor = "multi_thread")]
async fn visitors_and_registered_accounts_send_what_never_ends() {
    let gate = Gate::new();
    gate.home.profile("alice").enrol();
    let alice = Member::of(&gate.home, "alice", gate.gateway.domain);
    let credentials = alice.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut visitor = visit(&gate.gateway).await.expect("visits");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let chain = chain_id(&mut visitor).await;
    let (by_visitor, refusal) = send_all(&mut visitor, chain, GAS).await;
    let (by_robot, words) = send_all(&mut robot, chain, GAS).await;
    if by_visitor.is_empty() && by_robot.is_empty() {
        judge(NAME, Outcome::Refused(format!("visitor: {refusal}; registered: {words}")));
    } else {
        let what =
            format!("{GAS} gas each were mined of a visitor {by_visitor:?}, of a registered account {by_robot:?}");
        judge(NAME, Outcome::Succeeded(what));
    }
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
    let credentials = alice.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let credentials_of_eyes = alice.allocate(&gate.gateway, "robot-8").await.expect("allocates");
    let chain = chain_id(&mut robot).await;
    let end = Instant::now() + Duration::from_secs(60);
    let to = gate.gateway.address.parse().expect("an address");
    let mut attackers = Vec::new();
    for last in 1..=3 {
        let through = Gateway { address: line_from(last, to).await.to_string(), ..gate.gateway.clone() };
        let registered = match last {
            3 => Some(alice.allocate(&gate.gateway, "robot-9").await.expect("allocates")),
            _ => None,
        };
        attackers.push(tokio::spawn(async move {
            let mut passed = 0;
            while Instant::now() < end {
                let entered = match &registered {
                    Some(credentials) => Client::connect(&through.endpoint(), &mut through.trust(), credentials).await,
                    None => visit(&through).await,
                };
                let Ok(mut client) = entered else {
                    tokio::time::sleep(Duration::from_millis(100)).await;
                    continue;
                };
                for gas in [4_294_967_295, 10_000_000] {
                    passed += send_all(&mut client, chain, gas).await.0.len();
                }
            }
            passed
        }));
    }
    let mut eyes = connect(&gate.gateway, &credentials_of_eyes).await;
    let (mut sent, mut refused, held) = (0, Vec::new(), gate.held());
    let (mut block, mut since, mut longest) = (String::new(), Instant::now(), Duration::ZERO);
    while Instant::now() < end {
        // Anchors of the uploads wait all the time, so that a block is always due.
        if let Ok(Relayed::Result(newest)) = eyes.relay("eth_blockNumber", &json!([])).await
            && newest != block
        {
            longest = longest.max(if block.is_empty() { Duration::ZERO } else { since.elapsed() });
            (block, since) = (newest, Instant::now());
        }
        sent += 1;
        let upload = alice.record(&alice.keyring.signing, "/robot7/log", sent, b"a line of the log");
        if let Err(error) = robot.upload(vec![upload]).await {
            refused.push(error.to_string());
            robot = connect(&gate.gateway, &credentials).await;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let mut passed = 0;
    for attacker in attackers {
        passed += attacker.await.expect("ends");
    }
    if passed == 0 && refused.is_empty() {
        let figures = format!(
            "{:.1} s between two blocks at most; {held} MiB before, {} MiB after",
            longest.as_secs_f64(),
            gate.held()
        );
        judge(
            NAME,
            Outcome::Refused(format!("{sent} uploads in a minute, none refused, no frame passed on; {figures}")),
        );
    } else {
        judge(
            NAME,
            Outcome::Succeeded(format!("{passed} frames passed on, {} of {sent} uploads refused", refused.len())),
        );
    }
}
