//! The contract in the EVM against the plain Rust model of it, on random sequences of calls: every one must
//! give the same refusal or the same events, and leave the same state to read.

mod steps;

use std::collections::BTreeMap;

use ethers::abi::{RawLog, Token as AbiToken};
use ethers::types::H256;
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

use self::steps::{Administration, Move, Pick, Step, sequence};
use super::contract_model::{Caller, Emitted, Model, Reason};
use super::contract_tests::{ADMIN, World};
use crate::chain::Call;
use crate::chain::artefact::artefact;
use crate::chain::call::{address, word};
use crate::model::{Address, Digest, Hash, Identity, PublicKey, Scope, Signature, SignerId, Timestamp, Token, TopicId};

/// Who calls and is called about; the last never registers in the opening.
const PEOPLE: [Address; 6] =
    [Address([0xa; 20]), Address([0xb; 20]), Address([0xc; 20]), Address([0xd; 20]), ADMIN, Address([0xff; 20])];
/// Digests, roots, devices and reused tokens are words of one repeated byte below this.
const WORDS: u8 = 5;
/// Fresh tokens begin here.
const FRESH: u8 = 100;
/// What a sequence must be able to reach: every function and every reason code of the contract.
const REACHED: &str = "register rotateKeys rotate dataUpload anchor authorityGrant wrap authorityRevoke lend recall admit \
    setOpen suspend restore setPaused succeed nominate acceptAdministrator administrator closed empty envelope epoch \
    expired grantee length nominee paused previous registered scope self succeeded successor suspended unchanged unregistered wrapped";
/// Reason codes of two words.
const REACHED_TOO: [&str; 5] = ["digest used", "no grant", "no loan", "token unknown", "token used"];

fn identity(token: [u8; 32], key: u8) -> Identity {
    let envelope = PublicKey([key.wrapping_add(1); 64]);
    Identity { token: Token(token), signing: PublicKey([key; 64]), envelope, proof: Signature([3; 64]) }
}

/// The contract and its model, side by side.
struct Both {
    world: World,
    model: Model,
    fresh: u8,
    /// How often each function took effect and each refusal came.
    seen: BTreeMap<String, usize>,
}

impl Both {
    fn new(open: bool) -> Self {
        Self { world: World::new(open), model: Model::new(ADMIN, open), fresh: FRESH, seen: BTreeMap::new() }
    }

    fn caller(&self, sender: Address) -> Caller {
        Caller { sender, block: self.world.place.number, now: self.world.place.timestamp }
    }

    fn pick(&mut self, who: Address, pick: Pick) -> [u8; 32] {
        match pick {
            Pick::Current => self.model.token(who),
            Pick::Word(byte) => [byte; 32],
            Pick::Fresh => {
                self.fresh += 1;
                [self.fresh; 32]
            }
        }
    }

    fn end(&self, ends: Option<u64>) -> u64 {
        ends.map_or(0, |seconds| self.world.place.timestamp + seconds)
    }

    fn act(&mut self, (who, fits, step): &Move) -> Result<(), TestCaseError> {
        let sender = match step {
            Step::Administer { .. } if *fits => self.model.administrator,
            Step::Accept if *fits && self.model.nominee != Address([0; 20]) => self.model.nominee,
            _ => PEOPLE[*who],
        };
        if let Step::Wait(seconds) = step {
            self.world.place.timestamp += seconds;
            return Ok(());
        }
        let step = if *fits { self.fitted(sender, step) } else { step.clone() };
        let (name, arguments) = self.message(sender, &step);
        self.compare(sender, name, &arguments)
    }

