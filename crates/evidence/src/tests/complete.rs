//! Level (f) with heads of the recorder: ends cut off before and after them, heads held back, heads that lie.

use std::collections::BTreeMap;

use authros_crypto::merkle::{Tree, height_hash};
use authros_crypto::record::{SealRequest, SealedRecord, seal, signed_bytes};
use authros_crypto::{SmKeyPair, signer_id};
use authros_model::head::Compression;
use authros_model::{
    Birth, Digest, Head, Header, Heads, RecordKind, RecorderId, RecorderPrefix, SignerId, Timestamp, TopicId,
};

use super::second::agree;
use super::world::{BLOCK, TIME, World, bound, genesis, ours, pair, sealed, sealed_by, word};
use crate::archive::Members;
use crate::{
    AnchorClaim, Anchoring, Bundle, BundledRecord, Height, Outcome, Packing, Slot, Standing, Stretch, pack, verify,
};

/// The topic of the world's records.
const TOPIC: TopicId = TopicId([8; 16]);
const OTHER: TopicId = TopicId([7; 16]);

/// A statement of the recorder.
fn statement(world: &World, seq: u64, type_name: &str, body: &[u8]) -> SealedRecord {
    let head = Head {
        topic: "authros/recorder".into(),
        type_name: type_name.into(),
        md5sum: String::new(),
        definition: Digest([0; 32]),
        caller_id: String::new(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::new(),
    };
    let request = SealRequest {
        domain: bound(),
        owner: world.owner,
        signer: &world.signer,
        epoch: 1,
        topic_key: &world.topic_key,
        recorder: RecorderPrefix::ledger([4; 7]),
        seq,
        topic_id: TopicId([9; 16]),
        kind: RecordKind::Audit,
        filters: Vec::new(),
        captured_at: Timestamp::from_seconds(TIME - 1),
        head: &head,
        body,
    };
    seal(ours(), &request).expect("seals")
}

/// A world with these numbers of the topic, always including 3, and these heads: their number and their statement.
struct Case {
    world: World,
    records: Vec<(SealedRecord, bool)>,
    heights: Vec<Height>,
}

impl Case {
    fn of(numbers: &[u64], heads: &[(u64, u64)]) -> Self {
        let mut case = Self { world: World::new(), records: Vec::new(), heights: Vec::new() };
        for seq in numbers.iter().filter(|seq| **seq != 3) {
            let record = sealed(case.world.owner, &case.world.signer, &case.world.topic_key, *seq, b"more");
            case.put(record, false);
        }
        for (seq, number) in heads {
            case.head(*seq, *number);
        }
        case
    }

    fn put(&mut self, record: SealedRecord, disclosed: bool) {
        self.world.put(Slot::uploaded(self.world.owner, &record.digest.0), word(&[BLOCK]));
        self.records.push((record, disclosed));
    }

    fn head(&mut self, seq: u64, number: u64) {
        let tree = Tree::new(vec![height_hash(&OTHER, 77), height_hash(&TOPIC, number)]).expect("a tree");
        let heads = Heads { count: 2, root: tree.root(), heights: Digest([1; 32]), previous: Digest([0; 32]) };
        let record = statement(&self.world, seq, Heads::TYPE, &heads.encode());
        self.heights.push(Height { heads: record.digest, topic: TOPIC, number, index: 1, path: tree.path(1) });
        self.put(record, true);
    }

    fn packing(&self) -> Packing {
        let mut packing = self.world.packing();
        let disclosed = self.records.iter().filter(|(_, disclosed)| *disclosed).map(|(record, _)| record);
        if disclosed.clone().next().is_some() {
            packing.disclosure(&self.world.disclosing(disclosed));
        }
        for (record, _) in &self.records {
            let one = BundledRecord {
                record: record.blob.clone(),
                signature: record.signature,
                anchor: Some(AnchorClaim::new(BLOCK, BLOCK, 1, Anchoring::Each {})),
            };
            packing.record(record.digest, one).expect("added");
        }
        packing.heights(self.heights.clone()).expect("added");
        packing
    }

    fn members(&self) -> Members {
        self.packing().sign(genesis(), self.world.owner, &self.world.keys, ours()).expect("signs")
    }

    /// What both verifiers say about the topic.
    fn told(&self, outcome: Outcome) -> Stretch {
        let members = self.members();
        agree(&members, &World::trust(), outcome);
        let bundle = Bundle::parse(&pack(&members).expect("packs"), ours()).expect("reads");
        let report = verify(&bundle, Some(&World::trust()), ours());
        report.complete.into_iter().find(|stretch| stretch.topic_id == TOPIC).expect("of the topic")
    }

    fn expect(&self, outcome: Outcome, text: &str) -> Stretch {
        let stretch = self.told(outcome);
        assert_eq!(stretch.text, text);
        stretch
    }
}

const AT: &str = "2023-11-14T22:15:00";

fn time() -> String {
    let shown = Timestamp::from_seconds(TIME).to_string();
    assert!(shown.starts_with(AT), "{shown}");
    shown
}

#[test]
fn a_topic_is_complete_to_the_number_that_the_head_names_and_not_beyond() {
    let at = time();
    let whole = Case::of(&[1, 2, 3, 4, 5], &[(3, 5)]).expect(
        Outcome::Holds,
        &format!(
            "every number from 1 to 5; complete to number 5 as of the heads record at {at}; nothing is claimed after that"
        ),
    );
    assert_eq!((whole.missing, whole.heads.map(|heads| heads.number), whole.standing), (0, Some(5), Standing::Proven));
    // Cut off before the head: reported, with what is missing.
    let cut = Case::of(&[1, 2, 3], &[(3, 5)]).expect(
        Outcome::Holds,
        &format!(
            "1 to 3 without 4-5 (2 missing); NOT complete to number 5, which the heads record at {at} names; nothing is \
             claimed after that"
        ),
    );
    assert_eq!((cut.gaps, cut.missing), (vec![(4, 5)], 2));
    // Cut off after it: nobody says whether there was a sixth, and nothing is claimed.
    let claim = format!("complete to number 3 as of the heads record at {at}; nothing is claimed after that");
    Case::of(&[1, 2, 3, 4], &[(3, 3)]).expect(Outcome::Holds, &format!("every number from 1 to 4; {claim}"));
    Case::of(&[1, 2, 3], &[(3, 3)]).expect(Outcome::Holds, &format!("every number from 1 to 3; {claim}"));
    let middle = format!("3 to 6 without 5 (1 missing); {claim}").replace("claimed after", "claimed before 3 or after");
    Case::of(&[3, 4, 6], &[(3, 3)]).expect(Outcome::Holds, &middle);
}

#[test]
fn a_head_from_before_the_first_number_says_nothing_of_those_behind_it() {
    let stretch = Case::of(&[3, 5, 6, 7], &[(3, 2)]).expect(
        Outcome::Holds,
        &format!(
            "3 to 7 without 4 (1 missing); the heads record at {} names number 2, which is before the first one here, \
             so it says nothing about these; nothing is claimed before 3 or after 7",
            time()
        ),
    );
    assert_eq!((stretch.first, stretch.heads.map(|heads| heads.number)), (Some(3), Some(2)));
}

#[test]
fn a_statement_that_is_not_proven_spoils_nothing_and_one_that_is_refused_does() {
    let mut case = Case::of(&[1, 2, 3], &[(9, 3)]);
    let birth = statement(&case.world, 1, Birth::TYPE, &Birth { predecessor: None }.encode());
    let digest = birth.digest;
    case.world.put(Slot::uploaded(case.world.owner, &digest.0), word(&[BLOCK]));
    let with = |anchor: Option<AnchorClaim>| {
        let mut packing = case.packing();
        let heads = case.records.iter().filter(|(_, disclosed)| *disclosed).map(|(record, _)| record);
        packing.disclosure(&case.world.disclosing(heads.chain([&birth])));
        let one = BundledRecord { record: birth.blob.clone(), signature: birth.signature, anchor };
        packing.record(digest, one).expect("added");
        packing.sign(genesis(), case.world.owner, &case.world.keys, ours()).expect("signs")
    };
    // Its state is missing: it shows nothing.
    let mute = with(None);
    agree(&mute, &World::trust(), Outcome::Holds);
    let report = verify(&Bundle::of_members(&mute, ours()).expect("reads"), Some(&World::trust()), ours());
    assert!(report.warnings.iter().any(|text| text.contains("own statement is not proven")), "{:?}", report.warnings);
    agree(&with(Some(AnchorClaim::new(BLOCK - 1, BLOCK, 1, Anchoring::Each {}))), &World::trust(), Outcome::Refused);
}

#[test]
fn a_recorders_own_statements_are_no_topic_with_holes() {
    let mut case = Case::of(&[1, 2, 3], &[(2001, 3)]);
    let birth = statement(&case.world, 1, Birth::TYPE, &Birth { predecessor: None }.encode());
    case.put(birth, true);
    let members = case.members();
    agree(&members, &World::trust(), Outcome::Holds);
    let report = verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours());
    let own = report.complete.iter().find(|stretch| stretch.topic_id == TopicId([9; 16])).expect("its own");
    assert_eq!((own.text.as_str(), own.missing, own.gaps.len()), ("the recorder's own statements", 0, 0));
}

