//! Robots and their policies: how each stands, the window with all of it, one set from a file, one cleared, and drift
//! that is told on the Overview.

use super::{Robot, fixtures};
use crate::app::{Effect, Feed, Key, Lookup, Popup, Purpose, Tag};
use crate::model::ErrorKind;
use crate::screens::robots::state;
use crate::service::command::RobotCommand;
use crate::service::reply::{RobotRow, RobotView};
use crate::service::{Command, Part, Reply};
use fixtures::robots;

const POLICY: &str = "[ring]\nkeep = \"5m, 64MiB\"\ntopics = [\"/camera/**\"]\n[[watch]]\ntopic = \"/odom\"\n";

fn at_the_robots() -> Robot {
    let mut robot = Robot::at_work(true);
    robots::at_the_gateway(&mut robot);
    robot
}

/// With the cursor on the robot of that name.
fn at(name: &str) -> Robot {
    let mut robot = at_the_robots();
    robot.types("/");
    robot.types(name);
    robot.presses(Key::Enter);
    assert!(robot.state.row_key().is_some_and(|key| key.starts_with(name)), "{:?}", robot.state.row_key());
    robot
}

fn robots_asked(robot: &Robot) -> usize {
    let asks = |command: &Command| matches!(command, Command::OfRobot(RobotCommand::ListRobots));
    robot.sent.iter().filter(|(command, _)| asks(command)).count()
}

fn row(name: &str) -> RobotRow {
    robots::robots().into_iter().find(|row| row.name.as_str() == name).expect("a robot")
}

fn window(robot: &Robot) -> &Lookup<RobotView> {
    match robot.state.popups.last() {
        Some(Popup::Robot(lookup)) => lookup,
        other => panic!("no window, but {other:?}"),
    }
}

/// Types the path into the form that is open, and the file has this text.
fn names_a_file(robot: &mut Robot, path: &str, text: Result<&str, &str>) {
    robot.pastes(path);
    robot.presses(Key::Enter);
    let Some(Effect::ReadText(read)) = robot.effects.pop() else { panic!("no file is read") };
    robot.act(crate::app::Action::TextRead(read, text.map(str::to_owned).map_err(str::to_owned)));
}

fn sent(robot: &Robot) -> (&str, &str) {
    match robot.sent.last() {
        Some((Command::OfRobot(RobotCommand::SetRobotPolicy { name, text }), _)) => (name, text),
        other => panic!("{other:?}"),
    }
}

#[test]
fn each_robot_says_how_it_stands_in_the_words_of_the_command_line() {
    let words: Vec<String> = robots::robots().iter().map(state::words).collect();
    let expected =
        ["policy 1 in force", "policy 3 waiting, runs 2", "policy 3 refused, runs 2", "runs 5, not known here", "-"];
    assert_eq!(words, expected);
    let never = robots::drifting("a", 9, "waiting", None);
    assert_eq!(state::words(&never), "policy 3 waiting");
    let own = robots::drifting("a", 9, "refused", Some(0));
    assert_eq!(state::words(&own), "policy 3 refused");
}

#[test]
fn a_revoked_robot_is_called_that_and_found_by_the_word() {
    let mut robot = at_the_robots();
    let mut view = robot.state.gateway.view.clone().expect("a gateway");
    view.senders.iter_mut().filter(|sender| sender.name.as_str() == "robot2").for_each(|sender| sender.revoked = true);
    robot.state.gateway.set(view);
    let member = robot.state.gateway.all_members().into_iter().find(|row| row.name() == "robot2").expect("a sender");
    assert_eq!(member.standing(fixtures::NOW), "revoked");
    robot.types("/revoked");
    robot.presses(Key::Enter);
    let names: Vec<String> = robot.state.gateway.shown().iter().map(|row| row.name()).collect();
    assert_eq!(names, ["robot2"]);
}

#[test]
fn robots_are_in_the_order_of_their_numbers() {
    let mut robot = at_the_robots();
    robots::shows(&mut robot, vec![robots::robot("scout-10", 1), robots::robot("scout-9", 2)]);
    robot.state.gateway.table.sort = 1;
    let names: Vec<String> = robot.state.gateway.shown().iter().map(|row| row.name()).collect();
    assert_eq!(names, ["robot1", "robot2", "scout-9", "scout-10"]);
}

#[test]
fn the_list_is_filtered_and_sorted_by_policy() {
    let mut robot = at_the_robots();
    robot.types("/outdated");
    robot.presses(Key::Enter);
    let names: Vec<String> = robot.state.gateway.shown().iter().map(|row| row.name()).collect();
    assert_eq!(names, ["rover", "scout", "tug"]);
    robot.types("/refused");
    robot.presses(Key::Enter);
    assert_eq!(robot.state.row_keys(), ["scout 03030303"], "it has no session here: its device tells it apart");
    robot.presses(Key::Escape);
    robot.types("sss");
    let names: Vec<String> = robot.state.gateway.shown().iter().map(|row| row.name()).collect();
    assert_eq!(names, ["scout", "tug", "rover", "robot1", "whale", "robot2"], "the worst first");
    robot.types("S");
    assert_eq!(robot.state.gateway.shown()[0].name(), "robot2");
}

