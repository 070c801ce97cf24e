//! Rights given and taken by the chain's events, block by block.

use super::*;
use crate::chain::{BlockRef, Event, EventAt};
use crate::crypto::{ProviderName, SmKeyPair, prove, provider, signer_id};
use crate::model::{Address, Domain, GrantTerms, Hash, Scope, SignerId, Timestamp, Token, TopicId};
use crate::pipeline::directory::Directory;

const OWNER: Address = Address([1; 20]);
const READER: Address = Address([2; 20]);
const DEVICE: SignerId = SignerId([7; 32]);
const DOMAIN: Domain = Domain([9; 32]);

/// A chain of events invented by a test.
struct Told {
    directory: Directory,
    next: u64,
}

impl Told {
    fn new() -> Self {
        Self { directory: Directory::new(DOMAIN, provider(ProviderName::RustCrypto)), next: 0 }
    }

    fn tell(&mut self, block: u64, event: Event) {
        self.next += 1;
        let (block_hash, transaction) = (Hash([3; 32]), Hash([4; 32]));
        let at = EventAt { block, block_hash, timestamp: None, transaction, log_index: self.next, event };
        assert!(self.directory.apply(&at), "new");
        assert!(!self.directory.apply(&at), "twice is once");
    }

    fn register(&mut self, block: u64, account: Address) -> SignerId {
        let pair = pair();
        let proven = identity(&pair, account);
        self.tell(block, Event::Registered { owner: account, identity: proven, epoch: 1 });
        signer_id(&pair.public)
    }

    fn grant(&mut self, block: u64, expiry: Option<Timestamp>, scope: Scope) {
        let terms = GrantTerms { owner: OWNER, grantee: READER, epoch: 1, expiry, scope };
        self.tell(block, Event::Granted { terms, envelope: vec![1; 100] });
    }

    fn sign(&self, signer: SignerId, block: u64, seconds: u64) -> Result<SigningRight, NoRight> {
        may_sign(&self.directory, OWNER, signer, Moment::of_block(block, Timestamp::from_seconds(seconds)))
    }

    fn read(&self, topic: Option<TopicId>, policy: Policy) -> Result<ReadingRight, ReadRefused> {
        may_read(&self.directory, READER, OWNER, topic, policy)
    }
}

fn pair() -> SmKeyPair {
    SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("pair")
}

fn identity(pair: &SmKeyPair, account: Address) -> crate::model::Identity {
    let provider = provider(ProviderName::RustCrypto);
    prove(provider, &DOMAIN, &account, pair, &self::pair().public, Token([5; 32])).expect("proves")
}

#[test]
fn an_owner_signs_from_registration_on_and_by_the_key_of_that_block() {
    let mut told = Told::new();
    assert_eq!(told.sign(DEVICE, 5, 0), Err(NoRight::Unregistered { owner: OWNER, block: Some(5) }));
    let first = told.register(10, OWNER);
    let (second, unproven) = (pair(), pair());
    let rotated = identity(&second, OWNER);
    told.tell(20, Event::KeysRotated { owner: OWNER, keys: 2, identity: rotated, envelope: Vec::new() });
    assert!(matches!(told.sign(first, 9, 0), Err(NoRight::Unregistered { .. })));
    assert!(matches!(told.sign(first, 10, 0), Ok(SigningRight::Owner(_))));
    assert!(matches!(told.sign(first, 19, 0), Ok(SigningRight::Owner(_))));
    assert_eq!(told.sign(first, 20, 0), Err(NoRight::Replaced { owner: OWNER, since: 20, block: Some(20) }));
    assert_eq!(told.sign(signer_id(&second.public), 20, 0), Ok(SigningRight::Owner(second.public)));
    assert!(matches!(told.sign(signer_id(&second.public), 19, 0), Err(NoRight::Unknown { .. })));
    let stolen = identity(&unproven, READER);
    told.tell(30, Event::KeysRotated { owner: OWNER, keys: 3, identity: stolen, envelope: Vec::new() });
    assert_eq!(told.sign(signer_id(&unproven.public), 30, 0), Err(NoRight::Unproven { owner: OWNER }));
}

#[test]
fn nothing_anchored_inside_a_suspension_is_signed_by_right_and_the_blocks_events_count_first() {
    let mut told = Told::new();
    let key = told.register(1, OWNER);
    told.tell(2, Event::Lent { owner: OWNER, device: DEVICE, until: None });
    told.tell(10, Event::Suspended { account: OWNER });
    told.tell(15, Event::Restored { account: OWNER });
    told.tell(20, Event::Suspended { account: OWNER });
    told.tell(20, Event::Restored { account: OWNER });
    for signer in [key, DEVICE] {
        assert!(told.sign(signer, 9, 0).is_ok());
        for block in [10, 14] {
            let refused = NoRight::Suspended { owner: OWNER, since: 10, block: Some(block) };
            assert_eq!(told.sign(signer, block, 0), Err(refused));
        }
        assert!(told.sign(signer, 15, 0).is_ok(), "restored in it");
        assert!(told.sign(signer, 20, 0).is_ok(), "suspended and restored within one block");
    }
    told.tell(30, Event::Suspended { account: OWNER });
    told.tell(31, Event::Succeeded { lost: OWNER, successor: READER });
    let lost = told.sign(key, 99, 0).expect_err("lost");
    assert_eq!(lost, NoRight::Succeeded { owner: OWNER, successor: READER, since: 30, block: Some(99) });
    assert!(lost.to_string().contains("at block 99") && lost.to_string().contains("since block 30"), "{lost}");
    assert!(told.sign(key, 29, 0).is_ok(), "what was anchored before stays");
}

