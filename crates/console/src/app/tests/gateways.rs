//! The fleet on the Gateway screen: how each other gateway stands, naming one, removing one, and taking that back.

use super::{Robot, fixtures};
use crate::app::feed::Feed;
use crate::app::fleet::{Deed, Standing};
use crate::app::popup::{Popup, Purpose};
use crate::app::{Action, Effect, Key, Tag};
use crate::model::{ErrorKind, SignerId};
use crate::service::command::FleetCommand;
use crate::service::reply::FellowView;
use crate::service::{Command, Part, Reply};
use fixtures::robots::{self, LACKING, TROUBLED};

const ADDRESS: &str = "192.0.2.9:7420";
const KEY: SignerId = SignerId([0x9f; 32]);
/// The key of the gateway that runs here, in the fixtures.
const OWN: SignerId = SignerId([0x6a; 32]);

fn at_the_fleet() -> Robot {
    let mut robot = Robot::at_work(true);
    robots::at_the_gateway(&mut robot);
    robot
}

fn fleet_asked(robot: &Robot) -> usize {
    let asks = |command: &Command| matches!(command, Command::OfFleet(FleetCommand::FleetStatus));
    robot.sent.iter().filter(|(command, _)| asks(command)).count()
}

fn sent(robot: &Robot) -> &FleetCommand {
    match robot.sent.iter().rev().find(|(_, tag)| matches!(tag, Tag::Fleet(_))) {
        Some((Command::OfFleet(command), _)) => command,
        other => panic!("{other:?}"),
    }
}

fn fills(robot: &mut Robot, address: &str, key: &str) {
    robot.types("a");
    robot.pastes(address);
    robot.presses(Key::Enter);
    robot.pastes(key);
    robot.presses(Key::Enter);
}

fn question(robot: &Robot) -> String {
    match robot.state.popups.last() {
        Some(Popup::Confirm(confirm)) => format!("{}\n{}", confirm.title, confirm.lines.join("\n")),
        other => panic!("no question, but {other:?}"),
    }
}

fn add(before: Option<&str>) -> Tag {
    Tag::Fleet(Deed::Add { address: ADDRESS.to_owned(), key: KEY, before: before.map(str::to_owned) })
}

#[test]
fn the_worst_gateway_is_first_and_robots_follow_in_one_list() {
    let mut robot = at_the_fleet();
    let keys = robot.state.row_keys();
    assert!(keys[0].starts_with(TROUBLED), "{keys:?}");
    let standings: Vec<String> = robot.state.gateway.shown().0.iter().map(|one| Standing::of(one).words()).collect();
    assert_eq!(standings, ["trouble", "not heard yet", "lacking 1204", "reconciled"]);
    assert_eq!(keys[4..6], ["robot1", "robot2"], "then who is known at this gateway");
    assert!(robot.state.row_key().is_some_and(|key| key.starts_with(TROUBLED)));
    for _ in 0..4 {
        robot.presses(Key::Down);
    }
    assert_eq!(robot.state.row_key().as_deref(), Some("robot1"), "the cursor goes on into the list below");
    robot.types("/lacking");
    robot.presses(Key::Enter);
    assert_eq!(robot.state.row_keys(), [format!("192.0.2.3:7420 {LACKING}")]);
}

#[test]
fn a_gateway_that_told_all_and_lacks_nothing_is_reconciled_and_one_that_did_not_is_still_read() {
    let well = robots::fellow(ADDRESS, KEY);
    assert_eq!(Standing::of(&well), Standing::Reconciled);
    assert_eq!(Standing::of(&FellowView { reconciled: false, ..well.clone() }), Standing::Reading);
    assert_eq!(Standing::of(&FellowView { reconciled: false, lacking: 3, ..well.clone() }), Standing::Lacking(3));
    assert_eq!(Standing::of(&FellowView { heard: None, reconciled: false, ..well.clone() }), Standing::NotHeard);
    assert_eq!(Standing::of(&FellowView { problem: Some("away".into()), ..well }), Standing::Trouble);
}

#[test]
fn while_it_is_on_screen_the_fleet_is_asked_for_again_and_a_home_without_one_is_not() {
    let mut robot = at_the_fleet();
    assert_eq!(fleet_asked(&robot), 0);
    robot.waits(3);
    assert_eq!(fleet_asked(&robot), 1);
    robot.waits(3);
    assert_eq!(fleet_asked(&robot), 1, "one question at a time");
    assert!(robot.state.deadline().is_none_or(|due| due > robot.state.now), "a console that waits sleeps");
    robots::answers(&mut robot, crate::app::feed::Feed::Fleet, Reply::Fleet(robots::fleet(Vec::new())));
    robot.waits(60);
    assert_eq!(fleet_asked(&robot), 0, "there is none any more");
    let mut robot = at_the_fleet();
    robot.types("f");
    robot.site_answers(true);
    robot.waits(60);
    assert_eq!(fleet_asked(&robot), 0, "a frozen view stays as it is");
    let mut robot = at_the_fleet();
    robot.types("2");
    robot.site_answers(true);
    robot.waits(60);
    assert_eq!(fleet_asked(&robot), 0, "nobody looks");
}

