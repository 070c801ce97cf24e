//! Every act that the console sends shows its command line: a walk through all of them, each line split by a shell and
//! read by the program's own arguments.

use std::process::Command as Program;

use clap::Parser as _;

use crate::app::{Errand, Settings, State, Tag};
use crate::cli::args::Arguments;
use crate::model::{Address, IncidentName, Party, Sampling, Timestamp, TopicName};
use crate::popups::incidents::state::Deed;
use crate::service::command::{
    Administration, CloseIncident, EvidenceWishes, ExportEvidence, Held, NoteIncident, OpenIncident, Pace, PlayWishes,
    RemoveIncident, SetRobotPolicy, ShowRobot,
};
use crate::service::{Command, GrantFrom, KeyKind, SecretText};

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
        // Asked for a question that is open.
        Tag::Foresee(_) => return None,
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
        Tag::Administer(_) => 13,
        Tag::Deploy => 14,
        Tag::Pin(_) => 15,
        Tag::Unpin(_) => 16,
        Tag::Release(_) => 17,
        Tag::Discard(_) => 18,
        Tag::Publishers(_) => 19,
        Tag::Show(_) => 20,
        Tag::Open(_) => 21,
        Tag::Check(_) => 22,
        Tag::Export(_) => 23,
        Tag::Contact(_) => 24,
        Tag::Incident(..) => 25,
        Tag::Play(_) => 26,
        Tag::Robot(_) => 27,
        Tag::SetPolicy(..) => 28,
        Tag::Evidence(_) => 29,
        Tag::Limit(_) => 30,
    })
}

const ACTS: usize = 31;

/// An act, and the line that a person would type for it.
type Act = (Tag, Command, String);

fn topic() -> TopicName {
    "/robot1/odom".parse().expect("a topic")
}

fn name() -> String {
    topic().to_string()
}

fn owner() -> Party {
    Party::Address(OWNER)
}

fn secret() -> SecretText {
    SecretText::new("never on a line".to_owned())
}

fn acts_of_keys() -> Vec<Act> {
    let keystore = Command::LoadKey { kind: KeyKind::Eoa, path: "/a key.json".into(), passphrase: Some(secret()) };
    let export = Command::ExportKey { kind: KeyKind::Sm4, passphrase: None };
    vec![
        (Tag::CreateIdentity, Command::CreateIdentity { passphrase: secret() }, "identity create".into()),
        (Tag::Unlock, Command::Unlock { passphrase: secret() }, "keys list --passphrase-file FILE".into()),
        (Tag::Register, Command::Register, "identity register".into()),
        (Tag::LoadKey(KeyKind::Eoa), keystore, "keys load --eoa '/a key.json' --keystore-passphrase-file FILE".into()),
        (Tag::ExportKey(KeyKind::Sm4), export, "keys export sm4 --out FILE".into()),
        (Tag::Rotate, Command::RotateKeys, "keys rotate".into()),
        (Tag::Lock, Command::Lock, "keys lock".into()),
        (Tag::BackUp, Command::BackUpKeys, "keys backup --out FILE".into()),
    ]
}

fn acts_of_topics() -> Vec<Act> {
    let held = || Held { topic: Some(topic().into()), ids: Vec::new() };
    let pin = Command::PinTopic { topic: topic().into(), publishers: Vec::new() };
    let unpin = Command::UnpinTopic { topic: topic().into(), caller_id: "/driver".to_owned() };
    let watch = Command::WatchTopic { topic: topic().into(), type_name: None, sampling: None };
    let (type_name, sampling) = ("nav_msgs/Odometry".parse().ok(), Sampling { rate: Some(2_500), every: Some(10) });
    let limit = Command::WatchTopic { topic: topic().into(), type_name, sampling: Some(sampling) };
    let line = |words: &str| format!("{words} /robot1/odom");
    vec![
        (Tag::Watch(name()), watch, line("topics watch")),
        (Tag::Limit(name()), limit, line("topics watch") + " --type nav_msgs/Odometry --rate 2.5 --every 10"),
        (Tag::Unwatch(name()), Command::UnwatchTopic { topic: topic().into() }, line("topics unwatch")),
        (Tag::Pin(name()), pin, line("topics pin")),
        (Tag::Unpin(name()), unpin, line("topics unpin") + " /driver"),
        (Tag::Release(name()), Command::ReleaseHeld { held: held() }, line("topics quarantine release --topic")),
        (
            Tag::Discard(name()),
            Command::DiscardHeld { held: held() },
            line("topics quarantine discard --topic") + " --yes",
        ),
        (Tag::Publishers(name()), Command::ListPins { topic: Some(topic().into()) }, line("topics pins --topic")),
    ]
}