#[test]
fn a_device_signs_within_its_loan_by_blocks_and_by_the_anchoring_blocks_time() {
    let mut told = Told::new();
    told.register(1, OWNER);
    let until = Some(Timestamp::from_seconds(1000));
    told.tell(10, Event::Lent { owner: OWNER, device: DEVICE, until });
    assert_eq!(told.sign(DEVICE, 9, 0), Err(NoRight::LentLater { owner: OWNER, from: 10 }));
    assert!(matches!(told.sign(DEVICE, 10, 999), Ok(SigningRight::Device(_))));
    assert!(matches!(told.sign(DEVICE, 11, 1000), Err(NoRight::Ended { .. })), "the end is outside");
    // Renewed, then shortened: the last change counts from its block on.
    told.tell(20, Event::Lent { owner: OWNER, device: DEVICE, until: Some(Timestamp::from_seconds(2000)) });
    assert!(told.sign(DEVICE, 19, 1500).is_err() && told.sign(DEVICE, 20, 1500).is_ok());
    told.tell(25, Event::Lent { owner: OWNER, device: DEVICE, until: Some(Timestamp::from_seconds(1600)) });
    assert!(told.sign(DEVICE, 24, 1700).is_ok() && told.sign(DEVICE, 25, 1700).is_err());
    told.tell(30, Event::Recalled { owner: OWNER, device: DEVICE });
    assert_eq!(told.sign(DEVICE, 30, 1500), Err(NoRight::Recalled { owner: OWNER, recalled: 30 }));
    assert!(told.sign(DEVICE, 29, 1500).is_ok());
    told.tell(30, Event::Lent { owner: OWNER, device: DEVICE, until: None });
    assert!(told.sign(DEVICE, 30, 9_999_999).is_ok(), "lent again in the same block");
    let newest = Moment::newest(Timestamp::from_seconds(9_999_999));
    assert!(may_sign(&told.directory, OWNER, DEVICE, newest).is_ok());
    assert!(may_sign(&told.directory, READER, DEVICE, newest).is_err(), "another owner's");
}

#[test]
fn a_gateway_demands_more_than_an_own_site_and_neither_serves_the_suspended() {
    let mut told = Told::new();
    told.register(1, OWNER);
    told.register(1, READER);
    let head = |number| Some(BlockRef { number, hash: Hash([0; 32]), timestamp: 0 });
    let gateway = |number, revoke_announced| Policy::Gateway { head: head(number), confirmations: 3, revoke_announced };
    let refused = Err(ReadRefused::NotGranted { owner: OWNER, reader: READER });
    assert_eq!(told.read(None, Policy::OwnSite), refused);
    told.grant(10, None, Scope::Topics(vec![TopicId([1; 16])]));
    assert!(told.read(None, Policy::OwnSite).is_ok());
    assert!(told.read(Some(TopicId([1; 16])), Policy::OwnSite).is_ok());
    let beyond = told.read(Some(TopicId([2; 16])), Policy::OwnSite);
    assert_eq!(beyond, Err(ReadRefused::NotCovered { owner: OWNER, reader: READER }));
    assert_eq!(told.read(None, gateway(11, false)), refused, "not deep enough");
    assert!(told.read(None, gateway(12, false)).is_ok());
    assert_eq!(told.read(None, gateway(12, true)), refused, "announced");
    let stale = Policy::Gateway { head: None, confirmations: 1, revoke_announced: false };
    assert_eq!(told.read(None, stale), Err(ReadRefused::Stale));
    assert_eq!(may_read(&told.directory, OWNER, OWNER, None, stale), Ok(ReadingRight::Own));
    told.tell(20, Event::Suspended { account: READER });
    for policy in [Policy::OwnSite, gateway(50, false)] {
        assert_eq!(told.read(None, policy), Err(ReadRefused::Suspended { reader: READER, since: 20 }));
    }
    assert!(shared_with(&told.directory, READER).is_empty());
    assert!(standing_grant(&told.directory, OWNER, READER).is_some(), "the owner's grant stands");
    told.tell(21, Event::Restored { account: READER });
    assert_eq!(shared_with(&told.directory, READER).len(), 1);
    told.tell(22, Event::Revoked { owner: OWNER, grantee: READER, epoch: 2, token: Token([6; 32]) });
    assert_eq!(told.read(None, Policy::OwnSite), refused);
    // By the later of clock and block time, a grant that expires there has expired.
    let far = u64::MAX / 2_000_000_000;
    told.grant(30, Some(Timestamp::from_seconds(far)), Scope::All);
    let late = Some(BlockRef { number: 90, hash: Hash([0; 32]), timestamp: far });
    let policy = Policy::Gateway { head: late, confirmations: 1, revoke_announced: false };
    assert!(told.read(None, Policy::OwnSite).is_ok());
    assert_eq!(told.read(None, policy), refused);
}
