//! Watching topics: marks, the way through the identity, and back.

use super::{Robot, fixtures};
use crate::app::{Feed, Key, Popup, Purpose, Tag};
use crate::model::{ErrorKind, Sampling};
use crate::service::{Command, Part, Reply};

fn at_topics(exists: bool) -> Robot {
    let mut robot = Robot::at_work(exists);
    robot.types("2");
    robot.site_answers(exists);
    robot
}

/// The robot with the cursor on the row of that topic.
fn on(mut robot: Robot, topic: &str) -> Robot {
    robot.types(&format!("/{topic}"));
    robot.presses(Key::Enter);
    robot
}

#[test]
fn w_watches_the_topic_under_the_cursor() {
    let mut robot = on(at_topics(true), "robot2");
    robot.types("w");
    assert_eq!(robot.work(), [Tag::Watch("/robot2/odom".into())]);
    robot.is_answered(&Tag::Watch("/robot2/odom".into()), Ok(Reply::Done));
    assert_eq!(robot.message(), "now watching /robot2/odom");
}

#[test]
fn w_on_a_watched_topic_unwatches_it() {
    let mut robot = on(at_topics(true), "/robot1/odom");
    robot.types("w");
    assert_eq!(robot.work(), [Tag::Unwatch("/robot1/odom".into())]);
}

#[test]
fn marked_topics_are_watched_together_and_the_watched_ones_left_alone() {
    let mut robot = on(at_topics(true), "robot");
    robot.types("a");
    assert_eq!(robot.state.topics.table.marks.len(), 3);
    robot.types("w");
    let wanted = ["/robot1/camera/compressed", "/robot2/odom"].map(|topic| Tag::Watch(topic.into()));
    assert_eq!(robot.work(), wanted);
    assert!(!robot.state.topics.table.marks.is_empty(), "marks stay for the next act");
}

#[test]
fn without_an_identity_the_way_leads_through_making_one_and_goes_on() {
    let mut robot = on(at_topics(false), "robot2");
    robot.types("w");
    assert!(
        matches!(&robot.state.popups[..], [Popup::Form(Purpose::CreateIdentity, form)] if form.notes[1].contains("/robot2/odom"))
    );
    robot.types("correct horse");
    robot.presses(Key::Tab);
    robot.types("correct horse");
    robot.presses(Key::Enter);
    robot.is_answered(&Tag::CreateIdentity, Ok(Reply::Identity(fixtures::identity(true, true, false))));
    robot.is_answered(&Tag::Register, Ok(Reply::Identity(fixtures::identity(true, true, true))));
    assert_eq!(robot.work(), [Tag::Watch("/robot2/odom".into())]);
}

#[test]
fn a_locked_keyring_is_unlocked_first() {
    let mut robot = on(at_topics(true), "robot2");
    robot.state.identity = Some(fixtures::identity(true, false, true));
    robot.types("w");
    robot.types("passphrase");
    robot.presses(Key::Enter);
    assert_eq!(robot.work(), [Tag::Unlock], "waits until the identity is known to be unlocked");
    robot.is_answered(&Tag::Unlock, Ok(Reply::Done));
    assert_eq!(robot.work(), [], "an answer to something else opens nothing");
    robot.types("passphrase");
    robot.presses(Key::Enter);
    robot.is_answered(&Tag::Unlock, Ok(Reply::Identity(fixtures::identity(true, true, true))));
    assert_eq!(robot.work(), [Tag::Watch("/robot2/odom".into())]);
}

#[test]
fn giving_up_on_the_passphrase_says_what_was_not_done() {
    let mut robot = on(at_topics(false), "robot2");
    robot.types("w");
    robot.presses(Key::Escape);
    assert_eq!(robot.message(), "not done: watching /robot2/odom");
    robot.hears_of(Part::Identity);
    robot.site_answers(true);
    assert!(robot.work().is_empty());
}

