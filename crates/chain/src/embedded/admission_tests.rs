//! What anyone may send, and how long a block of the worst of it takes.

use std::rc::Rc;
use std::time::Instant;

use super::contract_tests::{Shelf, World, grant, identity};
use super::machine::Environment;
use super::payloads::Payload;
use super::pool::{BLOCK_GAS, TOO_MUCH_WORK, TRANSACTION_GAS};
use crate::Call;
use crate::model::{Address, Token};

fn place() -> Environment {
    Environment { number: 1, timestamp: 1_000, difficulty: 2, beneficiary: Address([0xee; 20]) }
}

#[test]
fn work_that_its_gas_does_not_pay_is_refused_and_run_again_where_it_is_in_the_file() {
    let machine = Rc::new(Shelf::default()).machine();
    let transactions = || vec![Payload::long_exponent().transaction(Address([1; 20]), 0, 1_000_000)];
    let outcome = machine.run(&place(), transactions(), true).expect("runs");
    assert!(outcome.included.is_empty());
    assert!(outcome.refused[0].1.contains(TOO_MUCH_WORK), "{}", outcome.refused[0].1);
    let again = machine.run(&place(), transactions(), false).expect("runs");
    assert_eq!((again.included.len(), again.refused.len()), (1, 0));
    // The sum over a block is bounded too: what comes after the limit waits, neither taken nor refused.
    let short = Payload::modexp(1, 600, 1, 0xff);
    let many = (0..60).map(|sender| short.transaction(Address([sender + 1; 20]), 0, 100_000)).collect();
    let outcome = machine.run(&place(), many, true).expect("runs");
    assert!(outcome.refused.is_empty() && (1..60).contains(&outcome.included.len()), "{}", outcome.included.len());
}

/// The largest contract calls that fit into a transaction, and its deployment, are within the caps.
#[test]
fn the_contract_fits() {
    let mut world = World::new(true);
    assert!(world.gas < TRANSACTION_GAS * 4 / 5, "deployment: {}", world.gas);
    let owner = Address([0xa0; 20]);
    let people: Vec<Address> = (1..=32).map(|number| Address([number; 20])).collect();
    for who in people.iter().chain([&owner]) {
        world
            .send(*who, &Call::Register { identity: identity(Token([who.0[0]; 32])), envelope: Vec::new() })
            .expect("registers");
    }
    for grantee in &people {
        world.send(owner, &grant(*grantee, 1, None)).expect("grants");
    }
    world.send(owner, &Call::Rotate { new_token: Token([0xf0; 32]), envelope: Vec::new() }).expect("rotates");
    let envelopes = people.iter().map(|grantee| (*grantee, vec![0xff; 3_800])).collect();
    world.send(owner, &Call::Wrap { epoch: 2, envelopes }).expect("wraps");
    assert!(world.gas < TRANSACTION_GAS * 4 / 5, "32 envelopes: {}", world.gas);
}

/// Prints the time of a whole block of each payload: `cargo test --lib worst_block -- --ignored --nocapture`.
#[test]
#[allow(clippy::print_stdout, clippy::cast_precision_loss, reason = "a measurement")]
fn worst_block() {
    if std::env::var_os("AUTHROS_LONG").is_none() {
        return; // It measures for minutes: `tests/run --long`.
    }
    let machine = Rc::new(Shelf::default()).machine();
    for payload in Payload::all() {
        let senders = 0..u8::try_from(BLOCK_GAS / TRANSACTION_GAS).expect("few");
        let block = senders.map(|sender| payload.transaction(Address([sender + 1; 20]), 0, TRANSACTION_GAS)).collect();
        let begun = Instant::now();
        let outcome = machine.run(&place(), block, true).expect("runs");
        let took = begun.elapsed();
        let used: u64 = outcome.receipts.iter().map(|receipt| receipt.gas_used).sum();
        let (taken, refused) = (outcome.included.len(), outcome.refused.len());
        let pace = took.as_nanos() as f64 / used.max(1) as f64;
        println!(
            "{:>8.1} ms  {pace:>8.1} ns/gas  {taken} taken, {refused} refused  {}",
            took.as_secs_f64() * 1e3,
            payload.name
        );
    }
}
