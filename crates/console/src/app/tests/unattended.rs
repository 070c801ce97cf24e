//! Unattended capture: its form writes a file, its end is asked about, and how it stands is seen.

use super::{Robot, fixtures};
use crate::app::perform::perform;
use crate::app::popup::Popup;
use crate::app::{Effect, Key, Tag, Verb, unattended};
use crate::model::{SignerId, Timestamp};
use crate::service::command::{SecretBytes, UnattendedCommand};
use crate::service::reply::{UnattendedFile, UnattendedState, UnattendedView};
use crate::service::{Command, Reply};

fn does(robot: &mut Robot, verb: Verb) {
    let effects = perform(&mut robot.state, verb);
    robot.note(effects);
}

#[test]
fn a_credential_is_asked_for_with_its_end_and_becomes_a_file() {
    let mut robot = Robot::at_work(true);
    robot.state.settings.directory = "/home/operator".into();
    does(&mut robot, Verb::PrepareUnattended);
    robot.pastes("/robot1/odom, /robot2/odom");
    robot.presses(Key::Enter);
    robot.presses(Key::Control('u'));
    for _ in 0..2 {
        robot.presses(Key::Enter);
    }
    assert!(robot.form_error().is_some_and(|error| error.contains("needs an end")), "{:?}", robot.form_error());
    robot.pastes("12h");
    robot.presses(Key::Enter);
    robot.pastes("creds");
    robot.presses(Key::Enter);
    let (command, _) = robot.sent.last().expect("sent");
    let Command::OfUnattended(UnattendedCommand::PrepareUnattended { topics, until }) = command else {
        panic!("{command:?}")
    };
    assert_eq!(topics.len(), 2);
    assert_eq!(until.seconds(), fixtures::NOW.end_after(std::time::Duration::from_secs(43_200)).seconds());
    let file = UnattendedFile {
        device: SignerId([7; 32]),
        account: fixtures::OTHER,
        topics: vec!["/robot1/odom".to_owned()],
        until: *until,
        file: SecretBytes::new(vec![7; 16]),
    };
    robot.is_answered(&Tag::PrepareUnattended, Ok(Reply::UnattendedPrepared(file)));
    let Some(Effect::WriteFiles { base, files, .. }) = robot.effects.last() else { panic!("nothing written") };
    assert_eq!(base.as_deref(), Some(std::path::Path::new("/home/operator/creds")));
    assert!(files[0].name.ends_with(".unattended") && files[0].bytes.len() == 16);
}

#[test]
fn its_end_is_asked_about_and_any_other_key_keeps_it() {
    let mut robot = Robot::at_work(true);
    does(&mut robot, Verb::EndUnattended);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Confirm(confirm)) if confirm.title.contains("unattended")));
    robot.types("n");
    assert!(!robot.work().contains(&Tag::EndUnattended));
    does(&mut robot, Verb::EndUnattended);
    robot.types("y");
    assert_eq!(robot.work().last(), Some(&Tag::EndUnattended));
}

#[test]
fn a_badge_and_a_line_say_until_when_capture_can_go_on() {
    let mut robot = Robot::at_work(true);
    assert_eq!(unattended::badge(&robot.state, true), None);
    let mut view = UnattendedView {
        state: UnattendedState::Capturing,
        profile: "alice".parse().expect("a name"),
        device: SignerId([7; 32]),
        account: fixtures::OTHER,
        topics: Vec::new(),
        until: Some(Timestamp::from_seconds(1_700_000_000)),
        why: None,
    };
    robot.state.site.as_mut().expect("a site").unattended = Some(view.clone());
    assert_eq!(unattended::badge(&robot.state, true).as_deref(), Some(" UNATTENDED until 2023-11-14 22:13 "));
    assert_eq!(unattended::badge(&robot.state, false).as_deref(), Some(" UNATTENDED "));
    assert_eq!(unattended::line(&view), "capturing until 2023-11-14 22:13 UTC");
    (view.state, view.until, view.why) = (UnattendedState::Ended, None, Some("recalled".to_owned()));
    assert_eq!(unattended::line(&view), "ended: recalled");
    robot.state.site.as_mut().expect("a site").unattended = Some(view);
    assert_eq!(unattended::badge(&robot.state, true), None);
}
