//! Leaving: at once if nothing stops and nothing is pending; otherwise what stops and what goes on is said first.

use super::{Robot, fixtures};
use crate::app::tour::Cast;
use crate::app::{Action, Effect, Feed, Key, Popup, Tag};
use crate::model::ProfileName;
use crate::popups::state::Leaving;
use crate::service::reply::{HeldUp, LifeLine, QueueView, SiteView, TopicRow};
use crate::service::{Command, Part, Reply};

fn with_pending(pending: u64) -> SiteView {
    let life = LifeLine { pending, ..LifeLine::default() };
    SiteView { life, queue: QueueView::default(), ..fixtures::site() }
}

/// A console on a site of that process with this many records in flight.
fn busy(process: u32, pending: u64) -> Robot {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Health);
    answers(&mut robot, SiteView { process, ..with_pending(pending) });
    robot
}

/// The same, with nothing watched.
fn unwatched(process: u32, pending: u64) -> Robot {
    let mut robot = busy(process, pending);
    robot.state.topics.rows.iter_mut().for_each(|row| row.watched = false);
    robot
}

fn answers(robot: &mut Robot, site: SiteView) {
    let tag = robot.sent.iter().find(|(_, tag)| matches!(tag, Tag::Feed(Feed::Site, _)));
    let tag = tag.map(|(_, tag)| tag.clone()).expect("the site is asked");
    robot.is_answered(&tag, Ok(Reply::Site(site)));
}

/// The text of the question.
fn question(robot: &Robot) -> String {
    match robot.state.popups.last() {
        Some(Popup::Quit(leaving)) => leaving.lines(&robot.state).join("\n"),
        other => panic!("no question, but {other:?}"),
    }
}

#[test]
fn q_leaves_at_once_when_nothing_stops_and_nothing_is_pending() {
    for process in [0, 77] {
        let mut robot = unwatched(process, 0);
        robot.types("q");
        assert!(matches!(robot.effects[..], [Effect::Quit]));
    }
    let mut joined = busy(77, 0);
    joined.types("q");
    assert!(matches!(joined.effects[..], [Effect::Quit]), "what goes on in the site needs no question");
}

