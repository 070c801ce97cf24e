//! Granting and revoking: forms, questions with default no, honest words.

use super::{Robot, fixtures};
use crate::app::{Confirm, Key, Popup, Purpose, Tag};
use crate::model::{Timestamp, TopicPattern};
use crate::service::reply::GrantForesight;
use crate::service::{Command, GrantFrom, Reply};

const READER: &str = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";

fn at_grants() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("5");
    robot.site_answers(true);
    robot
}

fn question(robot: &Robot) -> &Confirm {
    match robot.state.popups.last() {
        Some(Popup::Confirm(confirm)) => confirm,
        other => panic!("no question, but {other:?}"),
    }
}

fn fills_in(robot: &mut Robot, fields: [&str; 3]) {
    robot.site_answers(true);
    // The cursor stands on the first line that is not filled in yet.
    while matches!(robot.state.popups.last(), Some(Popup::Form(_, form)) if form.focus > 0) {
        robot.presses(Key::Up);
    }
    for field in fields {
        robot.presses(Key::Control('u'));
        robot.pastes(field);
        robot.presses(Key::Enter);
    }
    robot.presses(Key::Enter);
}

#[test]
fn g_asks_the_terms_then_shows_who_reads_already_then_sends_on_y() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "/robot1/odom /robot2/odom", "30d"]);
    let text = question(&robot).lines.join("\n");
    assert!(text.contains(READER) && text.contains("2023-12-14 22:13:20 UTC"), "{text}");
    assert!(text.contains(&fixtures::OTHER.to_string()), "who can read this now:\n{text}");
    robot.types("y");
    let (command, _) = robot.sent.last().expect("sent");
    let Command::Grant { grantee, topics, from, expires, .. } = command else { panic!("{command:?}") };
    assert_eq!((grantee.to_string().as_str(), topics.len(), *from), (READER, 2, GrantFrom::Now));
    assert_eq!(*expires, Some(Timestamp(fixtures::NOW.0 + 30 * 86_400 * 1_000_000_000)));
    assert!(robot.state.popups.is_empty());
}

#[test]
fn anything_but_y_is_no_and_leads_back_to_the_form() {
    for key in [Key::Enter, Key::Char('n'), Key::Char('g'), Key::Escape, Key::Control('c')] {
        let mut robot = at_grants();
        robot.types("g");
        fills_in(&mut robot, [READER, "all", ""]);
        robot.presses(key);
        assert!(robot.work().is_empty(), "{key:?}");
        assert!(matches!(robot.state.popups[..], [Popup::Form(..)]), "{key:?}");
        robot.presses(Key::Escape);
        assert!(robot.state.popups.is_empty());
    }
}

#[test]
fn a_grant_of_a_pattern_names_the_topics_and_an_end_is_a_clock() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "/robot*/odom", "tomorrow 18:00"]);
    robot.types("y");
    let (command, _) = robot.sent.last().expect("sent");
    let Command::Grant { topics, expires, .. } = command else { panic!("{command:?}") };
    let mut names: Vec<&str> = topics.iter().map(TopicPattern::as_str).collect();
    names.sort_unstable();
    assert_eq!(names, ["/robot1/odom", "/robot2/odom"]);
    // date -u -d '2023-11-15T18:00Z' +%s
    assert_eq!(*expires, Some(Timestamp::from_seconds(1_700_071_200)));
}

#[test]
fn everything_of_a_robot_until_friday_is_one_grant() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "robot:scout-1", "Friday 18:00"]);
    let text = question(&robot).lines.join("\n");
    assert!(text.contains("Topics   robot:scout-1\n") && text.contains("2023-11-17 18:00:00 UTC"), "{text}");
    let asked = robot.sent.iter().find(|(_, tag)| matches!(tag, Tag::Foresee(_))).expect("asked").1.clone();
    let topics = ["/imu", "/odom"].map(|topic| topic.parse().expect("a topic")).to_vec();
    robot.is_answered(&asked, Ok(Reply::GrantForeseen(GrantForesight { topics, ..GrantForesight::default() })));
    let text = question(&robot).lines.join("\n");
    assert!(text.contains("Topics   /imu /odom\n"), "what it has is named before the yes:\n{text}");
    robot.types("y");
    let grants = robot.sent.iter().filter_map(|(command, _)| match command {
        Command::Grant { topics, robots, expires, .. } => Some((topics.len(), robots.clone(), *expires)),
        _ => None,
    });
    // date -u -d '2023-11-17T18:00Z' +%s
    let friday = Timestamp::from_seconds(1_700_244_000);
    assert_eq!(grants.collect::<Vec<_>>(), [(0, vec!["scout-1".to_owned()], Some(friday))]);
}