#[test]
fn a_registration_that_fails_drops_what_waited_and_stays_on_screen() {
    let mut robot = on(at_topics(false), "robot2");
    robot.state.identity = Some(fixtures::identity(true, true, false));
    robot.types("w");
    robot.is_answered(&Tag::Register, Err(fixtures::failure(ErrorKind::Unreachable, "node does not answer")));
    robot.waits(60);
    assert!(robot.message().contains("node does not answer"));
    assert!(robot.work().is_empty() && robot.state.identity_path.is_none());
}

#[test]
fn a_topic_with_a_name_that_is_none_is_refused_in_words() {
    let mut robot = at_topics(true);
    let rows = vec![fixtures::topic("/evil\u{202e}\u{1b}[2J", 0.0)];
    robot.hears_of(Part::Topics);
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(rows)));
    let mut robot = on(robot, "evil");
    robot.types("w");
    assert!(robot.work().is_empty());
    assert!(robot.message().contains("is not a topic name") && !robot.message().contains('\u{1b}'));
}

#[test]
fn the_palette_watches_by_patterns() {
    let mut robot = at_topics(true);
    for (line, watches) in [(":watch /robot*/camera/**", true), (":unwatch /robot2/*", false)] {
        robot.types(line);
        robot.presses(Key::Enter);
        let (sent, topic) = match robot.sent.last() {
            Some((Command::WatchTopic { topic, .. }, _)) => (true, topic.to_string()),
            Some((Command::UnwatchTopic { topic }, _)) => (false, topic.to_string()),
            other => panic!("{other:?}"),
        };
        assert_eq!((sent, line.ends_with(&topic)), (watches, true), "{topic}");
    }
    robot.types(":watch /robot[1]/odom");
    robot.presses(Key::Enter);
    assert!(robot.message().contains("is not a topic pattern"), "{}", robot.message());
    robot.state.settings.read_only = true;
    let before = robot.work();
    robot.types(":watch /robot*/odom");
    robot.presses(Key::Enter);
    assert_eq!(robot.work(), before, "read-only");
}

#[test]
fn l_limits_the_watched_topics_among_the_marked_at_once_and_their_type_stays() {
    let mut robot = on(at_topics(true), "robot2");
    robot.types("l");
    assert_eq!(robot.message(), "limit: not watched: w watches it");
    let mut robot = on(at_topics(true), "robot");
    let type_name = "nav_msgs/Odometry".parse().ok();
    for row in robot.state.topics.rows.iter_mut().filter(|row| row.watched) {
        row.watched_type.clone_from(&type_name);
        row.sampling = Sampling { rate: Some(500), every: None };
    }
    robot.types("al");
    let Some(Popup::Form(Purpose::Limit, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!((form.title.as_str(), form.text(0), form.text(1)), ("Limit /robot1/odom", "0.5", ""));
    for text in ["fast", "10"] {
        robot.presses(Key::Control('u'));
        robot.pastes(text);
        robot.presses(Key::Enter);
    }
    assert!(robot.form_error().is_some_and(|error| error.contains("messages per second")), "{:?}", robot.form_error());
    robot.presses(Key::Control('u'));
    robot.pastes("5");
    (0..2).for_each(|_| robot.presses(Key::Enter));
    let tag = Tag::Limit("/robot1/odom".into());
    assert_eq!(robot.work(), std::slice::from_ref(&tag));
    let Some((Command::WatchTopic { topic, type_name: sent, sampling }, _)) = robot.sent.last() else { panic!() };
    assert_eq!((topic.as_str(), sent), ("/robot1/odom", &type_name));
    assert_eq!(*sampling, Some(Sampling { rate: Some(5_000), every: Some(10) }));
    robot.is_answered(&tag, Ok(Reply::Done));
    assert_eq!(robot.message(), "the rule of /robot1/odom is set");
}

#[test]
fn read_only_watches_nothing() {
    let mut robot = on(at_topics(true), "robot2");
    robot.state.settings.read_only = true;
    robot.types("w");
    assert_eq!(robot.message(), "watch: read-only");
    assert!(!robot.sent.iter().any(|(command, _)| matches!(command, Command::WatchTopic { .. })));
}