fn acts_of_rights() -> Vec<Act> {
    let (topics, from) = (vec![topic().into()], GrantFrom::Epoch(1));
    let robots = vec!["scout-1".to_owned()];
    let grant = Command::Grant { grantee: owner(), topics, robots, from, expires: Some(END) };
    let of_administrator = |word: &'static str, act: Administration, line: String| {
        (Tag::Administer(word), Command::Administer(act), format!("chain {line}"))
    };
    let propose = Administration::Propose { lost: owner(), successor: owner() };
    let contact = || "bob".parse().expect("a name");
    let add = Command::AddContact { name: contact(), address: OWNER, fingerprint: None };
    let remove = Command::RemoveContact { name: contact() };
    let extend = Command::ExtendGrant { grantee: owner(), expires: None };
    vec![
        (
            Tag::Grant(owner()),
            grant,
            format!("grant add {OWNER} --topic /robot1/odom --robot scout-1 --from start --expires {END}"),
        ),
        (Tag::Extend(OWNER), extend, format!("grant extend {OWNER} --endless")),
        (Tag::Revoke(OWNER), Command::Revoke { grantee: owner() }, format!("grant end {OWNER}")),
        of_administrator("pause", Administration::Pause { paused: true, seconds: None }, "admin pause".to_owned()),
        of_administrator("suspend", Administration::Suspend { account: owner() }, format!("admin suspend {OWNER}")),
        of_administrator("propose", propose, format!("succession propose {OWNER} {OWNER}")),
        (Tag::Deploy, Command::DeployContract { delay: None }, "chain deploy".into()),
        (Tag::Contact("bob".to_owned()), add, format!("contacts add bob {OWNER}")),
        (Tag::Contact("bob".to_owned()), remove, "contacts remove bob".into()),
    ]
}

fn acts_of_records() -> Vec<Act> {
    let id = || "0123456789abcdef".to_owned();
    let play = PlayWishes {
        owner: Some(owner()),
        topics: vec!["/robot1/odom".parse().expect("a pattern")],
        pace: Pace::Follow,
        prefix: Some("/shared/bob".parse().expect("a name")),
        ..PlayWishes::default()
    };
    let export = Command::ExportUpload { id: id(), addresses: false };
    vec![
        (Tag::Show(id()), Command::ShowUpload { id: id() }, format!("records show {}", id())),
        (Tag::Open(id()), Command::OpenShared { id: id() }, format!("records open {}", id())),
        (Tag::Check(id()), Command::CheckShared { id: id() }, format!("records check {}", id())),
        (Tag::Export(id()), export, format!("records export {} --dir DIR", id())),
        (
            Tag::Play("/shared/bob/robot1/odom".to_owned()),
            Command::Play(play),
            format!("received play --owner {OWNER} --topic /robot1/odom --prefix /shared/bob --follow"),
        ),
    ]
}

fn acts_of_incidents() -> Vec<Act> {
    let incident = || -> IncidentName { "fall".parse().expect("a name") };
    let of = |deed: Deed, command: Command, line: &str| (Tag::Incident(deed, incident()), command, line.to_owned());
    let open = OpenIncident {
        name: incident(),
        since: END,
        until: None,
        topics: vec![topic().into()],
        note: Some("it's down".to_owned()),
        robots: Vec::new(),
    };
    let opened = format!("incident open fall --since {END} --topic /robot1/odom --note='it'\\''s down'");
    let evidence = EvidenceWishes {
        file: "/case/fall.authros".into(),
        incident: Some(incident()),
        reveal_topics: vec!["/robot1/*".parse().expect("a pattern")],
        sure: true,
        ..EvidenceWishes::default()
    };
    let exported = "evidence export /case/fall.authros --incident fall --reveal-topic '/robot1/*' --yes";
    let note = NoteIncident { name: incident(), text: "-5 degrees".to_owned() };
    vec![
        of(Deed::Open, open.into(), &opened),
        of(Deed::Note, note.into(), "incident note fall -- '-5 degrees'"),
        of(Deed::Close, CloseIncident { name: incident() }.into(), "incident close fall"),
        of(Deed::Remove, RemoveIncident { name: incident() }.into(), "incident remove fall --yes"),
        (Tag::Evidence(incident()), ExportEvidence(evidence).into(), exported.to_owned()),
    ]
}

fn acts_of_robots() -> Vec<Act> {
    let set = |text: &str| SetRobotPolicy { name: "scout".to_owned(), text: text.to_owned() }.into();
    let show = ShowRobot { name: "scout".to_owned() };
    let file = Some("/home/op/scout's.toml".into());
    vec![
        (Tag::Robot("scout".to_owned()), show.into(), "robot show scout".to_owned()),
        (
            Tag::SetPolicy("scout".to_owned(), file),
            set("[ring]\n"),
            "robot policy scout --set '/home/op/scout'\\''s.toml'".to_owned(),
        ),
        (Tag::SetPolicy("scout".to_owned(), None), set(""), "robot policy scout --clear".to_owned()),
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
    let all = [acts_of_keys(), acts_of_topics(), acts_of_rights(), acts_of_records()];
    for (tag, command, expected) in [all.concat(), acts_of_incidents(), acts_of_robots()].concat() {
        walked[place(&tag).expect("an act")] = true;
        let line = state.twin(&Errand { command, tag: tag.clone() });
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
    let hold = Errand { command: Command::HoldCapture { hold: true }, tag: Tag::HoldCapture };
    assert_eq!(state.twin(&hold), None);
    let rotate = Errand { command: Command::RotateKeys, tag: Tag::Rotate };
    assert_eq!(state.twin(&rotate).as_deref(), Some("authros --profile bob keys rotate"));
}