#[test]
fn a_gateway_is_named_by_form_and_question_and_that_is_taken_back() {
    let mut robot = at_the_fleet();
    fills(&mut robot, ADDRESS, &KEY.to_hex());
    let asked = question(&robot);
    assert!(asked.contains("Add this gateway") && asked.contains(&KEY.to_hex()), "{asked}");
    let own = format!("authros fleet add 192.0.2.1:7420 --gateway-key {OWN}");
    assert!(asked.contains(&own), "what the other keeper types: {asked}");
    robot.types("Y");
    let line = format!("authros fleet add {ADDRESS} --gateway-key {KEY}");
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if *text == line), "{:?}", robot.effects);
    robot.types("y");
    assert!(matches!(sent(&robot), FleetCommand::AddFellow { address, key } if address == ADDRESS && *key == KEY));
    let rows = vec![robots::fellow(ADDRESS, KEY)];
    robot.is_answered(&add(None), Ok(Reply::Fellows(rows)));
    assert_eq!(robot.message(), format!("gateway {ADDRESS} is in the fleet (U: undo)"));
    assert_eq!(robot.state.gateway.all_fellows().len(), 1, "it is there at once");
    assert_eq!(fleet_asked(&robot), 2, "and asked about once more than by the form, whose answer is from before");
    robot.types("zy");
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if *text == line), "{:?}", robot.effects);
    robot.types("U");
    assert!(matches!(sent(&robot), FleetCommand::RemoveFellow { gateway } if *gateway == KEY.to_hex()));
}

#[test]
fn what_the_other_keeper_types_names_a_place_to_go_to() {
    let mut robot = at_the_fleet();
    let served = robot.state.gateway.view.as_mut().and_then(|view| view.served.as_mut()).expect("served");
    served.address = "0.0.0.0:7420".to_owned();
    fills(&mut robot, ADDRESS, &KEY.to_hex());
    assert!(question(&robot).contains("authros fleet add HOST:7420 "), "{}", question(&robot));
}

#[test]
fn what_cannot_be_named_is_said_in_the_form_and_what_is_refused_comes_back_as_it_was_filled() {
    let key = KEY.to_hex();
    for (address, typed, line, word) in [
        ("b", key.as_str(), 0, "HOST:PORT"),
        (":7420", key.as_str(), 0, "HOST:PORT"),
        ("b:70000", key.as_str(), 0, "HOST:PORT"),
        ("b b:7420", key.as_str(), 0, "HOST:PORT"),
        (ADDRESS, "", 1, "enter its key"),
        (ADDRESS, "5a1f 09c2 77e0 41bd 5a1f 09c2 77e0 41bd", 1, "short fingerprint"),
        (ADDRESS, &key[..62], 1, "this has 62"),
        (ADDRESS, &"zz".repeat(32), 1, "64 hex characters"),
        (ADDRESS, &OWN.to_hex(), 1, "runs here"),
        ("192.0.2.3:7420", &LACKING.to_hex(), 0, "in the fleet already"),
    ] {
        let mut robot = at_the_fleet();
        fills(&mut robot, address, typed);
        assert!(robot.form_error().is_some_and(|error| error.contains(word)), "{address} {:?}", robot.form_error());
        let Some(Popup::Form(Purpose::AddGateway, form)) = robot.state.popups.last() else { panic!("no form") };
        assert_eq!((form.focus, form.text(0)), (line, address));
        assert!(robot.work().is_empty());
    }
    // As for an operator who is not the owner.
    let mut robot = at_the_fleet();
    fills(&mut robot, ADDRESS, &key);
    robot.types("y");
    let refusal = "this needs the owner of the profile; operators may look";
    robot.is_answered(&add(None), Err(fixtures::failure(ErrorKind::Refused, refusal)));
    assert_eq!(robot.form_error(), Some(refusal));
    let Some(Popup::Form(Purpose::AddGateway, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!((form.text(0), form.text(1)), (ADDRESS, key.as_str()));
}

#[test]
fn a_known_key_at_another_address_is_a_change_and_is_taken_back_to_the_old_one() {
    let mut robot = Robot::at_work(true);
    robots::shows(&mut robot, vec![robots::fellow("192.0.2.8:7420", KEY)], Vec::new());
    fills(&mut robot, ADDRESS, &KEY.to_hex());
    assert!(question(&robot).contains("It was named at 192.0.2.8:7420"), "{}", question(&robot));
    robot.types("y");
    robot.is_answered(&add(Some("192.0.2.8:7420")), Ok(Reply::Fellows(vec![robots::fellow(ADDRESS, KEY)])));
    robot.types("U");
    assert!(
        matches!(sent(&robot), FleetCommand::AddFellow { address, key } if address == "192.0.2.8:7420" && *key == KEY)
    );
}

#[test]
fn a_gateway_is_removed_after_a_question_and_comes_back_with_undo() {
    let mut robot = at_the_fleet();
    robot.types("x");
    robot.presses(Key::Escape);
    assert!(robot.work().is_empty(), "not removed without a y");
    robot.presses(Key::Enter);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Fellow(_))), "its window");
    robot.types("xY");
    let line = format!("authros fleet remove {TROUBLED}");
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if *text == line), "{:?}", robot.effects);
    robot.types("y");
    assert!(matches!(sent(&robot), FleetCommand::RemoveFellow { gateway } if gateway == TROUBLED));
    let (rest, gone): (Vec<_>, Vec<_>) = robots::fellows().into_iter().partition(|one| one.address != TROUBLED);
    let tag = Tag::Fleet(Deed::Remove { address: TROUBLED.to_owned(), key: gone[0].key });
    robot.is_answered(&tag, Ok(Reply::Fellows(rest)));
    assert!(robot.state.popups.is_empty(), "the window of what is gone is closed");
    assert_eq!(robot.state.gateway.all_fellows().len(), 3);
    robot.types("U");
    assert!(matches!(sent(&robot), FleetCommand::AddFellow { address, .. } if address == TROUBLED));
}

