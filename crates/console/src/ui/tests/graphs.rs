//! What the graphs of the Overview show at 80x24 of rates that an operator has to see, and what they cost a terminal.

use super::*;
use crate::app::{Feed, Verb};

/// The captured line, two rows of 60 cells, after that many seconds; `captured` counts up to each second.
fn line(seconds: u64, theme: &Theme, captured: impl Fn(u64) -> u64) -> [Vec<char>; 2] {
    let mut robot = at(Screen::Overview, SIZES[0]);
    (1..=seconds).for_each(|second| counts(&mut robot, captured(second)));
    let text = shown(&robot.state, theme);
    let mut lines = text.lines().skip_while(|line| !line.starts_with("Last 15 min")).skip(1);
    std::array::from_fn(|_| {
        let line = format!("{:80}", lines.next().expect("a row"));
        line.chars().skip(11).take(60).collect()
    })
}

/// A second later; `captured` counts from the beginning.
fn counts(robot: &mut Robot, captured: u64) {
    robot.waits(1);
    let all = fixtures::site().life.captured + captured;
    let [stored, anchored, confirmed, verified] = [all; 4];
    let life = LifeLine { captured: all, stored, anchored, confirmed, verified, pending: 0, ..fixtures::site().life };
    robot.hears_of(crate::service::Part::Health);
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(SiteView { life, ..fixtures::site() })));
}

fn steady(second: u64) -> u64 {
    50 * second
}

fn places(line: &[Vec<char>; 2], of: impl Fn([char; 2]) -> bool) -> Vec<usize> {
    (0..60).filter(|place| of([line[0][*place], line[1][*place]])).collect()
}

#[test]
fn a_steady_rate_is_a_thin_line() {
    let line = line(700, &night(), steady);
    let full = places(&line, |cell| cell == ['⠉', ' ']);
    assert!(full.len() >= 44, "{line:?}");
    let rest = places(&line, |cell| cell != ['⠉', ' '] && cell != [' ', ' ']);
    assert!(rest.len() <= 2, "the beginning alone: {line:?}");
}

#[test]
fn a_fall_of_a_tenth_for_thirty_seconds_is_seen() {
    let fallen = |second: u64| 50 * second - 5 * second.saturating_sub(400).min(30);
    for theme in [night(), Theme { ascii: true, ..night() }] {
        let line = line(700, &theme, fallen);
        let other = places(&line, |cell| cell[1] != ' ');
        assert!((2..=5).contains(&other.len()), "{line:?}");
    }
}

#[test]
fn a_stop_of_two_seconds_reaches_the_ground() {
    let stopped = |second: u64| 50 * (second - second.saturating_sub(400).min(2));
    for theme in [night(), Theme { ascii: true, ..night() }] {
        let line = line(700, &theme, stopped);
        let other = places(&line, |cell| cell[1] != ' ');
        assert!((1..=2).contains(&other.len()), "{line:?}");
    }
}

#[test]
fn a_slow_rise_is_a_slope() {
    // From 40 to 60 a second.
    let rises = |second: u64| 40 * second + second * second / 70;
    let line = line(700, &night(), rises);
    let low = places(&line, |cell| cell[1] != ' ' && cell[1] != '↑');
    let high = places(&line, |cell| cell[0] != ' ' && cell[0] != '↑');
    assert!(low.len() >= 10 && high.len() >= 10, "{line:?}");
    assert!(low.first() < high.first() && low.last() < high.last(), "{line:?}");
}

/// Cells that differ between one picture and the next.
fn changed(one: &str, other: &str) -> usize {
    one.chars().zip(other.chars()).filter(|(one, other)| one != other).count()
}

#[test]
fn an_uneven_rate_rewrites_its_line_once_a_minute() {
    let mut robot = at(Screen::Overview, SIZES[0]);
    let mut captured = 0;
    let graphs = |robot: &Robot| -> String {
        let text = shown(&robot.state, &night());
        let lines = text.lines().skip_while(|line| !line.starts_with("Last 15 min")).skip(1).take(4);
        lines.map(|line| format!("{line:80}").chars().skip(11).collect::<String>()).collect()
    };
    let mut before = String::new();
    let (mut most, mut sum) = (0, 0);
    for second in 0..780 {
        captured += if second / 7 % 2 == 0 { 40 } else { 60 };
        counts(&mut robot, captured);
        let now = graphs(&robot);
        if second >= 720 {
            most = changed(&before, &now).max(most);
            sum += changed(&before, &now);
        }
        before = now;
    }
    assert!(most > 20, "the line moved: {most}");
    assert!(sum <= most + 100, "and in between its newest cells changed: {sum}, {most}");
}

#[test]
fn the_period_is_chosen_and_all_of_it_is_drawn() {
    let mut robot = at(Screen::Overview, SIZES[0]);
    (1..=120).for_each(|second| counts(&mut robot, steady(second)));
    for minutes in [60, 1, 15] {
        robot.act(Action::Do(Verb::Period));
        let text = shown(&robot.state, &night());
        assert!(text.contains(&format!("Last {minutes} min")), "{text}");
        assert!(text.contains('⠉'), "{text}");
    }
}