    /// The step about someone or something that it can take effect on, where there is one.
    fn fitted(&self, sender: Address, step: &Step) -> Step {
        let holders = self.model.holders(sender);
        let holder =
            |index: usize| PEOPLE.iter().position(|person| Some(person) == holders.get(index % holders.len().max(1)));
        match step {
            Step::Revoke { from, token } => Step::Revoke { from: holder(*from).unwrap_or(*from), token: *token },
            Step::Wrap { to, back, envelopes } if to.len() < 4 => {
                let to: Vec<usize> = to.iter().map(|one| holder(*one).unwrap_or(*one)).collect();
                let envelopes = to.iter().zip(envelopes.iter().cycle()).map(|(_, length)| *length).collect();
                Step::Wrap { to, back: *back, envelopes }
            }
            Step::Recall { device } => Step::Recall { device: self.model.lent(sender).unwrap_or(*device) },
            Step::Administer { act: Administration::SetPaused, whom, other, yes } => {
                let yes = *yes && !self.model.paused;
                Step::Administer { act: Administration::SetPaused, whom: *whom, other: *other, yes }
            }
            other => other.clone(),
        }
    }

    fn epoch(&self, sender: Address, back: u64) -> u64 {
        (self.model.epoch(sender) + 1).saturating_sub(back)
    }

    /// Name and arguments of a step: through [`Call`] where that can say it, else as the ABI alone lets it through.
    fn message(&mut self, sender: Address, step: &Step) -> (&'static str, Vec<AbiToken>) {
        match step {
            Step::Register { token, length } => ("register", self.identity(sender, *token, 1, *length)),
            Step::RotateKeys { token, key, length } => ("rotateKeys", self.identity(sender, *token, *key, *length)),
            Step::Upload { digest, token, lengths } => self.upload(sender, *digest, *token, *lengths),
            Step::Grant { to, back, ends, topics, envelope } => {
                let epoch = self.epoch(sender, *back);
                grant(PEOPLE[*to], epoch, self.end(*ends), *topics, *envelope)
            }
            Step::Wrap { to, back, envelopes } => wrap(to, self.epoch(sender, *back), envelopes),
            Step::Revoke { from, token } => {
                let new_token = Token(self.pick(sender, *token));
                encoded(&Call::AuthorityRevoke { grantee: PEOPLE[*from], new_token })
            }
            Step::Rotate { token } => encoded(&Call::Rotate { new_token: Token(self.pick(sender, *token)) }),
            Step::Anchor { root, count, previous } => {
                let previous = previous.map_or_else(|| self.model.head(sender), |byte| [byte; 32]);
                encoded(&Call::Anchor { root: Hash([*root; 32]), count: *count, previous: Hash(previous) })
            }
            Step::Lend { device, ends } => {
                let until = Some(self.end(*ends)).filter(|end| *end != 0).map(Timestamp::from_seconds);
                encoded(&Call::Lend { device: SignerId([*device; 32]), until })
            }
            Step::Recall { device } => encoded(&Call::Recall { device: SignerId([*device; 32]) }),
            Step::Administer { act, whom, other, yes } => encoded(&administer(*act, *whom, *other, *yes)),
            Step::Accept => encoded(&Call::AcceptAdministrator),
            Step::Wait(_) => unreachable!("is no call"),
        }
    }

    fn identity(&mut self, sender: Address, token: Pick, key: u8, length: usize) -> Vec<AbiToken> {
        let identity = identity(self.pick(sender, token), key);
        let mut bytes = identity.encode();
        bytes.resize(length, 7);
        vec![AbiToken::Bytes(bytes)]
    }

    fn upload(
        &mut self,
        sender: Address,
        digest: u8,
        token: Pick,
        lengths: [usize; 3],
    ) -> (&'static str, Vec<AbiToken>) {
        let token = self.pick(sender, token);
        if lengths == [32, 32, 8] {
            let timestamp = Timestamp(self.world.place.timestamp);
            return encoded(&Call::DataUpload { digest: Digest([digest; 32]), token: Token(token), timestamp });
        }
        let fields =
            [vec![digest; lengths[0]], token.iter().copied().cycle().take(lengths[1]).collect(), vec![9; lengths[2]]];
        ("dataUpload", fields.into_iter().map(AbiToken::Bytes).collect())
    }

