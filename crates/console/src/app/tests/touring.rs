//! The tour: it continues when the thing is done and not before, and ends with its key.

use super::{Robot, fixtures};
use crate::app::tour::{Cast, TEXT, Tour};
use crate::app::{Key, Settings, Tag};
use crate::model::ProfileName;
use crate::service::reply::{GrantState, Provenance};
use crate::service::{Part, Reply};

fn profile(name: &str) -> ProfileName {
    name.parse().expect("a name")
}

fn on_tour() -> Robot {
    let cast = Cast { owner: ProfileName::default(), reader: profile("cura-b") };
    let settings = Settings { tour: Some(cast), ..Settings::default() };
    let mut robot = Robot::opens(settings);
    robot.site_answers(false);
    robot
}

fn step(robot: &Robot) -> usize {
    robot.state.tour.as_ref().map_or(0, |tour| tour.count().0)
}

/// What the site reports about grants from now on.
fn no_grant_is_active(robot: &mut Robot) {
    robot.state.grants.rows.iter_mut().for_each(|row| row.state = GrantState::Revoked);
}

#[test]
fn each_step_waits_for_its_deed() {
    let mut robot = on_tour();
    assert_eq!(step(&robot), 1, "nobody is registered");
    let mut rows = fixtures::topics();
    rows.iter_mut().for_each(|row| row.watched = false);
    robot.state.topics.set(rows.clone(), fixtures::NOW);
    robot.state.identity = Some(fixtures::identity(true, true, true));
    robot.waits(1);
    assert_eq!(step(&robot), 2, "nothing is watched");
    rows[0].watched = true;
    robot.state.topics.set(rows, fixtures::NOW);
    robot.waits(1);
    assert_eq!(step(&robot), 3, "no record was looked at");
    robot.types("3");
    robot.site_answers(true);
    robot.presses(Key::Enter);
    assert_eq!(step(&robot), 3, "it was asked for, and has not come");
    let id = robot.state.row_key().expect("a record");
    let shown: Provenance = fixtures::provenance(1_000);
    no_grant_is_active(&mut robot);
    robot.is_answered(&Tag::Show(id), Ok(Reply::Provenance(shown)));
    assert_eq!(step(&robot), 4, "the fixtures' record is verified, and nothing is granted");
    robot.presses(Key::Escape);
    robot.types("5");
    robot.hears_of(Part::Grants);
    robot.site_answers(true);
    assert_eq!(step(&robot), 5, "the fixtures have an active grant");
    robot.types(":profile cura-b");
    robot.presses(Key::Enter);
    robot.site_answers(true);
    assert_eq!(step(&robot), 5, "being the reader is not enough");
    robot.types("4");
    robot.site_answers(true);
    robot.presses(Key::Enter);
    let id = robot.state.row_key().expect("a record");
    robot.is_answered(&Tag::Open(id), Ok(Reply::Opened(Box::new(fixtures::opened(1_000, false)))));
    assert_eq!(step(&robot), 6);
    robot.presses(Key::Escape);
    robot.types(":profile default");
    robot.presses(Key::Enter);
    robot.site_answers(true);
    assert_eq!(step(&robot), 6, "the grant is active still");
    no_grant_is_active(&mut robot);
    robot.waits(1);
    assert_eq!(step(&robot), TEXT.len());
    robot.types("E");
    assert!(robot.state.tour.is_none());
}

#[test]
fn it_ends_at_any_time_by_its_key_and_takes_its_rows_from_the_lists() {
    let mut robot = on_tour();
    let with = robot.state.page_rows();
    robot.types("E");
    assert!(robot.state.tour.is_none());
    assert_eq!(robot.state.page_rows(), with + 4);
    robot.types("E");
    assert!(robot.message().contains("no tour"), "{}", robot.message());
}

#[test]
fn every_line_fits_the_smallest_terminal_or_80_columns() {
    let cast = Cast { owner: profile("cura-a"), reader: profile("cura-b") };
    let [name, ..] = Tour::new(cast).lines().expect("a step");
    assert!(!name.is_empty());
    for (_, [_, act, why]) in TEXT {
        for line in [act, why] {
            let line = line.replace("OWNER", "cura-a").replace("READER", "cura-b");
            assert!(line.chars().count() <= 75, "{line}");
        }
    }
}
