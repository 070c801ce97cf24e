//! Every form accepts its own placeholders: each suggested text goes through the form, the question and the site's own
//! parser.

use super::{Robot, fixtures};
use crate::app::acts::perform;
use crate::app::{Action, Effect, Form, Input, Key, Popup, Purpose, Tag, Verb};
use crate::model::{Scope, Timestamp};
use crate::screens::chain::state::Act;
use crate::service::Command;
use authros_chain::Call;

/// Parts of placeholders that describe the input, with an example that fits; any other part is taken literally.
const DESCRIBED: &[(&str, &[&str])] = &[
    ("0x and 40 hex", &["0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed"]),
    ("or a contact's name", &["harbour-office"]),
    ("what happened", &["hit the wall"]),
    ("what is known now", &["the bumper was off"]),
    ("topic names", &["/robot1/odom", "/robot1/odom /robot2/camera", "/robot1/odom,/robot2/camera"]),
    ("caller id", &["/driver"]),
    ("name of a profile in this home", &["bob"]),
    ("path to the key file (must be mode 0600)", &["keys/mine.pem", "/keys/mine.pem", "~/mine.pem"]),
    ("only for a V3 keystore", &["", "a passphrase"]),
    ("EOA: protects the V3 keystore", &["eight ch"]),
    ("at least 8 characters", &["eight ch"]),
    ("name of a robot", &["scout"]),
    ("name of an incident", &["bump"]),
    ("topics or patterns", &["/robot1/odom", "/robot*/odom", "/robot1/odom,/robot?/*"]),
    ("path to a TOML file", &["policies/scout.toml", "/policies/scout.toml", "~/scout.toml"]),
];

/// Lines without a placeholder.
const UNTOLD: &str = "eight ch";

/// The inputs that a placeholder suggests.
fn suggested(hint: &str) -> Vec<String> {
    let mut texts = Vec::new();
    for part in hint.split([';', ',']).map(str::trim).filter(|part| !part.is_empty()) {
        if let Some((_, fitting)) = DESCRIBED.iter().find(|(described, _)| *described == part) {
            texts.extend(fitting.iter().map(|text| (*text).to_owned()));
        } else if part.starts_with("empty = ") {
            texts.push(String::new());
        } else {
            texts.push(part.strip_prefix("such as ").unwrap_or(part).to_owned());
        }
    }
    if texts.is_empty() { vec![UNTOLD.to_owned()] } else { texts }
}

/// Every purpose of a form; a new one does not compile until it is here.
fn purposes() -> Vec<Purpose> {
    use Purpose as P;
    let follows = |purpose: P| match purpose {
        P::CreateIdentity => Some(P::Unlock),
        P::Unlock => Some(P::Grant),
        P::Grant => Some(P::Extend),
        P::Extend => Some(P::LoadKey),
        P::LoadKey => Some(P::ExportKey),
        P::ExportKey => Some(P::Export),
        P::Export => Some(P::Unpin),
        P::Unpin => Some(P::AddContact),
        P::AddContact => Some(P::OpenIncident),
        P::OpenIncident => Some(P::NoteIncident),
        P::NoteIncident => Some(P::ExportEvidence),
        P::ExportEvidence => Some(P::SetPolicy),
        P::SetPolicy => Some(P::Limit),
        P::Limit => Some(P::Profile),
        P::Profile => Some(P::Administer(Act::Admit)),
        P::Administer(Act::Admit) => Some(P::Administer(Act::Suspend)),
        P::Administer(Act::Suspend) => Some(P::Administer(Act::Restore)),
        P::Administer(Act::Restore) => Some(P::Administer(Act::Propose)),
        P::Administer(Act::Propose) => Some(P::Administer(Act::Dismiss)),
        P::Administer(Act::Dismiss) => Some(P::Administer(Act::HandOver)),
        // These ask a question and have no form.
        P::Administer(
            Act::HandOver | Act::Open | Act::Close | Act::Pause | Act::Continue | Act::Accept | Act::Deploy,
        ) => None,
    };
    std::iter::successors(Some(P::CreateIdentity), |purpose| follows(*purpose)).collect()
}

/// A console with the form of this purpose open, at a moment that is not a whole second.
fn asked(purpose: Purpose) -> Robot {
    let exists = purpose != Purpose::CreateIdentity;
    let mut robot = Robot::at_work(exists);
    robot.state.now = Timestamp(fixtures::NOW.0 + 39_050_923);
    let opens = |verb: Verb, screen: &str| (verb, screen.to_owned());
    let (verb, screen) = match purpose {
        Purpose::CreateIdentity => opens(Verb::CreateIdentity, "6"),
        Purpose::Unlock => {
            robot.state.identity = Some(fixtures::identity(true, false, true));
            opens(Verb::Unlock, "6")
        }
        Purpose::Grant => opens(Verb::Grant, "5"),
        Purpose::Extend => opens(Verb::Extend, "5"),
        Purpose::AddContact => opens(Verb::Contacts, "5"),
        Purpose::OpenIncident => opens(Verb::Incident, "2"),
        Purpose::NoteIncident | Purpose::ExportEvidence => opens(Verb::Incidents, "3"),
        Purpose::SetPolicy => {
            fixtures::robots::at_the_gateway(&mut robot);
            opens(Verb::SetPolicy, "8")
        }
        Purpose::Profile => opens(Verb::Profile, "1"),
        Purpose::LoadKey => opens(Verb::LoadKey, "6"),
        Purpose::ExportKey => opens(Verb::ExportKey, "6"),
        Purpose::Export => opens(Verb::Export, "3"),
        Purpose::Unpin => opens(Verb::Unpin, "2"),
        Purpose::Limit => opens(Verb::Limit, "2"),
        Purpose::Administer(act) => opens(Verb::Administer(act), "7"),
    };
    robot.types(&screen);
    robot.site_answers(exists);
    if purpose == Purpose::Extend {
        let end = Timestamp(fixtures::NOW.0 + 60_000_000_000);
        robot.state.grants.rows.iter_mut().for_each(|row| row.expires = Some(end));
    } else {
        robot.presses(Key::Down);
    }
    if purpose == Purpose::Limit {
        robot.state.topics.rows.iter_mut().for_each(|row| row.watched = true);
    }
    if let (Purpose::Administer(_), Some(chain)) = (purpose, &mut robot.state.chain) {
        chain.administration.administrator = Some(fixtures::OWN);
    }
    perform(&mut robot.state, verb);
    let effects = std::mem::take(&mut robot.state.effects);
    robot.note(effects);
    match purpose {
        Purpose::AddContact => robot.types("n"),
        Purpose::NoteIncident => {
            let rows = vec![fixtures::incident("bump", true)];
            robot.state.incidents.set(rows, fixtures::NOW);
            robot.types("a");
        }
        Purpose::ExportEvidence => {
            robot.state.incidents.set(vec![fixtures::incident("bump", true)], fixtures::NOW);
            robot.types("e");
        }
        _ => {}
    }
    let opened = matches!(robot.state.popups.last(), Some(Popup::Form(open, _)) if *open == purpose);
    assert!(opened, "{purpose:?}: {}", robot.message());
    robot
}

