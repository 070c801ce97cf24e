//! To keep everyone's transactions out of the chain with one short frame that costs nothing: BLAKE2F at one gas per
//! round, new storage slots, MODEXP with a long exponent.

use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::{Home, wait_until};
use crate::{Outcome, judge, served::Served};

/// What a block of the chain could hold before.
const ALL_GAS: u64 = 0xffff_ffff;
/// What a transaction may have now.
const CAPPED_GAS: u64 = 10_000_000;

/// Refusals of transactions within that: of work that the gas does not pay for, and of more than may wait.
const NAMED: [&str; 3] = ["too much work for its gas", "txpool is full", "are rate-limited"];

/// MSTORE(0, rounds << 224), then STATICCALL(gas, 9, 0, 213, 0, 64).
fn blake2f(rounds: u32) -> Vec<u8> {
    let mut code = vec![0x63];
    code.extend(rounds.to_be_bytes());
    code.extend([0x60, 0xe0, 0x1b, 0x60, 0, 0x52]);
    code.extend([0x60, 64, 0x60, 0, 0x60, 213, 0x60, 0, 0x60, 9, 0x5a, 0xfa, 0]);
    code
}

/// SSTORE(n, n) for n from 1 on.
const SSTORE: [u8; 11] = [0x60, 1, 0x5b, 0x80, 0x80, 0x55, 0x60, 1, 0x01, 0x60, 2];

/// MODEXP of one byte to 20,000 bytes of nothing, over and over.
const MODEXP: [u8; 34] = [
    0x60, 1, 0x60, 0, 0x52, 0x61, 0x4e, 0x20, 0x60, 32, 0x52, 0x60, 1, 0x60, 64, 0x52, 0x5b, 0x60, 1, 0x60, 0, 0x61,
    0x4f, 0, 0x60, 0, 0x60, 5, 0x5a, 0xfa, 0x50, 0x60, 16, 0x56,
];

fn looped(code: &[u8]) -> Vec<u8> {
    [code, &[0x56]].concat()
}

#[test]
fn stall_the_chain() {
    let home = Home::new();
    let chain = Served::start(&home);
    let payloads = [("BLAKE2F", blake2f(4_209_000_000)), ("SSTORE", looped(&SSTORE)), ("MODEXP", MODEXP.to_vec())];
    let mut refusals = Vec::new();
    for (stranger, (name, code)) in (1u8..).zip(&payloads) {
        match chain.send(&chain.signed(stranger, 0, ALL_GAS, Some(code))) {
            Err(words) if words.contains("exceeds the gas limit of a transaction") => {
                refusals.push(format!("{name}: {words}"));
            }
            Err(words) => return judge("stall the chain", Outcome::Otherwise(format!("{name}: {words}"))),
            Ok(_) => {
                let reached = format!("{name} with {ALL_GAS} gas was taken{}", kept_out(&chain));
                return judge("stall the chain", Outcome::Succeeded(reached));
            }
        }
    }
    // As much as is accepted: a small transaction that comes later overtakes most of it.
    for stranger in 20..60u8 {
        let code = match stranger % 3 {
            0 => blake2f(9_800_000),
            1 => looped(&SSTORE),
            _ => MODEXP.to_vec(),
        };
        if let Err(words) = chain.send(&chain.signed(stranger, 0, CAPPED_GAS, Some(&code))) {
            if !NAMED.iter().any(|named| words.contains(named)) {
                return judge("stall the chain", Outcome::Otherwise(words));
            }
            refusals.push(words);
        }
    }
    let honest = chain.send(&chain.signed(99, 0, 21_000, None)).expect("the honest one is taken");
    let last = taken_at_last(&chain, &chain.signed(19, 0, CAPPED_GAS, Some(&blake2f(9_800_000))));
    let deadline = Instant::now() + Duration::from_secs(120);
    let (mut early, mut late) = (None, None);
    while (early.is_none() || late.is_none()) && Instant::now() < deadline {
        early = early.or_else(|| chain.block_of(&honest));
        late = late.or_else(|| chain.block_of(&last));
        std::thread::sleep(Duration::from_millis(50));
    }
    let outcome = match (early, late) {
        (Some(early), Some(late)) if early < late => Outcome::Refused(format!(
            "{}; an honest one of block {early} passed those up to {late}",
            refusals.join("; ")
        )),
        other => Outcome::Succeeded(format!("an honest transaction waited for all of it: {other:?}")),
    };
    judge("stall the chain", outcome);
}

/// A heavy transaction, sent until there is room for one.
fn taken_at_last(chain: &Served, raw: &str) -> Value {
    wait_until(60, "room for a heavy transaction", || match chain.send(raw) {
        Err(words) => {
            assert!(NAMED.iter().any(|named| words.contains(named)), "{words}");
            None
        }
        Ok(hash) => Some(hash),
    })
}

/// Whether an honest transaction is kept out, in words.
fn kept_out(chain: &Served) -> String {
    let honest = chain.send(&chain.signed(99, 0, 21_000, None));
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(5) {
        if honest.as_ref().is_ok_and(|hash| chain.block_of(hash).is_some()) {
            return String::new();
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    format!(", and an honest transaction was in no block {} s later", begun.elapsed().as_secs())
}