#[test]
fn with_a_head_held_back_an_older_one_counts_and_with_none_nothing_is_claimed() {
    let at = time();
    let newest = Case::of(&[1, 2, 3, 4, 5], &[(3, 3), (5, 5)]);
    assert!(newest.told(Outcome::Holds).text.contains("complete to number 5"));
    let mut held_back = Case::of(&[1, 2, 3], &[(3, 3), (5, 5)]);
    held_back.heights.pop();
    let text = format!(
        "every number from 1 to 3; complete to number 3 as of the heads record at {at}; nothing is claimed after that"
    );
    held_back.expect(Outcome::Holds, &text);
    let none = Case::of(&[1, 2, 3], &[]);
    none.expect(Outcome::Holds, "every number from 1 to 3; there is no heads record: nothing is claimed after 3");
    // A head that is present but not disclosed, not anchored, or of another key says nothing.
    let mut sealed_head = Case::of(&[1, 2, 3], &[(3, 3)]);
    sealed_head.records.last_mut().expect("the head").1 = false;
    assert_eq!(sealed_head.told(Outcome::Holds).heads, None);
    let mut strange = Case::of(&[1, 2, 3], &[]);
    let own = std::mem::replace(&mut strange.world.signer, pair());
    strange.head(3, 9);
    let thief = std::mem::replace(&mut strange.world.signer, own);
    let mut packing = strange.packing();
    packing.key(&thief.public).expect("a point");
    let members = packing.sign(genesis(), strange.world.owner, &strange.world.keys, ours()).expect("signs");
    let bundle = Bundle::of_members(&members, ours()).expect("reads");
    let report = verify(&bundle, Some(&World::trust()), ours());
    assert!(report.complete.iter().all(|stretch| stretch.heads.is_none()), "{:?}", report.complete);
}