#[test]
fn on_the_screen_of_robots_a_grant_is_of_the_robot_under_the_cursor() {
    let mut robot = Robot::at_work(true);
    fixtures::robots::at_the_gateway(&mut robot);
    robot.types("/scout");
    robot.presses(Key::Enter);
    robot.types("g");
    let Some(Popup::Form(Purpose::Grant, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!(form.text(1), "robot:scout");
}

#[test]
fn a_wrong_field_is_named_and_gets_the_focus() {
    let (own, other) = (fixtures::OWN.to_string(), fixtures::OTHER.to_string());
    let cases = [
        (["0x12", "", ""], "40 hex"),
        (["0x5aAeb6053F3E94C9b9A09f33669435E7Ef1Beaed", "", ""], "checksum"),
        ([own.as_str(), "", ""], "your own address"),
        ([READER, "robot1", ""], "must start with /"),
        ([READER, "", ""], "'all' for every topic"),
        ([READER, "all /robot1/odom", ""], "not both"),
        ([READER, "all robot:scout-1", ""], "not both"),
        ([READER, "robot: scout-1", ""], "must start with /"),
        ([READER, "robot:", ""], "after robot: without a space"),
        (["nobody", "all", ""], "no contact is named"),
        ([other.as_str(), "/robot1/odom", ""], "active grant on these terms"),
        ([READER, "all", "soon"], "30d"),
        ([READER, "all", "yesterday 18:00"], "enter a later time"),
        ([READER, "/robot9/**", ""], "no topic matches /robot9/** now"),
    ];
    for (fields, wanted) in cases {
        let mut robot = at_grants();
        robot.types("g");
        fills_in(&mut robot, fields);
        assert!(robot.form_error().is_some_and(|error| error.contains(wanted)), "{fields:?}: {:?}", robot.form_error());
    }
}

#[test]
fn marked_topics_are_the_scope_of_a_grant() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("/robot2");
    robot.presses(Key::Enter);
    robot.types(" g");
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!(form.text(1), "/robot2/odom");
}

#[test]
fn who_can_read_is_answered_without_any_grant() {
    let mut robot = at_grants();
    robot.state.grants.set(Vec::new());
    robot.types("i");
    assert!(
        matches!(robot.state.popups.last(), Some(Popup::Readers(topics)) if topics.is_empty()),
        "{}",
        robot.message()
    );
    let text = crate::screens::grants::keys::readers(&robot.state, "New records of all topics:", None).join("\n");
    assert!(text.contains("nobody but you"), "{text}");
}

#[test]
fn x_says_plainly_what_a_revoke_cannot_do() {
    let mut robot = at_grants();
    robot.types("x");
    let text = question(&robot).lines.join("\n");
    assert!(text.contains("already read cannot be taken back"), "{text}");
    assert!(text.contains("nobody but you"), "{text}");
    robot.types("x");
    assert!(robot.work().is_empty() && robot.state.popups.is_empty(), "the key that opened it is no yes");
    robot.types("xy");
    assert_eq!(robot.work(), [Tag::Revoke(fixtures::OTHER)]);
}

#[test]
fn only_an_active_grant_of_ones_own_can_be_revoked() {
    let mut robot = at_grants();
    robot.types("/revoked");
    robot.presses(Key::Enter);
    robot.types("x");
    assert_eq!(robot.message(), "revoke: not active");
    robot.presses(Key::Escape);
    robot.presses(Key::Escape);
    robot.types("/received");
    robot.presses(Key::Enter);
    robot.types("x");
    assert_eq!(robot.message(), "revoke: not given by you");
}

#[test]
fn the_form_is_filled_from_the_row_under_the_cursor_and_typing_takes_its_place() {
    let mut robot = Robot::at_work(true);
    robot.types("2/robot2");
    robot.presses(Key::Enter);
    robot.site_answers(true);
    robot.types("g");
    robot.site_answers(true);
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!((form.text(0), form.text(1), form.focus), ("", "/robot2/odom", 0));
    let mut robot = at_grants();
    robot.types("g");
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!((form.text(0), form.text(1)), (fixtures::OTHER.to_string().as_str(), "/robot1/odom"));
    robot.presses(Key::Enter);
    robot.types("all");
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!(form.text(1), "all", "what is typed takes the place of what was offered");
}

#[test]
fn tab_completes_contacts_and_topics_as_far_as_they_agree() {
    let mut robot = Robot::at_work(true);
    robot.types("g");
    robot.site_answers(true);
    robot.types("har");
    robot.presses(Key::Tab);
    robot.types("o");
    robot.presses(Key::Tab);
    robot.presses(Key::Enter);
    robot.types("/robot2");
    robot.presses(Key::Tab);
    robot.types(" /robot1/c");
    robot.presses(Key::Tab);
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!((form.text(0), form.text(1)), ("harbour-office", "/robot2/odom /robot1/camera/compressed"));
}

#[test]
fn all_topics_and_topics_that_nobody_knows_are_cautioned_about() {
    for (topics, wanted) in [("all", Some("ALL topics")), ("/robot1/odo", Some("/robot1/odo")), ("/robot1/odom", None)]
    {
        let mut robot = at_grants();
        robot.types("g");
        fills_in(&mut robot, [READER, topics, ""]);
        let caution = crate::popups::form::grant::caution(&robot.state, &question(&robot).errand.command);
        assert_eq!(caution.is_some(), wanted.is_some(), "{topics}: {caution:?}");
        assert!(wanted.is_none_or(|wanted| caution.is_some_and(|caution| caution.contains(wanted))));
    }
}

#[test]
fn a_grant_that_fails_comes_back_as_it_was_filled() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "/robot1/odom", "30d"]);
    robot.types("y");
    let tag = robot.work().pop().expect("sent");
    robot.is_answered(&tag, Err(fixtures::failure(crate::model::ErrorKind::Refused, "that account is not registered")));
    assert_eq!(robot.form_error(), Some("that account is not registered"));
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!((form.text(0), form.text(1), form.text(2)), (READER, "/robot1/odom", "30d"));
}

