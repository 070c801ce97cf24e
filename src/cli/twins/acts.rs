//! Every act that the console sends shows its command line: a walk through all of them, each line split by a shell and
//! read by the program's own arguments.

use std::process::Command as Program;

use clap::Parser as _;

use crate::app::incidents::Deed;
use crate::app::{Errand, Settings, State, Tag, command_line};
use crate::cli::args::Arguments;
use crate::model::{Address, Party, Timestamp};
use crate::service::command::{
    Administration, CloseIncident, EndUnattended, Held, NoteIncident, OpenIncident, Pace, PlayWishes,
    PrepareUnattended, RemoveIncident,
};
use crate::service::{Command, Epochs, KeyKind, Operation, SecretText};

const OWNER: Address = Address([0xab; 20]);
/// 2027-01-31T12:00:00Z
const END: Timestamp = Timestamp(1_801_396_800_000_000_000);

/// The place of an act in the walk; `None` = it is no act of an operator. A tag that is forgotten does not compile.
#[deny(clippy::wildcard_enum_match_arm)]
fn place(tag: &Tag) -> Option<usize> {
    Some(match tag {
        Tag::Feed(..) | Tag::OpenConsole | Tag::Beside(..) | Tag::Path(_) => return None,
        // These two are ends: of the console, and of a playback, which on the command line is Ctrl-C.
        Tag::HoldCapture | Tag::StopPlay => return None,
        Tag::CreateIdentity => 0,
        Tag::Unlock => 1,
        Tag::Register => 2,
        Tag::Watch(_) => 3,
        Tag::Unwatch(_) => 4,
        Tag::Grant(_) => 5,
        Tag::Extend(_) => 6,
        Tag::Revoke(_) => 7,
        Tag::LoadKey(_) => 8,
        Tag::ExportKey(_) => 9,
        Tag::Rotate => 10,
        Tag::Lock => 11,
        Tag::BackUp => 12,
        Tag::PrepareUnattended => 13,
        Tag::EndUnattended => 14,
        Tag::Administer(_) => 15,
        Tag::Deploy => 16,
        Tag::Adopt => 17,
        Tag::Pin(_) => 18,
        Tag::Unpin(_) => 19,
        Tag::Release(_) => 20,
        Tag::Discard(_) => 21,
        Tag::Publishers(_) => 22,
        Tag::Show(_) => 23,
        Tag::Open(_) => 24,
        Tag::Check(_) => 25,
        Tag::Export(_) => 26,
        Tag::Contact(_) => 27,
        Tag::Incident(..) => 28,
        Tag::Play(_) => 29,
    })
}

const ACTS: usize = 30;