#[test]
fn the_numbers_of_a_ring_have_no_holes_and_nothing_is_claimed_of_others() {
    let (mut case, ring) = (Case::of(&[3], &[]), RecorderPrefix::ring([6; 7]));
    for seq in [20, 37, 38, 39] {
        let whose = (case.world.owner, &case.world.signer, &case.world.topic_key);
        let record = sealed_by(ring, whose, seq, (b"before the button", 17, Compression::None));
        case.put(record, false);
    }
    let members = case.members();
    agree(&members, &World::trust(), Outcome::Holds);
    let report = verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours());
    let stretch = report.complete.iter().find(|stretch| ring.has(&stretch.recorder)).expect("the ring's");
    assert_eq!((stretch.missing, stretch.gaps.len(), stretch.standing), (0, 0, Standing::Proven));
    let begun = "of a robot's ring every number of 20, 37-39; other numbers of a ring expired";
    assert!(stretch.text.starts_with(begun), "{}", stretch.text);
}

#[test]
fn heads_that_contradict_are_refused() {
    let fewer = Case::of(&[1, 2, 3], &[(3, 9), (5, 3)]).told(Outcome::Refused);
    assert_eq!(fewer.standing, Standing::Refused);
    assert!(fewer.text.starts_with("the heads of its recorder contradict each other"), "{}", fewer.text);
    let lies: [fn(&mut Height); 4] = [
        |height| height.number = 3,
        |height| height.index = 0,
        |height| height.path.clear(),
        |height| height.path.iter_mut().for_each(|hash| hash.0[0] ^= 1),
    ];
    for lie in lies {
        let mut case = Case::of(&[1, 2, 3, 4], &[(3, 4)]);
        lie(&mut case.heights[0]);
        assert_eq!(case.told(Outcome::Refused).standing, Standing::Refused);
    }
}