    /// Makes one call in both.
    fn compare(&mut self, sender: Address, name: &'static str, arguments: &[AbiToken]) -> Result<(), TestCaseError> {
        let expected = self.model.call(self.caller(sender), name, arguments);
        let found = self.world.raw(sender, name, arguments);
        let place = format!("{name} by {sender} with {arguments:?}");
        match (&found, &expected) {
            (Ok(_), Ok(events)) => prop_assert_eq!(&self.emitted(), events, "{}", place),
            (Err(found), Err(expected)) => prop_assert_eq!(found, expected, "{}", place),
            _ => prop_assert!(false, "{place}: the contract says {found:?}, the model {expected:?}"),
        }
        let what = expected.err().unwrap_or(name);
        *self.seen.entry(what.to_owned()).or_default() += 1;
        self.same_read(sender, "accountOf", &[address(sender)])
    }

    /// The last call's events with every field that they have on the chain.
    fn emitted(&self) -> Vec<Emitted> {
        let abi = &artefact().expect("artefact").abi;
        let logs = self.world.logs.iter().map(|log| {
            let event = abi.events().find(|event| event.signature().0 == log.topics[0].0).expect("known");
            let topics = log.topics.iter().map(|topic| H256(topic.0)).collect();
            let parsed = event.parse_log(RawLog { topics, data: log.data.clone() }).expect("parses");
            Emitted(&event.name, parsed.params.into_iter().map(|parameter| parameter.value).collect())
        });
        logs.collect()
    }

    fn same_read(&self, from: Address, name: &str, arguments: &[AbiToken]) -> Result<(), TestCaseError> {
        let expected = self.model.read(self.caller(from), name, arguments);
        let found = self.world.read(from, name, arguments);
        prop_assert_eq!(found, expected.map_err(|reason: Reason| reason.to_owned()), "{} with {:?}", name, arguments);
        Ok(())
    }

    /// Every view, of everything that a sequence can name.
    fn same_state(&self) -> Result<(), TestCaseError> {
        for name in ["administrator", "nominee", "open", "paused"] {
            self.same_read(ADMIN, name, &[])?;
        }
        for who in PEOPLE {
            for name in ["admitted", "successorOf", "headOf", "accountOf"] {
                self.same_read(ADMIN, name, &[address(who)])?;
            }
            for byte in 0..WORDS {
                for name in ["uploadedAt", "anchorOf", "loanOf"] {
                    self.same_read(ADMIN, name, &[address(who), word([byte; 32])])?;
                }
            }
            for byte in (0..WORDS).chain(FRESH..=self.fresh) {
                self.same_read(ADMIN, "epochOf", &[address(who), word([byte; 32])])?;
            }
            for other in PEOPLE {
                self.same_relation(who, other)?;
            }
        }
        Ok(())
    }

    fn same_relation(&self, owner: Address, reader: Address) -> Result<(), TestCaseError> {
        self.same_read(ADMIN, "grantOf", &[address(owner), address(reader)])?;
        for epoch in 0..=self.model.epoch(owner) {
            self.same_read(ADMIN, "envelopeOf", &[address(owner), address(reader), AbiToken::Uint(epoch.into())])?;
        }
        for token in [self.model.token(owner), [1; 32], [2; 32], [FRESH + 1; 32]] {
            self.same_read(reader, "dataQuery", &[AbiToken::Bytes(token.to_vec()), address(owner)])?;
        }
        self.same_read(reader, "dataQuery", &[AbiToken::Bytes(vec![1; 31]), address(owner)])
    }
}

/// As the contract gets a call that this program makes.
fn encoded(call: &Call) -> (&'static str, Vec<AbiToken>) {
    let data = call.encode().expect("encodes");
    let function = artefact().expect("artefact").function(call.name()).expect("name");
    (call.name(), function.decode_input(&data[4..]).expect("decodes"))
}

fn topic(number: usize) -> TopicId {
    TopicId([u8::try_from(number).expect("few"); 16])
}

