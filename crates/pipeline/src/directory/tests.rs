//! The directory rebuilt from the ledger equals the one built from all events, whatever was undone meanwhile; and what
//! a stranger begins and ends repeatedly leaves nothing in memory.

use proptest::prelude::*;

use super::*;
use crate::crypto::{ProviderName, SmKeyPair, prove, provider};
use crate::model::{Hash, Scope, Signature};
use crate::store::{Ledger, RightEvent, RightKind};

const DOMAIN: Domain = Domain([9; 32]);
const EVERYBODY: [u8; 3] = [1, 2, 3];

fn address(number: u8) -> Address {
    Address([number; 20])
}

fn blank() -> Directory {
    Directory::new(DOMAIN, provider(ProviderName::RustCrypto))
}

/// The state, without the mark of how far it was read.
fn state_of(directory: &Directory) -> State {
    State { applied: None, ..directory.state.read().expect("whole").clone() }
}

/// One act; accounts are numbers.
#[derive(Debug, Clone)]
enum Act {
    Grant(u8, u8, Option<u64>),
    Extend(u8, u8, u64),
    Wrap(u8, u8),
    Revoke(u8, u8),
    Rotate(u8),
    NewKeys(u8),
    Lend(u8, u8),
    Recall(u8, u8),
    Suspend(u8),
    Restore(u8),
    Succeed(u8, u8),
    Name(u8, u8),
    /// This many of the newest blocks are replaced.
    Replace(u64),
}

fn act() -> impl Strategy<Value = Act> {
    let one = || prop::sample::select(EVERYBODY.to_vec());
    let two = || prop::sample::select(vec![(1, 2), (1, 3), (2, 1), (2, 3), (3, 1)]);
    prop_oneof![
        4 => (two(), prop::option::of(1..90u64)).prop_map(|((owner, grantee), end)| Act::Grant(owner, grantee, end)),
        2 => (two(), 100..200u64).prop_map(|((owner, grantee), end)| Act::Extend(owner, grantee, end)),
        3 => two().prop_map(|(owner, grantee)| Act::Wrap(owner, grantee)),
        3 => two().prop_map(|(owner, grantee)| Act::Revoke(owner, grantee)),
        2 => one().prop_map(Act::Rotate),
        1 => one().prop_map(Act::NewKeys),
        1 => (one(), 1..4u8).prop_map(|(owner, device)| Act::Lend(owner, device)),
        1 => (one(), 1..4u8).prop_map(|(owner, device)| Act::Recall(owner, device)),
        1 => one().prop_map(Act::Suspend),
        1 => one().prop_map(Act::Restore),
        1 => two().prop_map(|(lost, successor)| Act::Succeed(lost, successor)),
        1 => two().prop_map(|(owner, recovery)| Act::Name(owner, recovery)),
        2 => (1..6u64).prop_map(Act::Replace),
    ]
}

/// A grant in the simple model.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Plain {
    terms: GrantTerms,
    block: u64,
    expiry: Option<Timestamp>,
    revoked: Option<u64>,
    envelopes: Vec<(u64, Vec<u8>)>,
}

/// The chain in the simple model: all its events, and their meaning.
#[derive(Default)]
struct Story {
    events: Vec<EventAt>,
    block: u64,
    made: u64,
}

impl Story {
    fn epoch(&self, owner: Address) -> u64 {
        let begun = |at: &&EventAt| match &at.event {
            Event::Revoked { owner: other, .. } | Event::Rotated { owner: other, .. } => *other == owner,
            _ => false,
        };
        1 + u64::try_from(self.events.iter().filter(begun).count()).expect("few")
    }

    fn token(&mut self) -> Token {
        Token(self.fresh().try_into().expect("32 bytes"))
    }

    /// Bytes never used before.
    fn fresh(&mut self) -> Vec<u8> {
        self.made += 1;
        [self.made.to_be_bytes(); 4].concat()
    }