#[test]
fn a_robot_with_a_session_here_is_one_row_and_one_of_another_owner_has_no_policy() {
    let robot = at_the_robots();
    let members = robot.state.gateway.all_members();
    let of = |name: &str| *members.iter().find(|member| member.name() == name).expect("there");
    assert!(of("robot1").sender.is_some() && of("robot1").robot.is_some());
    assert!(of("robot2").sender.is_some() && of("robot2").robot.is_none());
    assert!(of("scout").sender.is_none() && of("scout").robot.is_some());
    let mut robot = at("robot2");
    robot.presses(Key::Enter);
    assert_eq!(robot.message(), "inspect: revoked, or not a robot");
}

#[test]
fn enter_shows_all_of_a_robot_and_follows_it() {
    let mut robot = at("scout");
    robot.presses(Key::Enter);
    assert!(window(&robot).answer.is_none());
    let tag = Tag::Robot("scout".to_owned());
    robot.is_answered(&tag, Ok(Reply::Robot(robots::view(row("scout")))));
    assert!(window(&robot).found().is_some_and(|view| view.refused.is_some()));
    robot.types("y");
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if text == "authros robot show scout"));
    // It takes the policy up: a record came, the list is asked for, and then the robot.
    robot.hears_of(Part::Uploads);
    robot.waits(6);
    let mut rows = robots::robots();
    rows[2] = RobotRow { wanted: 3, running: Some(3), ..robots::robot("scout", 3) };
    let now = rows[2].clone();
    robots::answers(&mut robot, Feed::Robots, Reply::Robots(rows));
    assert!(robot.work().contains(&tag));
    robot.is_answered(&tag, Ok(Reply::Robot(robots::view(now))));
    assert!(window(&robot).found().is_some_and(|view| view.row.standing == "in force"));
    assert!(!tag.is_work(), "leaving does not wait for it");
    robot.types("q");
    assert!(robot.state.popups.is_empty());
}

#[test]
fn a_policy_is_set_from_a_file_after_a_question_with_what_it_says() {
    let mut robot = at("scout");
    robot.state.settings.directory = "/home/operator".into();
    robot.types("p");
    let Some(Popup::Form(Purpose::SetPolicy, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!((form.text(0), form.focus), ("scout", 1), "the robot under the cursor, and the file is typed");
    names_a_file(&mut robot, "scout.toml", Ok(POLICY));
    let Some(Popup::Confirm(confirm)) = robot.state.popups.last() else { panic!("{:?}", robot.form_error()) };
    let said = confirm.lines.join("\n");
    for part in ["scout", "/home/operator/scout.toml", "Watches  /odom", "300s, 64 MiB of", "version 4"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    robot.types("Y");
    let line = "authros robot policy scout --set /home/operator/scout.toml";
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if text == line), "{:?}", robot.effects);
    robot.types("y");
    assert_eq!(sent(&robot), ("scout", POLICY));
    let set = RobotRow { wanted: 4, ..robots::drifting("scout", 3, "waiting", Some(2)) };
    let tag = Tag::SetPolicy("scout".to_owned(), Some("/home/operator/scout.toml".into()));
    robot.is_answered(&tag, Ok(Reply::Robot(robots::view(set))));
    assert_eq!(robot.message(), "the policy of scout is set as version 4");
    let shown = robot.state.gateway.robots.iter().find(|row| row.name.as_str() == "scout").map(state::words);
    assert_eq!(shown.as_deref(), Some("policy 4 waiting, runs 2"), "the list says so at once");
    robot.types("U");
    assert!(robot.message().contains("only rises"), "{}", robot.message());
}

#[test]
fn an_empty_line_clears_it() {
    let mut robot = at("scout");
    robot.types("p");
    robot.presses(Key::Enter);
    let Some(Popup::Confirm(confirm)) = robot.state.popups.last() else { panic!("no question") };
    assert_eq!(confirm.title, "Clear the policy?");
    robot.types("Yy");
    let line = "authros robot policy scout --clear";
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if text == line), "{:?}", robot.effects);
    assert_eq!(sent(&robot), ("scout", ""));
}

