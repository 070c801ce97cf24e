//! Every note of the list, with damaged values.

use super::*;
use crate::Ledger;
use crate::model::{ErrorKind, WatchRule};

/// What each note may say. A note that is missing here fails the test of the whole list.
fn samples() -> Vec<(Kind, String)> {
    fn of<N: Note>(value: N::Value) -> (Kind, String) {
        (Kind::of::<N>(), serde_json::to_string(&(value,)).expect("a text"))
    }
    let (address, digest, hash) = (Address([1; 20]), Digest([2; 32]), Hash([3; 32]));
    let (device, key, at) = (SignerId([4; 32]), PublicKey([5; 64]), Timestamp(6_000_000_007));
    let name: ProfileName = "lab".parse().expect("a name");
    let topic = "/odom".parse().expect("a name");
    let awaited = AwaitedBlock { block: (7, hash), since: at };
    let gateway = EnrolledGateway { addresses: vec!["lab:1".to_owned()], key: device };
    let topics = vec!["/odom".to_owned()];
    let robot = Enrolled { name, device, topics, ended: false, key, gateway: Some(gateway) };
    let span = RingSpan { since: at, until: at, topics: "/odom".parse().expect("patterns") };
    let standings =
        Standings { topics: [("/odom".to_owned(), Standing::Whole)].into(), tags: ["run".to_owned()].into() };
    let contact =
        Contact { name: "bob".parse().expect("a name"), address, fingerprint: Some("0011".to_owned()), given: true };
    let foreign = ForeignAnchors { account: address, count: 12, block: 34, transaction: hash, seen: at, noted: at };
    let owner = FollowedOwner { grant: 12, newest: 34, count: 56 };
    let waits = [(digest, true)].into();
    let taken = TakenOfOwner { known: owner, place: Some(78), waits, beyond: Some(9), ..TakenOfOwner::default() };
    let taken = FeedTaken { feed: [9; 16], begun: at, owners: [(address, taken)].into() };
    let text = || "text".to_owned();
    vec![
        of::<LastPlace>(text()),
        of::<CopiedAt>(12),
        of::<RestoredAt>(at),
        of::<ForeignHistory>(12),
        of::<StoreWasGone>(at),
        of::<SeenForeign>(foreign),
        of::<LossesCounted>(12),
        of::<ScrubbedUpTo>(12),
        of::<ProfileAccounts>([("lab".parse().expect("a name"), vec![address])].into()),
        of::<MissedFrom>(12),
        of::<UnsureBlocks>(vec![UnsureBlock { block: 12, hash, events: 3, times: 1 }]),
        of::<NodeBehind>(awaited.clone()),
        of::<DoubtedBlock>(awaited),
        of::<Watched>(WatchRules(vec![WatchRule { pattern: topic, type_name: None, sampling: None, except: false }])),
        of::<StoredDefinition>(()),
        of::<AskedSpans>([AskedSpan { number: 12, span }].into()),
        of::<Imported>(standings),
        of::<Followed>(FilePlace { name: text(), stored: 12, digest: Some(digest), ..FilePlace::default() }),
        of::<SealedUnderName>(digest),
        of::<StatedAuditHead>(StatedHead { line: 12, hash: digest }),
        of::<StatedNumbers>(StatedRoot { looked: at, root: hash, heads: Some(digest) }),
        of::<Equivocations>(vec![digest]),
        of::<Erased>(Erasure { at, by: text(), reason: text() }),
        of::<AddressBook>(vec![contact]),
        of::<WrappedFor>(text()),
        of::<Revoking>(vec![address]),
        of::<GrantedTopic>(text()),
        of::<GrantedFrom>(1),
        of::<AdmittedOwners>(vec![AdmittedOwner { owner: address, since: at, by: text() }]),
        of::<SharedSystemKeys>(SealedSystemKeys { join: 12, list: text(), secrets: text() }),
        of::<HoldersSettings>([("confirmations".to_owned(), "3".to_owned())].into()),
        of::<AnnouncedRevoke>(12),
        of::<ErasuresTold>(12),
        of::<TakenOfFeed>(taken),
        of::<ProofsTaken>(([9; 16], 12)),
        of::<EnrolledRobots>(vec![robot]),
        of::<WantedPolicy>(PolicyWanted { version: 12, text: text(), set_at: at }),
        of::<KeysTold>(text()),
        of::<OwnerKeysTold>((key, key)),
        of::<NoticesCarried>(12),
        of::<PolicyHere>(PolicyKept { version: 12, text: text(), heard: 12, refused: Some(text()) }),
        of::<PolicyTold>(text()),
    ]
}