    fn grants(&self) -> Vec<Plain> {
        let mut all: Vec<Plain> = Vec::new();
        for at in &self.events {
            let between = |owner: &Address, grantee: &Address| {
                let (owner, grantee) = (*owner, *grantee);
                move |one: &Plain| one.revoked.is_none() && one.terms.owner == owner && one.terms.grantee == grantee
            };
            match &at.event {
                Event::Granted { terms, envelope } => {
                    let same = between(&terms.owner, &terms.grantee);
                    let before = all.iter().position(same).map(|place| all.remove(place).envelopes);
                    let mut envelopes = before.unwrap_or_default();
                    envelopes.push((terms.epoch, envelope.clone()));
                    let (terms, expiry) = (terms.clone(), terms.expiry);
                    all.push(Plain { terms, block: at.block, expiry, revoked: None, envelopes });
                }
                Event::Extended { owner, grantee, expiry } => {
                    let same = between(owner, grantee);
                    all.iter_mut().filter(|one| same(one)).for_each(|one| one.expiry = *expiry);
                }
                Event::Wrapped { owner, grantee, epoch, envelope } => {
                    let same = between(owner, grantee);
                    all.iter_mut().filter(|one| same(one)).for_each(|one| {
                        one.envelopes.push((*epoch, envelope.clone()));
                    });
                }
                Event::Revoked { owner, grantee, epoch, .. } => {
                    let same = between(owner, grantee);
                    all.iter_mut().filter(|one| same(one)).for_each(|one| one.revoked = Some(*epoch));
                }
                _ => {}
            }
        }
        all
    }

    /// The contract's event for an act; `None` if it would refuse.
    fn event(&mut self, act: &Act) -> Option<Event> {
        let stands = |story: &Self, owner: u8, grantee: u8| {
            let pair = (address(owner), address(grantee));
            story.grants().iter().any(|one| one.revoked.is_none() && (one.terms.owner, one.terms.grantee) == pair)
        };
        let device = |number: &u8| SignerId([*number; 32]);
        Some(match act {
            Act::Grant(owner, grantee, end) => {
                let (owner, grantee) = (address(*owner), address(*grantee));
                let (epoch, expiry) = (self.epoch(owner), end.map(Timestamp::from_seconds));
                let terms = GrantTerms { owner, grantee, epoch, expiry, scope: Scope::All };
                Event::Granted { terms, envelope: self.fresh() }
            }
            Act::Extend(owner, grantee, end) if stands(self, *owner, *grantee) => {
                let expiry = Some(Timestamp::from_seconds(*end));
                Event::Extended { owner: address(*owner), grantee: address(*grantee), expiry }
            }
            Act::Wrap(owner, grantee) if stands(self, *owner, *grantee) => {
                let (owner, grantee) = (address(*owner), address(*grantee));
                Event::Wrapped { owner, grantee, epoch: self.epoch(owner), envelope: self.fresh() }
            }
            Act::Revoke(owner, grantee) if stands(self, *owner, *grantee) => {
                let (owner, grantee) = (address(*owner), address(*grantee));
                Event::Revoked { owner, grantee, epoch: self.epoch(owner) + 1, token: self.token() }
            }
            Act::Extend(..) | Act::Wrap(..) | Act::Revoke(..) | Act::Replace(_) => return None,
            Act::Rotate(owner) => {
                let owner = address(*owner);
                Event::Rotated { owner, epoch: self.epoch(owner) + 1, token: self.token() }
            }
            Act::NewKeys(owner) => {
                let signing = PublicKey([u8::try_from(self.made % 250).expect("small"); 64]);
                let token = self.token();
                let identity = Identity { token, signing, envelope: signing, proof: Signature([1; 64]) };
                Event::KeysRotated { owner: address(*owner), keys: 2, identity, envelope: Vec::new() }
            }
            Act::Lend(owner, number) => Event::Lent { owner: address(*owner), device: device(number), until: None },
            Act::Recall(owner, number) => Event::Recalled { owner: address(*owner), device: device(number) },
            Act::Suspend(account) => Event::Suspended { account: address(*account) },
            Act::Restore(account) => Event::Restored { account: address(*account) },
            Act::Succeed(lost, successor) => Event::Succeeded { lost: address(*lost), successor: address(*successor) },
            Act::Name(owner, recovery) => Event::RecoveryNamed {
                owner: address(*owner),
                recovery: Some(address(*recovery)),
                from: Timestamp::from_seconds(self.block * 10),
            },
        })
    }

