//! A witness's side: what it signs, what it refuses, and what exposes a chain that was written anew.

use std::sync::Arc;

use super::*;
use crate::crypto::{ProviderName, provider};
use crate::model::{RecorderId, Signature};
use crate::pipeline::fixture::Notes;
use crate::store::{AuditQuery, Ledger, open_vault};
use authros_evidence::witness::check_countersignature;

const OWNER: Address = Address([0xa; 20]);
const KEEPER: Address = Address([0xb; 20]);

struct Stage {
    _home: tempfile::TempDir,
    plant: Plant,
    notes: Arc<Notes>,
    /// The witness's key.
    keeper: SmKeyPair,
    /// The party's.
    party: SmKeyPair,
}

impl Stage {
    fn new() -> Self {
        let home = tempfile::tempdir().expect("a folder");
        let notes = Arc::new(Notes::default());
        let plant = Plant {
            ledger: Ledger::open(&home.path().join("ledger.db")).expect("a ledger"),
            vault: open_vault(None, home.path()).expect("a vault"),
            provider: provider(ProviderName::RustCrypto),
            observer: Arc::clone(&notes) as _,
            backlog: u64::MAX,
        };
        let pair = || SmKeyPair::generate(plant.provider).expect("a pair");
        let (keeper, party) = (pair(), pair());
        let stage = Self { _home: home, notes, keeper, party, plant };
        stage.plant.ledger.put_witness(stage.row(true)).expect("added");
        stage
    }

    fn row(&self, serves: bool) -> WitnessRow {
        WitnessRow {
            owner: KEEPER,
            key: signer_id(&self.party.public),
            account: OWNER,
            name: "The fleet".to_owned(),
            address: None,
            serves,
            added_at: Timestamp(1),
        }
    }

    fn position(&self, block: u64, earlier: Option<(u64, Hash)>) -> Position {
        Position {
            chain_id: 7,
            genesis: Hash([1; 32]),
            contract: Address([2; 20]),
            owner: OWNER,
            key: self.party.public,
            recorder: RecorderId([5; 16]),
            block,
            block_hash: hash(block),
            earlier,
            top: Hash([8; 32]),
            count: 3,
            head: Some((block, Digest(hash(block).0))),
        }
    }

    fn signed(&self, position: &Position) -> SignedPosition {
        state(*position, &self.party, self.plant.provider).expect("signs")
    }

    fn ask(&self, stated: &SignedPosition) -> Result<Countersignature, Unsigned> {
        countersigned(&self.plant, (KEEPER, &self.keeper), stated)
    }
}

fn hash(block: u64) -> Hash {
    Hash([u8::try_from(block).expect("a small number"); 32])
}

#[test]
fn a_statement_is_countersigned_once_and_the_next_one_refers_to_it() {
    let stage = Stage::new();
    let first = stage.signed(&stage.position(10, None));
    let given = stage.ask(&first).expect("countersigned");
    assert_eq!((given.stated, given.witness, given.key), (first, KEEPER, stage.keeper.public));
    check_countersignature(&given, stage.plant.provider).expect("both signatures hold");
    assert_eq!(stage.ask(&first), Ok(given), "an answer that was lost is given again");
    // One that refers to nothing, though there is something.
    let forgetful = stage.signed(&stage.position(20, None));
    assert_eq!(stage.ask(&forgetful), Ok(given), "the last one, to refer to");
    let second = stage.signed(&stage.position(20, Some((10, hash(10)))));
    assert_eq!(stage.ask(&second).expect("countersigned").stated, second);
    assert_eq!(stage.plant.ledger.countersigned_count(signer_id(&stage.party.public)), Ok((2, 1)));
    assert!(stage.notes.all().is_empty());
}

#[test]
fn strangers_and_forgeries_are_refused_each_for_its_own_reason() {
    let stage = Stage::new();
    let other = SmKeyPair::generate(stage.plant.provider).expect("a pair");
    let strange = state(stage.position(10, None), &other, stage.plant.provider).expect("signs");
    assert_eq!(stage.ask(&strange), Err(Unsigned::Stranger(signer_id(&other.public))));
    let key = signer_id(&stage.party.public);
    let found = Address([9; 20]);
    let borrowed = stage.signed(&Position { owner: found, ..stage.position(10, None) });
    assert_eq!(stage.ask(&borrowed), Err(Unsigned::OtherAccount { key, found }));
    let mut altered = stage.signed(&stage.position(10, None));
    altered.position.block = 11;
    assert!(matches!(stage.ask(&altered), Err(Unsigned::Forged(why)) if why.contains("not signed by the key")));
    let forged = SignedPosition { position: stage.position(10, None), signature: Signature([7; 64]) };
    assert!(matches!(stage.ask(&forged), Err(Unsigned::Forged(_))));
    stage.plant.ledger.put_witness(stage.row(false)).expect("changed");
    assert_eq!(stage.ask(&stage.signed(&stage.position(10, None))), Err(Unsigned::Stranger(key)), "asked only");
    assert_eq!(stage.plant.ledger.countersigned_count(key), Ok((0, 0)));
}