/// Damage to a text that was this: cut short anywhere, of other types, and of a later kind.
fn damaged(good: &str) -> Vec<String> {
    let mut texts: Vec<String> = (0..good.len()).filter_map(|end| good.get(..end)).map(str::to_owned).collect();
    let bare = &good[1..good.len() - 1];
    texts.extend(["not JSON", "[]", "{}", "null", "[[[[0]]]]", "[{\"later\":1}]", "[-1]", "[1.5]"].map(str::to_owned));
    texts.extend([bare.to_owned(), format!("[{bare},1]"), format!("[[{bare}]]"), format!("{good}x")]);
    texts.extend([format!("[{{\"later\":{bare}}}]"), "[\"18446744073709551616\"]".to_owned()]);
    if good.contains('{') {
        texts.push(good.replacen('{', "{\"later\":1,", 1));
        texts.push(good.replacen(":{", ":{\"later\":1,", 1));
    }
    texts.retain(|text| text != good);
    texts
}

#[test]
fn every_note_is_listed_once_and_tried() {
    let mut names: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
    let tried: Vec<&str> = samples().iter().map(|(kind, _)| kind.name).collect();
    assert_eq!(names, tried, "a note without a sample is not tried with damaged values");
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), KINDS.len(), "two notes have one name");
}

#[test]
fn a_damaged_note_is_an_error_that_names_it_and_never_none() {
    let home = tempfile::tempdir().expect("a folder");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
    let set = |kind: &Kind, value: rusqlite::types::Value| {
        let name = kind.name;
        let write = ledger.database.write(move |session| {
            let file = session.connection.file().expect("a file");
            file.execute("REPLACE INTO notes VALUES (?1, 'part', ?2)", (name, &value))?;
            Ok(())
        });
        write.expect("written");
    };
    let read = |kind: &Kind| ledger.database.read(|connection| (kind.try_read)(connection, "part"));
    for (kind, good) in samples() {
        set(&kind, good.clone().into());
        assert_eq!(read(&kind), Ok(()), "{}: {good}", kind.name);
        for text in damaged(&good) {
            // A text where any text may stand is one; so is nothing beside a note that says nothing.
            if good == "[\"text\"]" && text.starts_with("[\"") && serde_json::from_str::<(String,)>(&text).is_ok() {
                continue;
            }
            set(&kind, text.clone().into());
            let error = read(&kind).expect_err(&format!("{}: {text}", kind.name));
            assert!(matches!(error, StoreError::Note { .. }), "{}: {text}: {error}", kind.name);
            let said = error.to_string();
            assert!(said.contains("ledger.db") && said.contains("(part)") && said.contains("restore"), "{said}");
            assert_eq!(error.kind(), ErrorKind::Tampered);
        }
        let glance = crate::ledger::Glance::at(ledger.path()).expect("opens");
        let error = glance.check_notes().expect_err("damaged").to_string();
        assert!(error.contains("ledger.db") && error.contains("(part)"), "{error}");
        set(&kind, vec![0xff_u8, 0].into());
        assert!(matches!(read(&kind), Err(StoreError::Note { .. })), "{}: no text", kind.name);
        set(&kind, 12.into());
        assert!(matches!(read(&kind), Err(StoreError::Note { .. })), "{}: a number", kind.name);
        set(&kind, good.into());
    }
    let check = || crate::ledger::Glance::at(ledger.path()).expect("opens").check_notes();
    assert_eq!(check(), Ok(KINDS.len() as u64));
    let later = Kind { name: "of a later version", ..Kind::of::<CopiedAt>() };
    set(&later, "[1]".to_owned().into());
    assert!(check().expect_err("unknown").to_string().contains("of a later version"));
}

#[test]
fn notes_of_one_kind_are_told_apart_by_what_they_are_about() {
    let home = tempfile::tempdir().expect("a folder");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
    let [one, other] = [1, 2].map(|name| AnnouncedRevoke { owner: Address([1; 20]), reader: Address([name; 20]) });
    ledger.notes.write(&one, &5).expect("written");
    assert_eq!((ledger.notes.read(&one), ledger.notes.read(&other)), (Ok(Some(5)), Ok(None)));
}
