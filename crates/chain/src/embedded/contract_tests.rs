//! The contract in the embedded EVM, with a simulated clock and no network, called as this program calls them. The contract's whole behaviour is tested in `contracts/test`.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;

use alloy_primitives::U256;
use ethers::abi::Token as AbiToken;

use super::machine::{Answer, Environment, Machine};
use super::pool::TRANSACTION_GAS;
use super::trie::{EMPTY_ROOT, Nodes};
use super::world::Tries;
use crate::call::{address, artefact, word};
use crate::error::decode_revert;
use crate::model::{Address, Digest, Hash, Identity, PublicKey, Scope, Signature, SignerId, Timestamp, Token};
use crate::transaction::{Transaction, Unsigned, created_address};
use crate::{Call, ChainError, Event};

const ADMIN: Address = Address([0xad; 20]);
/// The delay of a succession, seconds.
const DELAY: u64 = 86_400;
const A: Address = Address([0xa; 20]);
const B: Address = Address([0xb; 20]);
const C: Address = Address([0xc; 20]);

/// The nodes of every state, in memory.
#[derive(Default)]
pub(super) struct Shelf(RefCell<HashMap<Hash, Arc<[u8]>>>);

impl Shelf {
    /// A machine whose state is empty.
    pub(super) fn machine(self: Rc<Self>) -> Machine {
        Machine { tries: Tries { ground: self, root: EMPTY_ROOT }, chain_id: 5 }
    }
}

impl Nodes for Shelf {
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError> {
        self.0.borrow().get(&hash).cloned().ok_or_else(|| self.malformed(hash))
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        ChainError::Internal(format!("{hash} is not here"))
    }
}

/// A chain with the contract on it.
pub(super) struct World {
    shelf: Rc<Shelf>,
    machine: Machine,
    contract: Address,
    nonces: HashMap<Address, u64>,
    /// The context of the next call.
    place: Environment,
    pub(super) gas: u64,
}

fn token(number: u8) -> Token {
    Token([number; 32])
}

fn digest(number: u8) -> Digest {
    Digest([number; 32])
}

pub(super) fn identity(token: Token) -> Identity {
    let signing = PublicKey([1; 64]);
    Identity { token, signing, envelope: PublicKey([2; 64]), proof: Signature([3; 64]) }
}

fn upload(digest: Digest, token: Token) -> Call {
    Call::DataUpload { digest, token, timestamp: Timestamp(7) }
}

pub(super) fn grant(grantee: Address, epoch: u64, expiry: Option<u64>) -> Call {
    let expiry = expiry.map(Timestamp::from_seconds);
    Call::AuthorityGrant { grantee, epoch, expiry, scope: Scope::All, envelope: vec![9; 300] }
}

fn revoke(grantee: Address, new_token: Token) -> Call {
    Call::AuthorityRevoke { grantee, new_token, envelope: Vec::new() }
}

fn wrap(epoch: u64, grantees: &[Address]) -> Call {
    Call::Wrap { epoch, envelopes: grantees.iter().map(|grantee| (*grantee, vec![8; 10])).collect() }
}

fn anchor(root: u8, previous: u8) -> Call {
    Call::Anchor { root: Hash([root; 32]), count: 5, previous: Hash([previous; 32]) }
}

impl World {
    pub(super) fn new(open: bool) -> Self {
        let place = Environment { number: 1, timestamp: 1_000, difficulty: 2, beneficiary: Address([0xee; 20]) };
        let shelf = Rc::new(Shelf::default());
        let machine = Rc::clone(&shelf).machine();
        let contract = created_address(ADMIN, 0);
        let mut world = Self { shelf, machine, contract, nonces: HashMap::new(), place, gas: 0 };
        let code = artefact().expect("artefact").creation(open, DELAY).expect("code");
        world.run(ADMIN, None, 0, code).expect("deploys");
        assert!(world.gas < 6_000_000, "{}", world.gas);
        world
    }

    /// With A, B and C registered under tokens 0xa1, 0xb1, 0xc1.
    fn peopled() -> Self {
        let mut world = Self::new(true);
        for (who, number) in [(A, 0xa1), (B, 0xb1), (C, 0xc1)] {
            world
                .send(who, &Call::Register { identity: identity(token(number)), envelope: Vec::new() })
                .expect("registers");
        }
        world
    }

