//! The address book: added, confirmed and removed without leaving the console.

use super::{Robot, fixtures};
use crate::app::{Key, Popup, Purpose, Tag};
use crate::model::ErrorKind;
use crate::service::{Command, Reply};

fn at_the_book() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("5c");
    robot.site_answers(true);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Contacts(_))));
    robot
}

fn sent(robot: &Robot) -> &Command {
    &robot.sent.last().expect("sent").0
}

#[test]
fn a_contact_is_entered_and_what_is_refused_comes_back_as_it_was_filled() {
    let mut robot = at_the_book();
    robot.types("nbob");
    robot.presses(Key::Enter);
    robot.pastes(&fixtures::OTHER.to_string());
    robot.presses(Key::Enter);
    robot.presses(Key::Enter);
    let tag = Tag::Contact("bob".to_owned());
    let Command::AddContact { name, address, fingerprint: None } = sent(&robot) else { panic!("{:?}", sent(&robot)) };
    assert_eq!((name.to_string().as_str(), *address), ("bob", fixtures::OTHER));
    robot.is_answered(&tag, Err(fixtures::failure(ErrorKind::Input, "that name is taken")));
    assert_eq!(robot.form_error(), Some("that name is taken"));
    let Some(Popup::Form(Purpose::AddContact, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!(form.text(0), "bob");
    (0..3).for_each(|_| robot.presses(Key::Enter));
    robot.is_answered(&tag, Ok(Reply::Contacts(vec![fixtures::contact("bob")])));
    assert!(matches!(robot.state.popups.last(), Some(Popup::Contacts(_))), "the book is there again");
    assert_eq!(robot.state.contacts.len(), 1);
}

#[test]
fn removing_and_confirming_are_asked_about_and_g_fills_the_grant() {
    let mut robot = at_the_book();
    robot.presses(Key::Down);
    robot.types("x");
    robot.presses(Key::Escape);
    assert!(robot.work().is_empty(), "not removed without a y");
    robot.types("xy");
    assert!(matches!(sent(&robot), Command::RemoveContact { name } if name.to_string() == "harbour-master"));
    let mut robot = at_the_book();
    robot.types("cy");
    assert!(matches!(sent(&robot), Command::ConfirmContact { name, .. } if name.to_string() == "harbour-office"));
    let mut robot = at_the_book();
    robot.types("g");
    let Some(Popup::Form(Purpose::Grant, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!(form.text(0), "harbour-office");
}

#[test]
fn read_only_looks_at_it_and_changes_nothing() {
    let mut robot = at_the_book();
    robot.state.settings.read_only = true;
    for key in "nxcg".chars() {
        robot.presses(Key::Char(key));
        assert!(matches!(robot.state.popups.last(), Some(Popup::Contacts(_))), "{key}");
    }
}