#[test]
fn q_before_the_site_answered_leaves_too() {
    let mut robot = Robot::opens(crate::app::Settings::default());
    robot.types("q");
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn the_host_says_that_capture_stops_and_a_joined_console_that_it_continues() {
    let mut host = busy(0, 0);
    host.types("q");
    assert!(question(&host).starts_with("Quitting stops the capture of /robot1/odom."), "{}", question(&host));
    assert!(question(&host).contains("authros serve"));
    host.types("y");
    assert!(matches!(host.effects[..], [Effect::Quit]));

    let mut joined = busy(77, 1);
    joined.types("q");
    let text = question(&joined);
    assert!(text.contains("The capture of /robot1/odom continues in the site (process 77)."), "{text}");
    assert!(text.contains("1 record is not verified yet; the site continues with them."), "{text}");
    assert!(!text.contains("stops"), "{text}");
}

#[test]
fn s_leaves_a_site_running_where_the_caller_can_and_something_is_captured() {
    let leaves = |mut robot: Robot| {
        robot.types("q");
        let asked = robot.state.popups.last().is_some_and(|popup| matches!(popup, Popup::Quit(_)));
        let said = asked && question(&robot).contains("continues it after");
        robot.types("s");
        (said, matches!(robot.effects[..], [Effect::LeaveSite]))
    };
    let able = |process: u32, watched: bool| {
        let mut robot = if watched { busy(process, 3) } else { unwatched(process, 3) };
        robot.state.settings.leaves_site = true;
        robot
    };
    assert_eq!(leaves(able(0, true)), (true, true));
    assert_eq!(leaves(busy(0, 3)), (false, false), "the caller cannot");
    assert_eq!(leaves(able(77, true)), (false, false), "the site is another process's, and goes on anyway");
    assert_eq!(leaves(able(0, false)), (false, false), "nothing would stop");
}

#[test]
fn the_tour_promises_nothing_that_its_home_does_not_keep() {
    let mut robot = busy(0, 3);
    let cast = Cast { owner: ProfileName::default(), reader: "cura-b".parse().expect("a name") };
    robot.state.settings.tour = Some(cast);
    robot.types("q");
    let text = question(&robot);
    assert!(text.contains("temporary home is removed") && text.contains("3 records are not verified yet"), "{text}");
    assert!(!text.contains("next start") && !text.contains("authros serve"), "{text}");
}

#[test]
fn what_waits_for_the_key_is_not_said_to_stop() {
    let mut robot = busy(0, 3);
    let waiting = |row: TopicRow| TopicRow { held_up: row.watched.then_some(HeldUp::WaitsForKey), ..row };
    robot.state.topics.rows = robot.state.topics.rows.drain(..).map(waiting).collect();
    robot.types("q");
    let text = question(&robot);
    assert!(text.contains("Capture of 1 topic waits for the key anyway.") && !text.contains("stops"), "{text}");
}

#[test]
fn q_asks_while_work_is_pending_and_stays_by_default() {
    let mut robot = unwatched(0, 7);
    robot.types("q");
    assert!(robot.effects.is_empty());
    robot.types("q");
    assert!(robot.effects.is_empty() && robot.state.popups.is_empty());
    robot.types("qy");
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn control_c_twice_always_leaves() {
    let mut robot = busy(0, 7);
    robot.presses(Key::Control('c'));
    robot.presses(Key::Control('c'));
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn w_leaves_by_itself_when_the_work_ends_even_when_frozen() {
    let mut robot = unwatched(0, 7);
    robot.types("fqw");
    assert!(matches!(robot.state.popups[..], [Popup::Quit(Leaving::WhenVerified)]));
    robot.hears_of(Part::Uploads);
    answers(&mut robot, with_pending(1));
    assert!(robot.effects.is_empty());
    robot.hears_of(Part::Uploads);
    answers(&mut robot, with_pending(0));
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn d_stops_the_capture_finishes_and_quits_and_a_change_of_mind_lets_it_go_on() {
    let holds = |robot: &Robot| match robot.sent.iter().find(|(_, tag)| *tag == Tag::HoldCapture) {
        Some((Command::HoldCapture { hold }, _)) => Some(*hold),
        _ => None,
    };
    let mut robot = busy(0, 0);
    robot.types("qd");
    assert_eq!(holds(&robot), Some(true));
    assert!(robot.effects.is_empty(), "what the site said before it was stopped says nothing");
    robot.is_answered(&Tag::HoldCapture, Ok(Reply::Done));
    assert!(robot.effects.is_empty());
    answers(&mut robot, SiteView { queue: QueueView { messages: 2, ..QueueView::default() }, ..with_pending(0) });
    assert!(robot.effects.is_empty(), "two messages are still in memory");
    robot.hears_of(Part::Uploads);
    answers(&mut robot, with_pending(2));
    assert!(robot.effects.is_empty());

    robot.types("n");
    assert_eq!(holds(&robot), Some(false), "staying lets capture go on");
    robot.is_answered(&Tag::HoldCapture, Ok(Reply::Done));
    robot.site_answers(true);
    robot.types("qd");
    robot.is_answered(&Tag::HoldCapture, Ok(Reply::Done));
    answers(&mut robot, with_pending(0));
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn q_closes_a_popup_and_leaves_nothing_else() {
    let mut robot = Robot::at_work(true);
    robot.types("?q");
    assert!(robot.state.popups.is_empty() && robot.effects.is_empty());
}

#[test]
fn suspension_works_from_anywhere() {
    let mut robot = Robot::at_work(false);
    robot.types("n");
    robot.presses(Key::Control('z'));
    assert!(matches!(robot.effects[..], [Effect::Suspend]));
    robot.act(Action::Resumed);
    assert!(robot.message().contains("was stopped meanwhile"));
}
