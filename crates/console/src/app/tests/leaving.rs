//! Leaving: at once when nothing is pending, else asked, else by itself when done.

use super::{Robot, fixtures};
use crate::app::feed::Feed;
use crate::app::popup::Popup;
use crate::app::{Action, Effect, Key, Tag};
use crate::service::reply::{LifeLine, SiteView};
use crate::service::{Part, Reply};

fn with_pending(pending: u64) -> Reply {
    Reply::Site(SiteView { life: LifeLine { pending, ..LifeLine::default() }, ..fixtures::site() })
}

fn busy() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Health);
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(with_pending(7)));
    robot
}

#[test]
fn q_leaves_at_once_when_nothing_is_pending() {
    let mut robot = Robot::at_work(true);
    robot.types("q");
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn q_before_the_site_answered_leaves_too() {
    let mut robot = Robot::opens(crate::app::Settings::default());
    robot.types("q");
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn q_asks_while_work_is_pending_and_stays_by_default() {
    let mut robot = busy();
    robot.types("q");
    assert!(robot.effects.is_empty());
    robot.types("q");
    assert!(robot.effects.is_empty() && robot.state.popups.is_empty());
    robot.types("qy");
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn control_c_twice_always_leaves() {
    let mut robot = busy();
    robot.presses(Key::Control('c'));
    robot.presses(Key::Control('c'));
    assert!(matches!(robot.effects[..], [Effect::Quit]));
}

#[test]
fn w_leaves_by_itself_when_the_work_ends_even_when_frozen() {
    let mut robot = busy();
    robot.types("fqw");
    assert!(matches!(robot.state.popups[..], [Popup::Quit { waiting: true }]));
    robot.hears_of(Part::Uploads);
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(with_pending(1)));
    assert!(robot.effects.is_empty());
    robot.hears_of(Part::Uploads);
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(with_pending(0)));
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
    assert!(robot.message().contains("stood still"));
}