#[test]
fn a_chain_written_anew_is_exposed_with_both_statements() {
    let stage = Stage::new();
    let first = stage.signed(&stage.position(10, None));
    let kept = stage.ask(&first).expect("countersigned");
    let rewritten = Position { block_hash: Hash([99; 32]), ..stage.position(20, Some((10, Hash([98; 32])))) };
    let shorter = Position { recorder: RecorderId([6; 16]), ..stage.position(7, Some((10, Hash([0; 32])))) };
    let two_heads = Position { head: Some((10, Digest([97; 32]))), ..stage.position(21, Some((10, hash(10)))) };
    let lies = [
        (rewritten, Contradiction::TwoBlocks(10)),
        (shorter, Contradiction::BlockGone(10)),
        (two_heads, Contradiction::TwoHeads(10)),
    ];
    for (position, contradiction) in lies {
        let later = stage.signed(&position);
        for _ in 0..2 {
            assert_eq!(stage.ask(&later), Err(Unsigned::Contradicts(contradiction)));
        }
        let found = stage.plant.ledger.two_histories().expect("read").pop().expect("one");
        assert_eq!((found.kept, found.later, found.what), (kept, later, contradiction.to_string()));
        check_countersignature(&found.kept, stage.plant.provider).expect("holds");
        check_position(&found.later, stage.plant.provider).expect("holds");
    }
    assert_eq!(stage.notes.with("equivocation: The fleet"), 3, "each is told once");
    let query = AuditQuery { action: Some("equivocation".to_owned()), limit: 9, ..AuditQuery::default() };
    let lines = AuditLog::new(stage.plant.ledger.clone()).list(&query).expect("listed");
    assert!(lines.iter().all(|line| line.entry.outcome.contains(&kept.stated.signature.to_string())), "{lines:?}");
    // What is true goes on.
    let next = stage.signed(&stage.position(30, Some((10, hash(10)))));
    assert_eq!(stage.ask(&next).expect("countersigned").stated, next);
    // Another chain of the same owner has blocks of its own; that there is one is told.
    let elsewhere = stage.signed(&Position { chain_id: 8, ..stage.position(5, None) });
    assert_eq!(stage.ask(&elsewhere).expect("countersigned").stated, elsewhere);
    assert_eq!(stage.notes.with("states another chain than before, of id 8"), 1);
}

#[test]
fn a_statement_that_anybody_brings_again_accuses_nobody() {
    let stage = Stage::new();
    let mut given = vec![stage.ask(&stage.signed(&stage.position(10, None))).expect("countersigned")];
    for block in [20, 30] {
        let next = stage.signed(&stage.position(block, Some((block - 10, hash(block - 10)))));
        given.push(stage.ask(&next).expect("countersigned"));
    }
    // Out of a bundle, by whoever has it: the same answer as then.
    for known in &given {
        assert_eq!(stage.ask(&known.stated), Ok(*known));
    }
    assert_eq!(stage.plant.ledger.two_histories(), Ok(Vec::new()));
    assert!(stage.notes.all().is_empty());
    assert_eq!(stage.plant.ledger.countersigned_count(signer_id(&stage.party.public)), Ok((3, 1)));
}