#[test]
fn the_palette_takes_the_terms_and_a_capital_y_copies_the_command_line() {
    let mut robot = at_grants();
    robot.types(":grant harbour-office /robot1/odom 30d");
    robot.presses(Key::Enter);
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!((form.text(0), form.text(1), form.text(2)), ("harbour-office", "/robot1/odom", "30d"));
    robot.presses(Key::Enter);
    robot.types("Y");
    let wanted = "authros grant add harbour-office --topic /robot1/odom --from now --expires 2023-12-14T22:13:20Z";
    assert!(
        matches!(robot.effects.last(), Some(crate::app::Effect::CopyText(text)) if text == wanted),
        "{:?}",
        robot.effects
    );
    question(&robot);
}

/// A day from now.
const END: Timestamp = Timestamp(fixtures::NOW.0 + 86_400 * 1_000_000_000);

fn at_a_grant_that_ends() -> Robot {
    let mut robot = at_grants();
    robot.state.grants.rows.iter_mut().for_each(|row| row.expires = Some(END));
    robot
}

#[test]
fn e_extends_an_active_grant() {
    let mut robot = at_a_grant_that_ends();
    robot.types("e30d");
    robot.presses(Key::Enter);
    let later = Timestamp(fixtures::NOW.0 + 30 * 86_400 * 1_000_000_000);
    let Some((Command::ExtendGrant { expires, .. }, tag)) = robot.sent.last() else { panic!("{:?}", robot.sent) };
    assert_eq!((*expires, tag), (Some(later), &Tag::Extend(fixtures::OTHER)));
}

#[test]
fn a_sooner_end_is_a_revoke_and_a_new_grant_asked_about_once() {
    let mut robot = at_a_grant_that_ends();
    robot.types("e12h");
    robot.presses(Key::Enter);
    assert_eq!(question(&robot).title, "Revoke and grant again?");
    assert!(question(&robot).lines.concat().contains("revoked first"));
    robot.types("n");
    assert!(robot.work().is_empty() && robot.state.follow_up.is_none(), "a no is one for both");

    robot.presses(Key::Enter);
    robot.types("y");
    assert_eq!(robot.work(), [Tag::Revoke(fixtures::OTHER)]);
    robot.is_answered(&Tag::Revoke(fixtures::OTHER), Ok(fixtures::transaction("revoked")));
    let sooner = Timestamp(fixtures::NOW.0 + 43_200 * 1_000_000_000);
    let granted = robot.sent.iter().find_map(|(command, _)| match command {
        Command::Grant { topics, from, expires, .. } => Some((topics.len(), *from, *expires)),
        _ => None,
    });
    assert_eq!(granted, Some((1, GrantFrom::Epoch(1), Some(sooner))), "the topics and the records stay");
}