    fn tell(&mut self, event: Event, in_new_block: bool) -> EventAt {
        self.block += u64::from(in_new_block || self.block == 0);
        self.made += 1;
        let mut hash = [0; 32];
        hash[..8].copy_from_slice(&self.made.to_be_bytes());
        let log_index = u64::try_from(self.events.len()).expect("few");
        let (block, block_hash, transaction) = (self.block, Hash(hash), Hash(hash));
        let at = EventAt { block, block_hash, timestamp: None, transaction, log_index, event };
        self.events.push(at.clone());
        at
    }
}

/// A directory with its ledger, beside the simple model.
struct Pair {
    story: Story,
    directory: Directory,
    ledger: Ledger,
    _home: tempfile::TempDir,
}

impl Pair {
    fn new() -> Self {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        ledger.rights.bind_contract(DOMAIN, "{}").expect("bound");
        let mut pair = Self { story: Story::default(), directory: blank(), ledger, _home: home };
        let provider = provider(ProviderName::RustCrypto);
        let [keys, sealing] = [(); 2].map(|()| SmKeyPair::generate(provider).expect("a pair"));
        let owner = address(1);
        let token = pair.story.token();
        let identity = prove(provider, &DOMAIN, &owner, &keys, &sealing.public, token).expect("proves");
        pair.tell(vec![(Event::Registered { owner, identity, epoch: 1 }, true)]);
        assert!(pair.directory.identity(owner).is_ok_and(|identity| identity.proven));
        pair
    }

    fn tell(&mut self, events: Vec<(Event, bool)>) {
        let told: Vec<Told> = events
            .into_iter()
            .filter_map(|(event, in_new_block)| self.directory.judge(&self.story.tell(event, in_new_block)))
            .collect();
        for one in &told {
            assert!(self.directory.take(one), "new");
            assert!(!self.directory.take(one), "twice is once");
        }
        kept::keep(&self.ledger.rights, &told).expect("kept");
        kept::keep(&self.ledger.rights, &told).expect("twice is once");
    }

    fn replace(&mut self, blocks: u64) {
        self.story.block = self.story.block.saturating_sub(blocks).max(1);
        let last = self.story.block;
        self.story.events.retain(|at| at.block <= last);
        self.ledger.rights.take_back_rights(last + 1).expect("undone");
        self.directory = self.read_back();
    }

    fn read_back(&self) -> Directory {
        let directory = blank();
        assert!(kept::read_back(&self.ledger.rights, &directory).expect("read"), "kept");
        directory
    }

    fn compare(&self) {
        let whole = blank();
        assert!(self.story.events.iter().all(|at| whole.apply(at)));
        assert_eq!(state_of(&self.directory), state_of(&whole));
        assert_eq!(state_of(&self.read_back()), state_of(&whole));
        let plain = self.story.grants();
        for account in EVERYBODY.map(address) {
            let mine = plain.iter().filter(|one| one.terms.owner == account || one.terms.grantee == account);
            let found = kept::history(&self.ledger.rights, &self.directory, account).expect("history");
            let found: Vec<Plain> = found.iter().map(|grant| self.plain(grant)).collect();
            let mine: Vec<Plain> = mine.cloned().map(shown).collect();
            assert_eq!(found, mine);
        }
        for at in &self.story.events {
            if let Event::Revoked { owner, epoch, token, .. } | Event::Rotated { owner, epoch, token } = &at.event {
                assert_eq!(kept::token(&self.ledger.rights, &self.directory, *owner, *epoch), Ok(Some(*token)));
                assert_eq!(kept::has_token(&self.ledger.rights, &self.directory, *owner, *token), Ok(true));
            }
        }
        assert_eq!(kept::has_token(&self.ledger.rights, &self.directory, address(1), Token([0xee; 32])), Ok(false));
    }

    fn plain(&self, grant: &Granted) -> Plain {
        let envelopes = kept::envelopes(&self.ledger.rights, grant).expect("envelopes");
        Plain {
            terms: grant.terms.clone(),
            block: grant.block,
            expiry: grant.expiry(),
            revoked: grant.revoked,
            envelopes: envelopes.into_iter().map(|one| (one.epoch, one.bytes)).collect(),
        }
    }
}

