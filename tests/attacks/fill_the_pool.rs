//! To fill the chain's memory with transactions that can never be mined: nonces of one account with a gap before them.

use serde_json::{Value, json};

use crate::support::Home;
use crate::{Outcome, judge, served::Served};

/// How many are sent.
const SENT: u64 = 1_500;
/// How many may be accepted without the attack having achieved anything.
const FEW: usize = 200;

#[test]
fn fill_the_pool() {
    let home = Home::new();
    let chain = Served::start(&home);
    let nonces: Vec<u64> = (1..=SENT).collect();
    let (mut taken, mut refusal) = (0, String::new());
    for some in nonces.chunks(100) {
        let batch: Vec<Value> = some
            .iter()
            .map(|nonce| {
                let raw = chain.signed(1, *nonce, 21_000, None);
                json!({ "jsonrpc": "2.0", "id": nonce, "method": "eth_sendRawTransaction", "params": [raw] })
            })
            .collect();
        let answers = chain.post(&Value::Array(batch)).expect("an answer");
        for answer in answers.as_array().expect("a batch") {
            match answer.get("error") {
                Some(error) => refusal = error["message"].as_str().unwrap_or_default().to_owned(),
                None => taken += 1,
            }
        }
    }
    judge(
        "fill the pool",
        if taken > FEW {
            Outcome::Succeeded(format!("{taken} of {SENT} future nonces of one account wait"))
        } else if refusal.contains("nonce too high") && refusal.contains("ahead") {
            Outcome::Refused(format!("{taken} of {SENT} taken, then: {refusal}"))
        } else {
            Outcome::Otherwise(format!("{taken} of {SENT} taken, then: {refusal}"))
        },
    );
}