#[test]
fn where_the_revoke_fails_nothing_is_granted_and_the_form_comes_back() {
    let mut robot = at_a_grant_that_ends();
    robot.types("e12h");
    robot.presses(Key::Enter);
    robot.types("y");
    let failure = fixtures::failure(crate::model::ErrorKind::Unreachable, "the node does not answer");
    robot.is_answered(&Tag::Revoke(fixtures::OTHER), Err(failure));
    assert!(robot.work().is_empty(), "{:?}", robot.work());
    assert_eq!(robot.form_error(), Some("the node does not answer"));
}

/// The words of the line `From`, what the question then says, and what is sent.
#[test]
fn the_question_says_from_when_and_at_what_cost_and_the_request_carries_just_that() {
    let hour_ago = Timestamp(fixtures::NOW.0 - 3_600 * 1_000_000_000);
    let counted = "Records  since 2023-11-14 22:06:33 UTC, 8,505 records";
    let cases = [
        ("now", GrantFrom::Now, "Records  from now on, nothing older", "a new epoch: 1 other reader gets the key"),
        ("epoch", GrantFrom::Current, counted, "Cost     1 transaction"),
        ("start", GrantFrom::Epoch(1), counted, "Cost     1 transaction"),
        ("2", GrantFrom::Epoch(2), counted, "Cost     1 transaction"),
        ("1h", GrantFrom::Time(hour_ago), counted, "Cost     1 transaction"),
    ];
    for (typed, wanted, records, cost) in cases {
        let mut robot = at_grants();
        robot.types("g");
        fills_in(&mut robot, [READER, "/robot1/odom", ""]);
        robot.presses(Key::Escape);
        robot.presses(Key::Control('u'));
        robot.pastes(typed);
        robot.presses(Key::Enter);
        robot.site_answers(true);
        let text = question(&robot).lines.join("\n");
        assert!(text.contains(records) && text.contains(cost), "{typed}:\n{text}");
        assert!(
            typed != "now" || text.contains("the robot scout-1 is told") && text.contains("3 transactions"),
            "{text}"
        );
        robot.types("y");
        let Some((Command::Grant { from, .. }, _)) = robot.sent.last() else { panic!("{typed}: {:?}", robot.sent) };
        assert_eq!(*from, wanted, "{typed}");
    }
}

#[test]
fn a_moment_that_cannot_be_read_or_a_count_that_fails_is_told() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "all", ""]);
    let (_, tag) =
        robot.sent.iter().find(|(command, _)| matches!(command, Command::ForeseeGrant { .. })).expect("asked");
    let (tag, text) = (tag.clone(), question(&robot).lines.join("\n"));
    assert!(text.contains("from now on, nothing older") && !text.contains("Cost"), "not told yet:\n{text}");
    robot.is_answered(&tag, Err(fixtures::failure(crate::model::ErrorKind::Unreachable, "the node does not answer")));
    let text = question(&robot).lines.join("\n");
    assert!(text.contains("Cost     not known: the node does not answer"), "{text}");
    robot.presses(Key::Escape);
    robot.presses(Key::Control('u'));
    robot.pastes("whenever");
    robot.presses(Key::Enter);
    assert!(robot.form_error().is_some_and(|error| error.starts_with("enter now, epoch, start or a time")));
}

#[test]
fn an_answer_about_other_terms_changes_no_question() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "all", ""]);
    let first = robot.sent.iter().find(|(_, tag)| matches!(tag, Tag::Foresee(_))).expect("asked").1.clone();
    robot.presses(Key::Escape);
    robot.presses(Key::Control('u'));
    robot.pastes("epoch");
    robot.presses(Key::Enter);
    let grantee = READER.parse().expect("a party");
    let of_all = Command::ForeseeGrant { grantee, topics: Vec::new(), robots: Vec::new(), from: GrantFrom::Now };
    let reply = fixtures::reply(&of_all, true);
    robot.is_answered(&first, Ok(reply));
    let text = question(&robot).lines.join("\n");
    assert!(text.contains("Records  since the current epoch began") && !text.contains("Cost"), "{text}");
}

#[test]
fn the_current_epoch_of_a_grant_that_is_replaced_is_the_one_shown_not_the_one_after_the_revoke() {
    let mut robot = at_grants();
    robot.types("g");
    let other = fixtures::OTHER.to_string();
    fills_in(&mut robot, [other.as_str(), "all", ""]);
    robot.presses(Key::Escape);
    robot.presses(Key::Control('u'));
    robot.pastes("epoch");
    robot.presses(Key::Enter);
    assert_eq!(question(&robot).title, "Revoke and grant again?");
    let Some((_, after)) = &robot.state.follow_up else { panic!("nothing follows") };
    assert!(matches!(after.command, Command::Grant { from: GrantFrom::Epoch(2), .. }), "{:?}", after.command);
}
