//! Switching to another profile: nothing of the previous one is shown as the current one's.

use super::{Robot, fixtures};
use crate::app::{Action, Effect, Feed, Key, Tag};
use crate::model::ErrorKind;
use crate::service::Reply;

#[test]
fn the_palette_goes_over_and_late_answers_of_the_former_profile_are_dropped() {
    let mut robot = Robot::at_work(true);
    robot.types("4");
    robot.site_answers(true);
    robot.presses(Key::Enter);
    let (_, opening) = robot.sent.last().expect("a record is being opened").clone();
    robot.state.feeds.renew(Feed::Identity);
    robot.act(Action::Resize { columns: 80, rows: 30 });
    let late: Vec<Tag> = robot.sent.iter().map(|(_, tag)| tag.clone()).collect();
    assert!(late.iter().any(|tag| matches!(tag, Tag::Feed(Feed::Identity, _))));
    robot.presses(Key::Escape);
    robot.sent.clear();

    robot.types(":profile bob");
    robot.presses(Key::Enter);
    assert!(
        robot.effects.iter().any(|effect| matches!(effect, Effect::SpeakFor(profile) if profile.as_str() == "bob"))
    );
    assert_eq!(robot.state.settings.profile.as_str(), "bob");
    assert!(robot.sent.iter().any(|(_, tag)| *tag == Tag::OpenConsole), "the other profile is claimed");
    for tag in late {
        let result = Ok(Reply::Identity(fixtures::identity(true, true, true)));
        robot.act(Action::Answered { tag, result: Box::new(result) });
    }
    robot.act(Action::Answered { tag: opening, result: Box::new(Ok(Reply::Done)) });
    assert!(robot.state.identity.is_none(), "that was the other one's");
    robot.site_answers(true);
    assert!(robot.state.identity.is_some());
}

#[test]
fn it_stays_while_something_is_being_done() {
    let mut robot = Robot::at_work(true);
    robot.types("6ry");
    assert_eq!(robot.work(), [Tag::Rotate]);
    robot.types(":profile bob");
    robot.presses(Key::Enter);
    assert_eq!(robot.state.settings.profile.as_str(), "default");
    assert!(robot.message().contains("still running"), "{}", robot.message());
}

#[test]
fn a_profile_that_is_open_elsewhere_leads_back_to_the_former_one() {
    let mut robot = Robot::at_work(true);
    robot.types(":profile bob");
    robot.presses(Key::Enter);
    robot.is_answered(
        &Tag::OpenConsole,
        Err(fixtures::failure(ErrorKind::Home, "a console of profile 'bob' is open already")),
    );
    assert_eq!(robot.state.settings.profile.as_str(), "default");
    assert!(!robot.effects.iter().any(|effect| matches!(effect, Effect::Leave(_))), "nobody is thrown out");
    robot.site_answers(true);
    assert!(robot.state.identity.is_some());
}