    fn run(&mut self, sender: Address, to: Option<Address>, value: u64, input: Vec<u8>) -> Result<Vec<Event>, String> {
        let nonce = self.nonces.entry(sender).or_default();
        let terms =
            Unsigned { nonce: *nonce, gas_price: 0, gas_limit: TRANSACTION_GAS, to, value: U256::from(value), input };
        let (zero, hash) = (U256::ZERO, Hash([0; 32]));
        let mut transaction = Transaction { hash, sender, unsigned: terms, v: 0, r: zero, s: zero, raw: Vec::new() };
        transaction.hash.0[..8].copy_from_slice(&nonce.to_be_bytes());
        let mut outcome = self.machine.run(&self.place, vec![transaction], true).expect("runs");
        if let Some((_, refusal)) = outcome.refused.pop() {
            return Err(refusal);
        }
        *nonce += 1;
        let receipt = outcome.receipts[0].clone();
        self.shelf.0.borrow_mut().extend(outcome.written.made.into_iter().map(|(hash, body)| (hash, body.into())));
        self.machine.tries.root = outcome.state_root;
        self.place.number += 1;
        self.gas = receipt.gas_used;
        if !receipt.success {
            return Err(decode_revert(&receipt.output).unwrap_or_else(|| "no reason".into()));
        }
        let topics = |log: &alloy_primitives::Log| log.topics().iter().map(|topic| Hash(topic.0)).collect::<Vec<_>>();
        Ok(receipt.logs.iter().map(|log| Event::decode(&topics(log), &log.data.data).expect("event")).collect())
    }

    pub(super) fn send(&mut self, sender: Address, call: &Call) -> Result<Event, String> {
        let events = self.run(sender, Some(self.contract), 0, call.encode().expect("encodes"));
        events.map(|mut events| events.pop().expect("every change emits an event"))
    }

    fn refused(&mut self, sender: Address, call: &Call, code: &str) {
        assert_eq!(self.send(sender, call), Err(code.to_owned()), "{call:?}");
    }

    fn raw(&mut self, sender: Address, name: &str, arguments: &[AbiToken]) -> Result<Vec<Event>, String> {
        let input = artefact().expect("artefact").encode(name, arguments).expect("encodes");
        self.run(sender, Some(self.contract), 0, input)
    }

    fn view(&self, from: Address, name: &str, arguments: &[AbiToken]) -> Vec<AbiToken> {
        self.read(from, name, arguments).expect("reads")
    }

    fn read(&self, from: Address, name: &str, arguments: &[AbiToken]) -> Result<Vec<AbiToken>, String> {
        let artefact = artefact().expect("artefact");
        let input = artefact.encode(name, arguments).expect("encodes");
        let message = Unsigned { to: Some(self.contract), input, gas_limit: 1_000_000, ..Unsigned::default() };
        match self.machine.call(&self.place, from, &message).expect("runs") {
            Answer::Returned(output, _) => {
                Ok(artefact.function(name).expect("name").decode_output(&output).expect("decodes"))
            }
            Answer::Reverted(output) => Err(decode_revert(&output).expect("a reason")),
            other @ Answer::Failed(_) => panic!("{name}: {other:?}"),
        }
    }

    fn query(&self, from: Address, token: Token, owner: Address) -> (bool, u64, u64) {
        let values = self.view(from, "dataQuery", &[AbiToken::Bytes(token.0.to_vec()), address(owner)]);
        let number = |index: usize| values[index].clone().into_uint().expect("number").as_u64();
        (values[0] == AbiToken::Bool(true), number(1), number(2))
    }
}

#[test]
fn an_account_registers_once_with_a_whole_identity() {
    let mut world = World::new(true);
    let call = Call::Register { identity: identity(token(1)), envelope: Vec::new() };
    let event = world.send(A, &call).expect("registers");
    assert_eq!(event, Event::Registered { owner: A, identity: identity(token(1)), epoch: 1 });
    world.refused(A, &call, "registered");
    world.refused(B, &Call::Register { identity: identity(token(0)), envelope: Vec::new() }, "empty");
    world.send(B, &call).expect("tokens are per owner: nobody can take another's first");
    for length in [0, 223, 225] {
        let refused = world.raw(C, "register", &[vec![1; length], Vec::new()].map(AbiToken::Bytes));
        assert_eq!(refused, Err("length".to_owned()));
    }
}