#[test]
fn what_cannot_be_set_is_said_in_the_form_and_what_is_refused_comes_back_as_it_was_filled() {
    for (text, word) in [
        (Err("/p.toml cannot be read: no such file"), "no such file"),
        (Ok(" \n"), "leave the line empty"),
        (Ok("cache.url = \"redis://x\"\n"), "cache.url"),
        (Ok("[[watch]]\ntopic = \"odom odom\"\n"), "line 1"),
    ] {
        let mut robot = at("scout");
        robot.types("p");
        names_a_file(&mut robot, "/p.toml", text);
        assert!(robot.form_error().is_some_and(|error| error.contains(word)), "{text:?}: {:?}", robot.form_error());
        let Some(Popup::Form(Purpose::SetPolicy, form)) = robot.state.popups.last() else { panic!("no form") };
        assert_eq!((form.focus, form.text(1)), (1, "/p.toml"));
        assert!(robot.work().is_empty());
    }
    let mut robot = at("robot2");
    robot.types("p");
    let Some(Popup::Form(Purpose::SetPolicy, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!((form.text(0), form.focus), ("", 0), "no robot of this profile is under the cursor");
    robot.types("nobody");
    robot.presses(Key::Enter);
    robot.presses(Key::Enter);
    assert!(robot.form_error().is_some_and(|error| error.contains("try robot1")), "{:?}", robot.form_error());
    robot.presses(Key::Control('u'));
    robot.types("sc");
    robot.presses(Key::Tab);
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!(form.text(0), "scout", "tab completes it");
    // As for an operator who is not the owner.
    robot.presses(Key::Enter);
    names_a_file(&mut robot, "/p.toml", Ok(POLICY));
    robot.types("y");
    let tag = Tag::SetPolicy("scout".to_owned(), Some("/p.toml".into()));
    robot.is_answered(&tag, Err(fixtures::failure(ErrorKind::Refused, "this needs the owner")));
    assert_eq!(robot.form_error(), Some("this needs the owner"));
    let Some(Popup::Form(Purpose::SetPolicy, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!((form.text(0), form.text(1)), ("scout", "/p.toml"));
}

#[test]
fn a_file_that_is_read_after_the_form_was_left_changes_nothing() {
    let mut robot = at("scout");
    robot.types("p");
    robot.pastes("/p.toml");
    robot.presses(Key::Enter);
    robot.presses(Key::Escape);
    robot.act(crate::app::Action::TextRead("/p.toml".into(), Ok(POLICY.to_owned())));
    assert!(robot.state.popups.is_empty() && robot.work().is_empty());
    assert_eq!(robot.state.reading, None);
}

#[test]
fn of_two_robots_of_one_name_the_device_says_which_one() {
    let mut robot = Robot::at_work(true);
    robots::shows(&mut robot, vec![robots::robot("twin", 0x21), robots::robot("twin", 0x22)]);
    robot.types("/22222222");
    robot.presses(Key::Enter);
    robot.presses(Key::Enter);
    assert_eq!(robot.work(), [Tag::Robot("22".repeat(32))]);
}

#[test]
fn robots_are_asked_for_when_records_came_and_only_with_an_open_keyring() {
    let mut robot = at_the_robots();
    robot.waits(60);
    assert_eq!(robots_asked(&robot), 0, "nothing came");
    robot.hears_of(Part::Uploads);
    robot.waits(0);
    assert_eq!(robots_asked(&robot), 1, "something came after a minute");
    let mut robot = at_the_robots();
    robot.hears_of(Part::Uploads);
    robot.waits(1);
    assert_eq!(robots_asked(&robot), 0, "not with each record");
    robot.waits(6);
    assert_eq!(robots_asked(&robot), 1);
    let mut robot = at_the_robots();
    robot.hears_of(Part::Identity);
    robots::answers(&mut robot, Feed::Identity, Reply::Identity(fixtures::identity(true, false, true)));
    assert!(robot.state.gateway.robots.is_empty(), "locked: nobody can say how they stand now");
    robot.site_answers(true);
    robot.waits(60);
    assert!(robot.state.deadline().is_none_or(|due| due > robot.state.now));
}

#[test]
fn drift_is_told_on_the_overview_since_it_began() {
    let mut robot = at_the_robots();
    robot.types("1");
    let told = |robot: &Robot| -> Vec<String> {
        let shown = robot.state.alerts.shown();
        shown.into_iter().filter(|alert| alert.resolved.is_none()).map(|alert| alert.text.clone()).collect()
    };
    let drift = "3 robots do not run their policies: rover, scout, tug (8)";
    assert!(told(&robot).contains(&drift.to_owned()), "{:?}", told(&robot));
    let alert = robot.state.alerts.shown().into_iter().find(|alert| alert.text == drift).expect("told");
    assert_eq!(Some(alert.since), row("scout").drift_since);
    robot.hears_of(Part::Uploads);
    robot.waits(31);
    robots::answers(&mut robot, Feed::Robots, Reply::Robots(vec![row("robot1"), row("scout")]));
    let one = "robot scout is out of date: policy 3 refused, runs 2 (8, then enter)";
    assert!(told(&robot).contains(&one.to_owned()), "{:?}", told(&robot));
    robot.hears_of(Part::Uploads);
    robot.waits(31);
    robots::answers(&mut robot, Feed::Robots, Reply::Robots(vec![row("robot1")]));
    assert!(told(&robot).iter().all(|text| !text.contains("robot")), "{:?}", told(&robot));
    assert!(robot.state.alerts.shown().iter().any(|alert| alert.text == one && alert.resolved.is_some()), "it is over");
}