/// Each act with the line that a person would type for it.
fn acts() -> Vec<(Tag, Command, String)> {
    let topic = || "/robot1/odom".parse().expect("a topic");
    let name = || "/robot1/odom".to_owned();
    let secret = || SecretText::new("never on a line".to_owned());
    let held = || Held { topic: Some(topic()), ids: Vec::new() };
    let owner = || Party::Address(OWNER);
    let incident = || "fall".parse().expect("a name");
    let contact = || "bob".parse().expect("a name");
    let id = || "0123456789abcdef".to_owned();
    let play = PlayWishes {
        owner: Some(owner()),
        topics: vec!["/robot1/odom".parse().expect("a pattern")],
        pace: Pace::Follow,
        prefix: Some("/shared/bob".parse().expect("a name")),
        ..PlayWishes::default()
    };
    let open = OpenIncident {
        name: incident(),
        since: END,
        until: None,
        topics: vec![topic()],
        note: Some("it's down".to_owned()),
        robots: Vec::new(),
    };
    let export = |id: String| Command::ExportUpload { id, addresses: false };
    vec![
        (Tag::CreateIdentity, Command::CreateIdentity { passphrase: secret() }, "identity create".into()),
        (Tag::Unlock, Command::Unlock { passphrase: secret() }, "keys list --passphrase-file FILE".into()),
        (Tag::Register, Command::Register, "register".into()),
        (
            Tag::Watch(name()),
            Command::WatchTopic { topic: topic(), type_name: None },
            "topics watch /robot1/odom".into(),
        ),
        (Tag::Unwatch(name()), Command::UnwatchTopic { topic: topic() }, "topics unwatch /robot1/odom".into()),
        (
            Tag::Grant(owner()),
            Command::Grant { grantee: owner(), topics: vec![topic()], epochs: Epochs::All, expires: Some(END) },
            format!("grant {OWNER} --topic /robot1/odom --epochs all --expires {END}"),
        ),
        (
            Tag::Extend(OWNER),
            Command::ExtendGrant { grantee: owner(), expires: None },
            format!("grants extend {OWNER} --endless"),
        ),
        (Tag::Revoke(OWNER), Command::Revoke { grantee: owner() }, format!("revoke {OWNER}")),
        (
            Tag::LoadKey(KeyKind::Eoa),
            Command::LoadKey { kind: KeyKind::Eoa, path: "/a key.json".into(), passphrase: Some(secret()) },
            "keys load --eoa '/a key.json' --keystore-passphrase-file FILE".into(),
        ),
        (
            Tag::ExportKey(KeyKind::Sm4),
            Command::ExportKey { kind: KeyKind::Sm4, passphrase: None },
            "keys export sm4 --out FILE".into(),
        ),
        (Tag::Rotate, Command::RotateKeys, "keys rotate".into()),
        (Tag::Lock, Command::Operate(Operation::Lock), "identity lock".into()),
        (Tag::BackUp, Command::Operate(Operation::BackUpKeys), "keys backup --out FILE".into()),
        (
            Tag::PrepareUnattended,
            PrepareUnattended { topics: vec![topic()], until: END }.into(),
            format!("unattended prepare --out FILE --topic /robot1/odom --until {END}"),
        ),
        (Tag::EndUnattended, EndUnattended { force: false }.into(), "unattended end".into()),
        (
            Tag::Administer("pause"),
            Command::Administer(Administration::Pause { paused: true, seconds: None }),
            "chain pause".into(),
        ),
        (
            Tag::Administer("suspend"),
            Command::Administer(Administration::Suspend { account: owner() }),
            format!("chain suspend {OWNER}"),
        ),
        (
            Tag::Administer("propose"),
            Command::Administer(Administration::Propose { lost: owner(), successor: owner() }),
            format!("chain succession propose {OWNER} {OWNER}"),
        ),
        (Tag::Deploy, Command::DeployContract { delay: None, revision: None }, "chain deploy".into()),
        (Tag::Adopt, Command::AdoptChain, "chain adopt".into()),
        (
            Tag::Pin(name()),
            Command::PinTopic { topic: topic(), publishers: Vec::new() },
            "topics pin /robot1/odom".into(),
        ),
        (
            Tag::Unpin(name()),
            Command::UnpinTopic { topic: topic(), caller_id: "/driver".to_owned() },
            "topics unpin /robot1/odom /driver".into(),
        ),
        (Tag::Release(name()), Command::ReleaseHeld { held: held() }, "quarantine release --topic /robot1/odom".into()),
        (
            Tag::Discard(name()),
            Command::DiscardHeld { held: held() },
            "quarantine discard --topic /robot1/odom --yes".into(),
        ),
        (
            Tag::Publishers(name()),
            Command::ListPins { topic: Some(topic()) },
            "topics pins --topic /robot1/odom".into(),
        ),
        (Tag::Show(id()), Command::ShowUpload { id: id() }, format!("uploads show {}", id())),
        (Tag::Open(id()), Command::OpenShared { id: id() }, format!("shared open {}", id())),
        (Tag::Check(id()), Command::CheckShared { id: id() }, format!("shared check {}", id())),
        (Tag::Export(id()), export(id()), format!("uploads export {} --dir DIR", id())),
        (
            Tag::Contact("bob".to_owned()),
            Command::AddContact { name: contact(), address: OWNER, fingerprint: None },
            format!("contacts add bob {OWNER}"),
        ),
        (Tag::Contact("bob".to_owned()), Command::RemoveContact { name: contact() }, "contacts remove bob".into()),
        (
            Tag::Incident(Deed::Open, incident()),
            open.into(),
            format!("incident open fall --since {END} --topic /robot1/odom --note='it'\\''s down'"),
        ),
        (
            Tag::Incident(Deed::Note, incident()),
            NoteIncident { name: incident(), text: "-5 degrees".to_owned() }.into(),
            "incident note fall -- '-5 degrees'".into(),
        ),
        (
            Tag::Incident(Deed::Close, incident()),
            CloseIncident { name: incident() }.into(),
            "incident close fall".into(),
        ),
        (
            Tag::Incident(Deed::Remove, incident()),
            RemoveIncident { name: incident() }.into(),
            "incident remove fall --yes".into(),
        ),
        (
            Tag::Play("/shared/bob/robot1/odom".to_owned()),
            Command::Play(play),
            format!("shared play --owner {OWNER} --topic /robot1/odom --prefix /shared/bob --follow"),
        ),
    ]
}

/// The words of a line, as a shell divides it.
fn words(line: &str) -> Vec<String> {
    let script = format!("set -- {line}; printf '%s\\n' \"$@\"");
    let output = Program::new("sh").args(["-c", &script]).output().expect("a shell");
    String::from_utf8(output.stdout).expect("text").lines().map(str::to_owned).collect()
}

#[test]
fn every_act_of_the_console_has_the_line_that_a_person_would_type() {
    let state = State::new(Settings::default());
    let mut walked = [false; ACTS];
    for (tag, command, expected) in acts() {
        walked[place(&tag).expect("an act")] = true;
        let line = command_line::twin(&state, &Errand { command, tag: tag.clone() });
        let line = line.unwrap_or_else(|| panic!("{tag:?} has no command line"));
        assert_eq!(line, format!("authros {expected}"), "{tag:?}");
        assert!(!line.contains("never on a line"), "{line}");
        let parsed = Arguments::try_parse_from(words(&line));
        assert!(parsed.is_ok(), "{line}: {}", parsed.expect_err("wrong"));
    }
    let missing: Vec<usize> = (0..ACTS).filter(|act| !walked[*act]).collect();
    assert!(missing.is_empty(), "acts that the walk leaves out: {missing:?}");
}

#[test]
fn what_is_no_act_has_none_and_another_profile_is_named() {
    let state = State::new(Settings { profile: "bob".parse().expect("a name"), ..Settings::default() });
    let hold = Errand { command: Command::Operate(Operation::HoldCapture { hold: true }), tag: Tag::HoldCapture };
    assert_eq!(command_line::twin(&state, &hold), None);
    let rotate = Errand { command: Command::RotateKeys, tag: Tag::Rotate };
    assert_eq!(command_line::twin(&state, &rotate).as_deref(), Some("authros --profile bob keys rotate"));
}
