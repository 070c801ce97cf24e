//! A new profile: the first steps, and the passphrase asked twice.

use super::{Robot, fixtures};
use crate::app::{Effect, Feed, Key, Popup, Purpose, Settings, State, Tag};
use crate::model::ErrorKind;
use crate::screens::overview::first_steps;
use crate::service::reply::{HealthLevel, PartHealth};
use crate::service::{Command, Reply};

fn passphrase_twice(robot: &mut Robot, once: &str, again: &str) {
    robot.types(once);
    robot.presses(Key::Enter);
    robot.types(again);
    robot.presses(Key::Enter);
}

#[test]
fn the_console_claims_the_profile_and_asks_for_what_it_shows() {
    let robot = Robot::opens(Settings::default());
    let sent: Vec<&Command> = robot.sent.iter().map(|(command, _)| command).collect();
    assert!(matches!(
        sent[..],
        [Command::OpenConsole, Command::SiteStatus, Command::ShowIdentity, Command::ListTopics]
    ));
}

#[test]
fn a_profile_open_elsewhere_ends_the_console_with_the_reason() {
    let mut robot = Robot::opens(Settings::default());
    robot.is_answered(&Tag::OpenConsole, Err(fixtures::failure(ErrorKind::Refused, "open in process 4711")));
    assert!(matches!(&robot.effects[..], [Effect::Leave(failure)] if failure.message.contains("4711")));
}

#[test]
fn the_first_steps_lead_through_until_all_are_done() {
    let mut robot = Robot::at_work(false);
    assert_eq!(first_steps(&robot.state).iter().map(|step| step.done).collect::<Vec<_>>(), [false, false, true, false]);
    robot.hears_of(crate::service::Part::Identity);
    robot.site_answers(true);
    robot.types("5");
    robot.site_answers(true);
    assert!(first_steps(&robot.state).is_empty());
}

#[test]
fn a_worker_of_a_gateway_is_led_to_its_own_steps() {
    let mut robot = Robot::at_work(false);
    let mut site = fixtures::site();
    site.health.push(PartHealth::new("lease", HealthLevel::Ok, "held here, 1 worker"));
    robot.state.site = Some(site.clone());
    let names = |robot: &Robot| first_steps(&robot.state).iter().map(|step| step.name).collect::<Vec<_>>();
    assert_eq!(names(&robot), ["identity", "gateway"]);
    site.health.iter_mut().filter(|part| part.part == "gateway").for_each(|part| part.level = HealthLevel::Ok);
    robot.state.site = Some(site);
    robot.state.identity = Some(fixtures::identity(true, true, true));
    assert!(names(&robot).is_empty(), "it serves");
}

#[test]
fn n_asks_for_a_passphrase_twice_then_creates_and_registers() {
    let mut robot = Robot::at_work(false);
    robot.types("n");
    passphrase_twice(&mut robot, "correct horse", "correct horse");
    let (command, _) = robot.sent.last().expect("sent");
    assert!(matches!(command, Command::CreateIdentity { passphrase } if passphrase.expose() == "correct horse"));
    assert!(robot.state.popups.is_empty());
    robot.is_answered(&Tag::CreateIdentity, Ok(Reply::Identity(fixtures::identity(true, true, false))));
    assert_eq!(robot.work(), [Tag::Register]);
    robot.is_answered(&Tag::Register, Ok(Reply::Identity(fixtures::identity(true, true, true))));
    assert!(robot.work().is_empty() && robot.state.identity_path.is_none());
}

#[test]
fn a_short_or_mistyped_passphrase_is_refused_in_the_form() {
    let mut robot = Robot::at_work(false);
    robot.types("n");
    passphrase_twice(&mut robot, "short", "short");
    assert_eq!(robot.form_error(), Some("use at least 8 characters"));
    robot.types("er one");
    robot.presses(Key::Tab);
    robot.presses(Key::Enter);
    assert!(robot.form_error().is_some_and(|error| error.contains("do not match")));
    assert!(robot.work().is_empty());
}

#[test]
fn an_older_answer_cannot_undo_a_new_identity() {
    let mut robot = Robot::at_work(false);
    robot.hears_of(crate::service::Part::Identity);
    let old = Tag::Feed(Feed::Identity, robot.state.feeds.slot(Feed::Identity).generation);
    robot.types("n");
    passphrase_twice(&mut robot, "correct horse", "correct horse");
    robot.is_answered(&Tag::CreateIdentity, Ok(Reply::Identity(fixtures::identity(true, true, false))));
    robot.is_answered(&old, Ok(Reply::Identity(fixtures::identity(false, false, false))));
    assert!(robot.state.identity.as_ref().is_some_and(|identity| identity.exists));
    assert!(robot.state.popups.is_empty());
}

#[test]
fn a_wrong_passphrase_is_asked_again_with_the_reason() {
    let mut robot = Robot::at_work(false);
    robot.state.identity = Some(fixtures::identity(true, false, true));
    robot.types("u");
    robot.types("wrong");
    robot.presses(Key::Enter);
    robot.is_answered(&Tag::Unlock, Err(fixtures::failure(ErrorKind::Refused, "does not open the keyring")));
    assert_eq!(robot.form_error(), Some("does not open the keyring"));
    assert!(matches!(robot.state.popups[..], [Popup::Form(Purpose::Unlock, _)]));
}

#[test]
fn no_secret_is_in_what_debug_prints() {
    let mut robot = Robot::at_work(false);
    robot.types("n");
    robot.types("secret words");
    let shown = |state: &State| format!("{state:?}");
    assert!(!shown(&robot.state).contains("secret words"));
}