#[test]
fn a_birth_names_the_recorder_that_it_follows() {
    let mut case = Case::of(&[3], &[(3, 3)]);
    let birth = Birth { predecessor: Some(RecorderId([3; 16])) };
    let record = statement(&case.world, 1, Birth::TYPE, &birth.encode());
    case.put(record, true);
    let stretch = case.told(Outcome::Holds);
    assert_eq!((stretch.predecessor, stretch.born_at), (birth.predecessor, Some(Timestamp::from_seconds(TIME))));
    assert!(stretch.text.ends_with(
        "its recorder follows 03030303030303030303030303030303, after a restore, on a copy, or with another key"
    ));
}

/// A robot that the owner lent, and one that signs under an id which begins like that of the owner's recorder.
#[test]
fn a_number_belongs_to_the_key_that_signs() {
    let mut case = Case::of(&[3, 4], &[]);
    let (owner, robot) = (case.world.owner, pair());
    let mut loan = [0; 32];
    loan[31] = 1;
    loan[15..23].copy_from_slice(&12u64.to_be_bytes());
    case.world.put(Slot::loan(owner, &signer_id(&robot.public).0), loan);
    for seq in [3, 1 << 40] {
        case.put(sealed(owner, &robot, &case.world.topic_key, seq, b"of the robot"), false);
    }
    let mut packing = case.packing();
    packing.key(&robot.public).expect("a point");
    let members = packing.sign(genesis(), owner, &case.world.keys, ours()).expect("signs");
    agree(&members, &World::trust(), Outcome::Holds);
    let report = verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours());
    let of = |key: &SmKeyPair| {
        let signer = signer_id(&key.public);
        let stretch = report.complete.iter().find(|stretch| stretch.signer == signer).expect("its stretch");
        (stretch.standing, stretch.first, stretch.last, stretch.missing, stretch.twice.len())
    };
    assert_eq!(of(&case.world.signer), (Standing::Proven, Some(3), Some(4), 0, 0), "nothing of the owner's is missing");
    assert_eq!(of(&robot), (Standing::Proven, Some(3), Some(1 << 40), (1 << 40) - 4, 0));
}

/// Headers that no honest program writes, signed all the same.
#[test]
fn a_number_under_another_keys_recorder_or_out_of_bounds_is_refused() {
    let changes: [fn(&mut Header); 6] = [
        |header| header.recorder = RecorderPrefix::ledger([4; 7]).of_signer(&SignerId([7; 32])),
        |header| header.recorder.0[0] = 3,
        |header| header.seq = (1 << 40) + 1,
        |header| header.seq = u64::MAX >> 1,
        |header| header.epoch = 1 << 63,
        |header| header.captured_at = Timestamp(1 << 63),
    ];
    for change in changes {
        let mut world = World::new();
        let SealedRecord { mut header, blob, .. } = world.record;
        let prefix = header.encode().len();
        change(&mut header);
        let blob = [&header.encode()[..], &blob[prefix..]].concat();
        let digest = Digest(ours().sm3(&[&blob]));
        let signature = ours().sign(&world.signer.secret, &signed_bytes(&bound(), &digest)).expect("signs");
        world.record = SealedRecord { header, blob, digest, signature };
        agree(&world.members(), &World::trust(), Outcome::Refused);
    }
}