#[test]
fn a_digest_is_unique_per_owner() {
    let mut world = World::peopled();
    let (owner, timestamp) = (A, Some(Timestamp(7)));
    let event = world.send(A, &upload(digest(1), token(0xa1))).expect("uploads");
    let expected = Event::DataUploaded { owner, digest: digest(1), token: token(0xa1), epoch: 1, number: 1, timestamp };
    assert_eq!(event, expected);
    world.refused(A, &upload(digest(1), token(0xa1)), "digest used");
    world.send(B, &upload(digest(1), token(0xb1))).expect("another owner's digest does not block");
    world.refused(A, &upload(digest(2), token(0xb1)), "token unknown");
    world.refused(A, &upload(digest(2), token(0)), "token unknown");
    assert_eq!(world.query(A, token(0xa1), A), (true, 1, 1));
    for (digest, token, timestamp) in [(31, 32, 8), (33, 32, 8), (32, 31, 8), (32, 32, 33)] {
        let arguments = [digest, token, timestamp].map(|length| AbiToken::Bytes(vec![0xa1; length]));
        assert_eq!(world.raw(A, "dataUpload", &arguments), Err("length".to_owned()));
    }
}

#[test]
fn a_revoke_ends_the_epoch_and_loses_no_record() {
    let mut world = World::peopled();
    world.send(A, &grant(B, 1, None)).expect("grants");
    world.send(A, &grant(C, 1, None)).expect("grants");
    assert_eq!(world.query(B, token(0xa1), A), (true, 1, 0));
    let event = world.send(A, &revoke(B, token(0xa2))).expect("revokes");
    assert_eq!(event, Event::Revoked { owner: A, grantee: B, epoch: 2, token: token(0xa2) });
    assert_eq!(world.query(B, token(0xa1), A), (false, 1, 0));
    assert_eq!(world.query(B, token(0xa2), A), (false, 2, 0));
    assert!(world.query(C, token(0xa2), A).0, "survivors stay authorised");
    world.refused(A, &revoke(B, token(0xa3)), "no grant");
    world.refused(A, &revoke(C, token(0xa1)), "token used");
    let late = world.send(A, &upload(digest(1), token(0xa1))).expect("sealed before the revoke");
    assert!(matches!(late, Event::DataUploaded { epoch: 1, number: 1, .. }));
    world.send(A, &grant(B, 2, None)).expect("may be granted again");
    assert_eq!((world.query(B, token(0xa1), A).0, world.query(B, token(0xa2), A).0), (false, true));
    world.send(A, &wrap(1, &[B])).expect("and given the earlier epoch again");
    assert!(world.query(B, token(0xa1), A).0);
    world.refused(B, &revoke(C, token(0xb2)), "no grant");
}

#[test]
fn a_grant_expires() {
    let mut world = World::peopled();
    world.refused(A, &grant(B, 1, Some(1_000)), "expired");
    world.send(A, &grant(B, 1, Some(1_010))).expect("grants");
    assert!(world.query(B, token(0xa1), A).0);
    world.place.timestamp = 1_009;
    assert!(world.query(B, token(0xa1), A).0);
    world.place.timestamp = 1_010;
    assert!(!world.query(B, token(0xa1), A).0);
    world.send(A, &Call::Rotate { new_token: token(0xa2), envelope: Vec::new() }).expect("rotates");
    world.refused(A, &wrap(2, &[B]), "no grant");
    world.send(A, &revoke(B, token(0xa3))).expect("an expired grant can be revoked");
}

#[test]
fn keys_rotate_within_the_epoch() {
    let mut world = World::peopled();
    let new = Identity { signing: PublicKey([7; 64]), ..identity(token(0xa1)) };
    let event = world.send(A, &Call::RotateKeys { identity: new, envelope: Vec::new() }).expect("rotates keys");
    assert_eq!(event, Event::KeysRotated { owner: A, keys: 2, identity: new, envelope: Vec::new() });
    world.refused(A, &Call::RotateKeys { identity: identity(token(0xa2)), envelope: Vec::new() }, "token unknown");
    let values = world.view(B, "accountOf", &[address(A)]);
    assert_eq!(values[0], AbiToken::Bytes(new.encode()));
    assert_eq!(values[1], AbiToken::Uint(1.into()));
}