#[test]
fn a_gateway_that_was_removed_does_not_come_back_with_an_answer_from_before() {
    let mut robot = at_the_fleet();
    robot.waits(3);
    let asked = |robot: &Robot| {
        let of_fleet = |tag: &Tag| matches!(tag, Tag::Feed(Feed::Fleet, _));
        let tags: Vec<Tag> = robot.sent.iter().map(|(_, tag)| tag.clone()).filter(of_fleet).collect();
        tags
    };
    let before = asked(&robot);
    assert_eq!(before.len(), 1, "how the fleet stands is asked again and again");
    robot.types("xy");
    let (rest, gone): (Vec<_>, Vec<_>) = robots::fellows().into_iter().partition(|one| one.address != TROUBLED);
    let tag = Tag::Fleet(Deed::Remove { address: TROUBLED.to_owned(), key: gone[0].key });
    robot.is_answered(&tag, Ok(Reply::Fellows(rest.clone())));
    let all = robots::fleet(robots::fellows());
    robot.is_answered(&before[0], Ok(Reply::Fleet(all)));
    assert_eq!(robot.state.gateway.all_fellows().len(), 3, "that answer is from before");
    fills(&mut robot, TROUBLED, &gone[0].key.to_hex());
    assert!(question(&robot).contains("Add this gateway to the fleet?"), "it can be named again at once");
    // And what was asked for after it counts.
    let after = asked(&robot).pop().expect("asked anew");
    robot.is_answered(&after, Ok(Reply::Fleet(robots::fleet(rest[..2].to_vec()))));
    assert_eq!(robot.state.gateway.all_fellows().len(), 2);
}

#[test]
fn of_two_gateways_at_one_address_the_key_says_which_one() {
    let mut robot = Robot::at_work(true);
    let both = [KEY, LACKING].map(|key| robots::fellow(ADDRESS, key)).to_vec();
    robots::shows(&mut robot, both, Vec::new());
    robot.types("xy");
    assert!(matches!(sent(&robot), FleetCommand::RemoveFellow { gateway } if *gateway == KEY.to_hex()));
}

#[test]
fn without_a_gateway_nothing_can_be_named_and_read_only_changes_nothing() {
    let mut robot = Robot::at_work(true);
    robot.act(Action::Do(crate::app::Verb::AddGateway));
    assert!(robot.message().contains("open the Gateway screen first (8)"), "{}", robot.message());
    robot.types("8");
    robot.site_answers(true);
    if let Some(view) = &mut robot.state.gateway.view {
        view.served = None;
    }
    robot.types("a");
    assert_eq!(robot.message(), "fleet-add: no gateway runs here");
    robot.types("x");
    assert_eq!(robot.message(), "fleet-remove: select a gateway of the fleet (8)");
    let mut robot = at_the_fleet();
    robot.state.settings.read_only = true;
    for key in "axp".chars() {
        robot.presses(Key::Char(key));
        assert!(robot.state.popups.is_empty() && robot.message().contains("read-only"), "{key}: {}", robot.message());
    }
    robot.presses(Key::Enter);
    robot.types("x");
    assert!(matches!(robot.state.popups.last(), Some(Popup::Fellow(_))), "its window only looks");
}

#[test]
fn an_open_window_follows_what_is_heard() {
    let mut robot = at_the_fleet();
    robot.presses(Key::Enter);
    let Some(Popup::Fellow(window)) = robot.state.popups.last() else { panic!("no window") };
    let key = window.key;
    robot.hears_of(Part::Health);
    let rows = vec![robots::fellow(TROUBLED, key)];
    robots::answers(&mut robot, crate::app::feed::Feed::Fleet, Reply::Fleet(robots::fleet(rows)));
    let Some(Popup::Fellow(window)) = robot.state.popups.last() else { panic!("no window") };
    assert_eq!(window.found(&robot.state).map(Standing::of), Some(Standing::Reconciled));
    robot.types("y");
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if *text == key.to_hex()));
}