fn grant(grantee: Address, epoch: u64, end: u64, topics: usize, envelope: usize) -> (&'static str, Vec<AbiToken>) {
    let ids: Vec<TopicId> = (0..topics).map(topic).collect();
    if topics <= 32 && (1..=4096).contains(&envelope) {
        let scope = if ids.is_empty() { Scope::All } else { Scope::Topics(ids) };
        let expiry = (end != 0).then(|| Timestamp::from_seconds(end));
        return encoded(&Call::AuthorityGrant { grantee, epoch, expiry, scope, envelope: vec![4; envelope] });
    }
    let ids = ids.iter().map(|id| AbiToken::FixedBytes(id.0.to_vec())).collect();
    let numbers = [epoch, end].map(|value| AbiToken::Uint(value.into()));
    let rest = [AbiToken::Array(ids), AbiToken::Bytes(vec![4; envelope])];
    ("authorityGrant", [address(grantee)].into_iter().chain(numbers).chain(rest).collect())
}

fn wrap(to: &[usize], epoch: u64, envelopes: &[usize]) -> (&'static str, Vec<AbiToken>) {
    let grantees: Vec<Address> = to.iter().map(|place| PEOPLE[*place]).collect();
    let texts: Vec<Vec<u8>> = envelopes.iter().map(|length| vec![5; *length]).collect();
    let sayable = texts.iter().all(|text| (1..=4096).contains(&text.len()));
    if sayable && grantees.len() == texts.len() && (1..=32).contains(&texts.len()) {
        return encoded(&Call::Wrap { epoch, envelopes: grantees.into_iter().zip(texts).collect() });
    }
    let grantees = AbiToken::Array(grantees.into_iter().map(address).collect());
    let texts = AbiToken::Array(texts.into_iter().map(AbiToken::Bytes).collect());
    ("wrap", vec![grantees, AbiToken::Uint(epoch.into()), texts])
}

fn administer(act: Administration, whom: usize, other: usize, yes: bool) -> Call {
    let account = PEOPLE[whom];
    match act {
        Administration::Admit => Call::Admit { account },
        Administration::SetOpen => Call::SetOpen { open: yes },
        Administration::Suspend => Call::Suspend { account },
        Administration::Restore => Call::Restore { account },
        Administration::SetPaused => Call::SetPaused { paused: yes },
        Administration::Succeed => Call::Succeed { lost: account, successor: PEOPLE[other] },
        Administration::Nominate => Call::Nominate { account },
    }
}

/// Plays a sequence in both and compares every step, and the whole state every ten.
fn play(open: bool, registered: usize, moves: &[Move]) -> Result<BTreeMap<String, usize>, TestCaseError> {
    let mut both = Both::new(open);
    let first = (0..registered).map(|who| (who, false, Step::Register { token: Pick::Word(1), length: 224 }));
    for (count, one) in first.collect::<Vec<_>>().iter().chain(moves).enumerate() {
        both.act(one)?;
        if count % 10 == 9 {
            both.same_state()?;
        }
    }
    both.same_state()?;
    Ok(both.seen)
}

fn cases() -> u32 {
    if std::env::var_os("AUTHROS_LONG").is_some() { 5000 } else { 96 }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(cases()))]

    #[test]
    fn the_contract_and_its_model_cannot_be_told_apart((open, registered, moves) in sequence()) {
        play(open, registered, &moves)?;
    }
}

/// Always the same sequences, so that what they reach can be counted.
#[test]
fn the_sequences_reach_every_function_and_every_refusal() {
    let config = ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(64) };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let reached = std::cell::RefCell::new(BTreeMap::<String, usize>::new());
    let result = runner.run(&sequence(), |(open, registered, moves)| {
        for (what, times) in play(open, registered, &moves)? {
            *reached.borrow_mut().entry(what).or_default() += times;
        }
        Ok(())
    });
    result.expect("the same in both");
    let reached = reached.into_inner();
    for what in REACHED.split_whitespace().chain(REACHED_TOO) {
        assert!(reached.contains_key(what), "{what} was never reached: {reached:?}");
    }
}