/// With the envelopes returned: for each epoch the newest and the first, the newest epoch first.
fn shown(mut one: Plain) -> Plain {
    let mut epochs: Vec<u64> = one.envelopes.iter().map(|(epoch, _)| *epoch).collect();
    epochs.sort_unstable();
    epochs.dedup();
    let mut given = Vec::new();
    for epoch in epochs.into_iter().rev() {
        let same: Vec<_> = one.envelopes.iter().filter(|(other, _)| *other == epoch).cloned().collect();
        given.extend(same.last().cloned());
        given.extend(same.first().filter(|_| same.len() > 1).cloned());
    }
    one.envelopes = given;
    one
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn what_the_ledger_gives_back_is_what_all_events_make(acts in prop::collection::vec((act(), any::<bool>()), 1..50)) {
        let mut pair = Pair::new();
        // Nothing is added to a block that was already read.
        let mut replaced = false;
        for (number, (act, in_new_block)) in acts.into_iter().enumerate() {
            if let Act::Replace(blocks) = act {
                pair.replace(blocks);
                replaced = true;
            } else if let Some(event) = pair.story.event(&act) {
                pair.tell(vec![(event, in_new_block || replaced)]);
                replaced = false;
            }
            if number % 10 == 0 {
                pair.compare();
            }
        }
        pair.compare();
    }
}

/// How many entries are in memory, of every kind.
fn held(directory: &Directory) -> usize {
    let state = state_of(directory);
    let of_accounts = |account: &Account| account.identities.len() + account.devices.len() + account.suspensions.len();
    state.accounts.len()
        + state.accounts.values().map(of_accounts).sum::<usize>()
        + state.grants.values().map(Granted::held).sum::<usize>()
        + state.received.len()
        + state.open_loans.len()
}

#[test]
fn six_thousand_grants_and_revocations_of_a_stranger_leave_nothing_in_memory() {
    let mut pair = Pair::new();
    pair.tell(vec![(granted(2, 3, 1), true)]);
    let before = held(&pair.directory);
    let mut sizes = std::collections::BTreeSet::new();
    for round in 0..6_000u64 {
        let (owner, grantee) = (address(7), address(8));
        let token = pair.story.token();
        let events =
            vec![(granted(7, 8, round + 1), true), (Event::Revoked { owner, grantee, epoch: round + 2, token }, true)];
        // The simple model would be slow for this number; only memory matters here.
        for (event, in_new_block) in events {
            let at = pair.story.tell(event, in_new_block);
            assert!(pair.directory.apply(&at));
        }
        sizes.insert(held(&pair.directory) - before);
    }
    assert_eq!(sizes, [1].into(), "the stranger's account alone");
    assert_eq!(pair.directory.epoch(address(7)), 6_001);
    // The same with one grant that continues: the envelopes of all its epochs are in the ledger.
    pair.directory.apply(&pair.story.tell(granted(7, 8, 6_001), true));
    for round in 0..6_000u64 {
        let (owner, grantee, epoch, token) = (address(7), address(8), 6_002 + round, pair.story.token());
        let envelope = vec![1; 1_300];
        pair.directory.apply(&pair.story.tell(Event::Rotated { owner, epoch, token }, true));
        pair.directory.apply(&pair.story.tell(Event::Wrapped { owner, grantee, epoch, envelope }, true));
    }
    assert!(held(&pair.directory) - before <= 12, "{}", held(&pair.directory) - before);
}

fn granted(owner: u8, grantee: u8, epoch: u64) -> Event {
    let (owner, grantee) = (address(owner), address(grantee));
    let terms = GrantTerms { owner, grantee, epoch, expiry: None, scope: Scope::All };
    Event::Granted { terms, envelope: vec![1; 1_300] }
}

#[test]
fn what_is_damaged_among_the_rights_is_an_error_and_not_nothing() {
    let home = tempfile::tempdir().expect("a folder");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
    let row = |place, kind| RightEvent {
        block: 5,
        place,
        kind,
        owner: Some(address(1)),
        grantee: None,
        epoch: None,
        token: None,
        event: "{\"transaction\":".to_owned(),
        envelope: None,
    };
    ledger.rights.keep_rights(vec![row(0, RightKind::Other)]).expect("kept");
    let damaged = [
        kept::read_back(&ledger.rights, &blank()).map(drop),
        kept::identity(&ledger.rights, address(1), 1).map(drop),
        kept::handed_over(&ledger.rights, address(1)).map(drop),
    ];
    for found in damaged {
        let error = found.expect_err("damaged").to_string();
        assert!(error.contains("ledger.db") && error.contains("the event 0 of block 5"), "{error}");
    }
}