fn form(robot: &Robot) -> &Form {
    match robot.state.popups.last() {
        Some(Popup::Form(_, form)) => form,
        other => panic!("no form, but {other:?}"),
    }
}

/// Fills in the form and submits it; `odd` is the line that gets another of its suggestions than the first, and
/// `chosen` the word chosen in every choice.
fn fills_in(robot: &mut Robot, odd: (usize, usize), chosen: usize) {
    while form(robot).focus > 0 {
        robot.presses(Key::Up);
    }
    for line in 0..form(robot).lines.len() {
        if let Input::Choice { .. } = form(robot).lines[line].input {
            (0..chosen).for_each(|_| robot.presses(Key::Right));
        } else {
            let texts = suggested(form(robot).lines[line].hint);
            robot.presses(Key::Control('u'));
            robot.pastes(&texts[if line == odd.0 { odd.1 } else { 0 }]);
        }
        robot.presses(Key::Enter);
    }
}

/// Says yes to the question, if there is one; a file that it is about is read first.
fn agrees(robot: &mut Robot) {
    if let Some(Effect::ReadText(path)) = robot.effects.pop() {
        robot.act(Action::TextRead(path, Ok("[[watch]]\ntopic = \"/odom\"\n".to_owned())));
    }
    let Some(Popup::Confirm(confirm)) = robot.state.popups.last() else { return };
    match confirm.typed.as_ref().map(|typed| typed.wanted.clone()) {
        Some(word) => {
            robot.pastes(&word);
            robot.presses(Key::Enter);
        }
        None => robot.types("y"),
    }
}

/// How the site parses it before anything is sent.
fn is_taken_by_the_site(command: &Command, what: &str) {
    if let Command::Grant { expires, .. } = command {
        let (grantee, scope) = (fixtures::OTHER, Scope::All);
        let call = Call::AuthorityGrant { grantee, epoch: 1, expiry: *expires, scope, envelope: vec![1] };
        call.encode().unwrap_or_else(|error| panic!("{what}: {error}"));
    }
}

#[test]
fn no_form_and_no_site_refuses_what_a_placeholder_suggests() {
    let mut driven = 0;
    for purpose in purposes() {
        let shape: Vec<(usize, usize)> = {
            let robot = asked(purpose);
            let lines = form(&robot).lines.iter().enumerate();
            lines
                .flat_map(|(number, line)| match &line.input {
                    Input::Text(_) => (0..suggested(line.hint).len()).map(|text| (number, text)).collect(),
                    Input::Choice { options, .. } => {
                        (0..options.len()).map(|word| (number, word)).collect::<Vec<(usize, usize)>>()
                    }
                })
                .collect()
        };
        for odd in shape {
            let mut robot = asked(purpose);
            let choice = matches!(form(&robot).lines[odd.0].input, Input::Choice { .. });
            let what = format!("{purpose:?}, line {}, text {}", form(&robot).lines[odd.0].label, odd.1);
            fills_in(&mut robot, odd, if choice { odd.1 } else { 0 });
            assert_eq!(robot.form_error(), None, "{what}");
            agrees(&mut robot);
            let work = robot.work();
            // Another profile is spoken for without any request to the site but the console's own.
            assert!(
                purpose == Purpose::Profile || !work.is_empty(),
                "{what}: nothing was sent; {:?}",
                robot.state.popups
            );
            assert!(!work.contains(&Tag::Register), "{what}");
            let (command, _) = robot.sent.last().expect("sent");
            is_taken_by_the_site(command, &what);
            driven += 1;
        }
    }
    assert!(driven > 30, "{driven}");
}

#[test]
fn relative_ends_leave_the_console_as_whole_seconds() {
    for text in ["30d", "12h"] {
        let mut robot = asked(Purpose::Grant);
        while form(&robot).focus > 0 {
            robot.presses(Key::Up);
        }
        robot.pastes("harbour-office");
        robot.presses(Key::Enter);
        robot.pastes("all");
        robot.presses(Key::Enter);
        robot.pastes(text);
        robot.presses(Key::Enter);
        robot.presses(Key::Enter);
        robot.types("y");
        let (command, _) = robot.sent.last().expect("sent");
        let Command::Grant { expires: Some(end), .. } = command else { panic!("{command:?}") };
        assert_eq!(end.to_whole_second(), *end, "{text}");
    }
}