#[test]
fn pause_and_suspension_stop_all_but_what_takes_rights_away() {
    for suspension in [false, true] {
        let mut world = World::peopled();
        world.send(A, &grant(B, 1, None)).expect("grants");
        world.send(A, &Call::Lend { device: SignerId([1; 32]), until: None }).expect("lends");
        let (stop, go, code) = if suspension {
            (Call::Suspend { account: A }, Call::Restore { account: A }, "suspended")
        } else {
            (Call::Pause { until: Timestamp::from_seconds(2_000) }, Call::Resume, "paused")
        };
        world.send(ADMIN, &stop).expect("stops");
        world.refused(ADMIN, &stop, if suspension { "unchanged" } else { "gap" });
        for call in [
            upload(digest(1), token(0xa1)),
            grant(C, 1, None),
            wrap(1, &[B]),
            anchor(1, 0),
            Call::Lend { device: SignerId([2; 32]), until: None },
            Call::RotateKeys { identity: identity(token(0xa1)), envelope: Vec::new() },
            Call::Extend { grantee: B, expiry: None },
            Call::NameRecovery { recovery: Some(C) },
        ] {
            world.refused(A, &call, code);
        }
        assert!(world.query(B, token(0xa1), A).0 && world.query(A, token(0xa1), A).0, "reads go on");
        world.send(A, &Call::Recall { device: SignerId([1; 32]) }).expect("recalls");
        world.send(A, &Call::Rotate { new_token: token(0xa2), envelope: Vec::new() }).expect("rotates");
        world.send(A, &revoke(B, token(0xa3))).expect("revokes");
        world.send(ADMIN, &go).expect("goes on");
        world.refused(ADMIN, &go, "unchanged");
        world.send(A, &upload(digest(1), token(0xa1))).expect("uploads again");
    }
}

#[test]
fn closed_registration_takes_whom_the_administrator_admits() {
    let mut world = World::new(false);
    let call = Call::Register { identity: identity(token(1)), envelope: Vec::new() };
    world.refused(A, &call, "closed");
    world.send(ADMIN, &Call::Admit { account: A }).expect("admits");
    world.refused(ADMIN, &Call::Admit { account: A }, "unchanged");
    assert_eq!(world.send(ADMIN, &Call::Dismiss { account: A }), Ok(Event::Dismissed { account: A }));
    world.refused(A, &call, "closed");
    world.send(ADMIN, &Call::Admit { account: A }).expect("admits again");
    world.send(A, &call).expect("registers");
    world.refused(B, &call, "closed");
    world.send(ADMIN, &Call::SetOpen { open: true }).expect("opens");
    world.refused(ADMIN, &Call::SetOpen { open: true }, "unchanged");
    world.send(B, &call).expect("registers");
}

#[test]
fn only_the_administrator_administers_and_hands_over_in_two_steps() {
    let mut world = World::peopled();
    let powers = [
        Call::Admit { account: C },
        Call::SetOpen { open: false },
        Call::Suspend { account: C },
        Call::Restore { account: C },
        Call::Dismiss { account: C },
        Call::Pause { until: Timestamp::from_seconds(1_001) },
        Call::Resume,
        Call::ProposeSuccession { lost: C, successor: B },
        Call::Nominate { account: A },
    ];
    for power in &powers {
        world.refused(A, power, "administrator");
    }
    world.refused(A, &Call::AcceptAdministrator, "nominee");
    world.send(ADMIN, &Call::Nominate { account: A }).expect("nominates");
    world.refused(B, &Call::AcceptAdministrator, "nominee");
    world.refused(A, &Call::Pause { until: Timestamp::from_seconds(1_001) }, "administrator");
    let event = world.send(A, &Call::AcceptAdministrator).expect("accepts");
    assert_eq!(event, Event::AdministratorChanged { previous: ADMIN, administrator: A });
    world.refused(A, &Call::AcceptAdministrator, "nominee");
    world.refused(ADMIN, &Call::Pause { until: Timestamp::from_seconds(1_001) }, "administrator");
    world.send(A, &Call::Pause { until: Timestamp::from_seconds(1_001) }).expect("has the power");
}

#[test]
fn a_succession_waits_and_the_recovery_account_stops_it() {
    let mut world = World::peopled();
    let propose = Call::ProposeSuccession { lost: A, successor: B };
    let (cancel, complete) = (Call::CancelSuccession { lost: A }, Call::CompleteSuccession { lost: A });
    let at = Timestamp::from_seconds;
    let named = world.send(A, &Call::NameRecovery { recovery: Some(C) }).expect("names");
    assert_eq!(named, Event::RecoveryNamed { owner: A, recovery: Some(C), from: at(1_000 + DELAY) });
    world.place.timestamp += DELAY;
    let due = at(1_000 + 2 * DELAY);
    let proposed = Event::SuccessionProposed { lost: A, successor: B, recovery: Some(C), due };
    assert_eq!(world.send(ADMIN, &propose), Ok(proposed));
    world.refused(ADMIN, &propose, "pending");
    world.refused(ADMIN, &complete, "early");
    world.refused(A, &cancel, "recovery");
    assert_eq!(world.send(C, &cancel), Ok(Event::SuccessionCancelled { lost: A, by: C }));
    world.refused(ADMIN, &complete, "no proposal");
    world.send(ADMIN, &propose).expect("again");
    world.place.timestamp += DELAY;
    assert_eq!(world.send(C, &complete), Ok(Event::Succeeded { lost: A, successor: B }));
    world.refused(A, &upload(digest(1), token(0xa1)), "suspended");
    assert_eq!(world.view(C, "successorOf", &[address(A)]), [address(B)]);
    world.send(B, &Call::NameRecovery { recovery: Some(A) }).expect("names");
    let unguarded = world.send(ADMIN, &Call::ProposeSuccession { lost: B, successor: C }).expect("proposes");
    let due = at(1_000 + 4 * DELAY);
    assert_eq!(unguarded, Event::SuccessionProposed { lost: B, successor: C, recovery: None, due });
}