#[test]
fn a_statement_is_held_against_all_that_were_made_and_not_only_the_last() {
    let stage = Stage::new();
    let first = stage.signed(&stage.position(10, None));
    let of_head = stage.ask(&first).expect("countersigned");
    let next = |block: u64, head: Option<(u64, Digest)>| {
        let before = block - 10;
        stage.signed(&Position { head, ..stage.position(block, Some((before, hash(before)))) })
    };
    let of_block = stage.ask(&next(20, None)).expect("it refers to block 10");
    stage.ask(&next(30, None)).expect("countersigned");
    let two_heads = next(40, Some((10, Digest([97; 32]))));
    assert_eq!(stage.ask(&two_heads), Err(Unsigned::Contradicts(Contradiction::TwoHeads(10))));
    let other = Position { block_hash: Hash([96; 32]), ..stage.position(10, Some((30, hash(30)))) };
    let other = stage.signed(&Position { head: None, ..other });
    assert_eq!(stage.ask(&other), Err(Unsigned::Contradicts(Contradiction::TwoBlocks(10))));
    let found = stage.plant.ledger.two_histories().expect("read");
    let pairs: Vec<_> = found.iter().map(|one| (one.kept, one.later)).collect();
    assert_eq!(pairs, [(of_head, two_heads), (of_block, other)]);
}

#[test]
fn two_histories_stated_at_once_are_never_both_countersigned() {
    let stage = Stage::new();
    stage.ask(&stage.signed(&stage.position(10, None))).expect("countersigned");
    let both: Vec<SignedPosition> = (1..=8u8)
        .map(|number| {
            let position = Position { block_hash: Hash([number; 32]), ..stage.position(20, Some((10, hash(10)))) };
            stage.signed(&Position { head: None, ..position })
        })
        .collect();
    let (plant, keeper) = (&stage.plant, &stage.keeper);
    let answers: Vec<bool> = std::thread::scope(|scope| {
        let asked = both.iter().map(|stated| scope.spawn(move || countersigned(plant, (KEEPER, keeper), stated)));
        let asked: Vec<_> = asked.collect();
        asked.into_iter().map(|one| one.join().expect("answered").is_ok()).collect()
    });
    assert_eq!(answers.iter().filter(|is_given| **is_given).count(), 1, "{answers:?}");
    assert_eq!(stage.plant.ledger.countersigned_count(signer_id(&stage.party.public)), Ok((2, 1)));
}

#[test]
fn a_party_does_not_fill_the_disk_with_chains() {
    let stage = Stage::new();
    let on = |chain_id: u64| stage.signed(&Position { chain_id, ..stage.position(10, None) });
    for chain in 1..=MOST_CHAINS {
        stage.ask(&on(chain)).expect("countersigned");
    }
    let party = signer_id(&stage.party.public);
    assert_eq!(stage.ask(&on(1000)), Err(Unsigned::TooManyChains(party)));
    assert_eq!(stage.ask(&on(3)).expect("one of those it stated").stated.position, on(3).position);
    assert_eq!(stage.plant.ledger.countersigned_count(party), Ok((MOST_CHAINS, MOST_CHAINS)));
}

#[test]
fn an_answer_counts_only_if_it_is_the_witnesss_and_over_what_was_stated() {
    let stage = Stage::new();
    let signed = stage.signed(&stage.position(10, None));
    let batches = Unwitnessed { upto: 3, roots: vec![Hash([3; 32])], block: 10 };
    let stated = Stated { batches, signed };
    let witness =
        WitnessRow { owner: OWNER, key: signer_id(&stage.keeper.public), account: KEEPER, ..stage.row(false) };
    let take = |answer| answered(&stage.plant, &witness, stated.clone(), answer).map_err(|error| error.to_string());
    let good = stage.ask(&signed).expect("countersigned");
    let by = |stated, (account, key): (Address, &SmKeyPair)| {
        countersign(stated, Timestamp(5), (account, key), stage.plant.provider).expect("signs")
    };
    let expect = |answer, words: &str| {
        let error = take(answer).expect_err("refused");
        assert!(error.contains(words), "{error}");
    };
    expect(by(signed, (KEEPER, &stage.party)), "not by the witness that was asked");
    expect(by(signed, (OWNER, &stage.keeper)), "not by the witness that was asked");
    expect(Countersignature { at: Timestamp(6), ..good }, "not signed by the key");
    let foreign = stage.signed(&Position { owner: Address([3; 20]), ..stage.position(10, None) });
    expect(by(foreign, (KEEPER, &stage.keeper)), "never made here");
    let last = by(stage.signed(&stage.position(4, None)), (KEEPER, &stage.keeper));
    assert_eq!(take(last), Ok(Answered::Last(Box::new(last))));
    assert_eq!(take(good), Ok(Answered::Countersigned(good.at)));
    let network = network_of(&signed.position);
    assert_eq!(stage.plant.ledger.newest_position((OWNER, witness.key), network), Ok(Some(good)));
}