#[test]
fn a_pause_ends_by_itself() {
    let mut world = World::peopled();
    let until = |seconds| Call::Pause { until: Timestamp::from_seconds(seconds) };
    world.refused(ADMIN, &until(1_001 + 3 * DELAY), "pause");
    let event = world.send(ADMIN, &until(1_000 + 3 * DELAY)).expect("pauses");
    assert_eq!(event, Event::PausedUntil { until: Timestamp::from_seconds(1_000 + 3 * DELAY) });
    world.refused(A, &anchor(1, 0), "paused");
    world.place.timestamp += 3 * DELAY;
    world.send(A, &anchor(1, 0)).expect("goes on by itself");
    world.refused(ADMIN, &Call::Resume, "unchanged");
    world.refused(ADMIN, &until(1_001 + 3 * DELAY), "gap");
}

#[test]
fn a_grant_is_extended() {
    let mut world = World::peopled();
    let extend = |end: Option<u64>| Call::Extend { grantee: B, expiry: end.map(Timestamp::from_seconds) };
    world.refused(A, &extend(None), "no grant");
    world.send(A, &grant(B, 1, Some(1_010))).expect("grants");
    world.refused(A, &extend(Some(1_010)), "shorter");
    let expiry = Some(Timestamp::from_seconds(1_020));
    assert_eq!(world.send(A, &extend(Some(1_020))), Ok(Event::Extended { owner: A, grantee: B, expiry }));
    world.place.timestamp = 1_015;
    assert!(world.query(B, token(0xa1), A).0);
    world.place.timestamp = 1_020;
    world.refused(A, &extend(None), "no grant");
}

#[test]
fn anchors_are_chained_per_sender_and_the_earliest_counts() {
    let mut world = World::peopled();
    world.refused(A, &anchor(0, 0), "empty");
    world.refused(A, &Call::Anchor { root: Hash([1; 32]), count: 0, previous: Hash([0; 32]) }, "empty");
    world.refused(A, &anchor(1, 9), "previous");
    world.send(A, &anchor(1, 0)).expect("anchors");
    let first = world.view(B, "anchorOf", &[address(A), word([1; 32])]);
    world.refused(A, &anchor(2, 0), "previous");
    world.send(A, &anchor(2, 1)).expect("anchors");
    assert!(world.gas <= 70_000, "{}", world.gas);
    world.send(A, &anchor(1, 2)).expect("again");
    assert_eq!(world.view(B, "anchorOf", &[address(A), word([1; 32])]), first);
    assert_eq!(world.view(B, "headOf", &[address(A)]), [word([1; 32])]);
    world.send(B, &anchor(1, 0)).expect("another sender has a chain of its own");
}

#[test]
fn devices_are_lent_and_recalled() {
    let mut world = World::peopled();
    let device = SignerId([1; 32]);
    let lend = |until: Option<u64>| Call::Lend { device, until: until.map(Timestamp::from_seconds) };
    world.refused(A, &lend(Some(1_000)), "expired");
    world.refused(A, &Call::Lend { device: SignerId([0; 32]), until: None }, "empty");
    let event = world.send(A, &lend(Some(2_000))).expect("lends");
    assert_eq!(event, Event::Lent { owner: A, device, until: Some(Timestamp::from_seconds(2_000)) });
    world.refused(B, &Call::Recall { device }, "no loan");
    assert_eq!(world.send(A, &Call::Recall { device }), Ok(Event::Recalled { owner: A, device }));
    world.refused(A, &Call::Recall { device }, "no loan");
    assert_eq!(world.send(A, &lend(None)), Ok(Event::Lent { owner: A, device, until: None }));
}

#[test]
fn no_ether_and_no_unknown_call_is_taken() {
    let mut world = World::peopled();
    let contract = Some(world.contract);
    assert!(world.run(A, contract, 0, Vec::new()).is_err());
    assert!(world.run(A, contract, 0, vec![1, 2, 3, 4]).is_err());
    assert!(world.run(A, contract, 1, upload(digest(1), token(0xa1)).encode().expect("encodes")).is_err());
}
