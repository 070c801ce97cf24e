//! `topics coverage`: when there are own records of topics, of all or of one robot, as strips of signs.

use std::time::Duration;

use clap::Args;

use super::{parse, show::or_dash};
use crate::model::{Timestamp, coarse, counted};
use crate::service::reply::{CoveragePart, CoverageView, coverage_legend};
use crate::service::{Failure, command::TopicCoverage};
use authros_output::{Output, table};

const MOST_LISTED: usize = 20;

/// `topics coverage …`
#[derive(Debug, Args)]
pub struct CoverageArguments {
    /// Topic, such as /robot1/odom, or a pattern, such as /robot*/camera/**, for a row each
    #[arg(required_unless_present = "robot")]
    pub topic: Option<String>,
    /// Only this robot's: as enrolled, or the first part of its topics, as robot1 for /robot1/odom
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Start: 24h (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339 [default: the first record]
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
    /// End; same format [default: now]
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub until: Option<String>,
    /// Number of parts to divide the span into, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 60)]
    pub parts: usize,
}

pub fn question(arguments: &CoverageArguments, output: &Output) -> Result<TopicCoverage, Failure> {
    let times = parse::Times::now(output);
    Ok(TopicCoverage {
        topic: parse::optional(arguments.topic.as_deref())?,
        robot: arguments.robot.clone(),
        since: times.since(arguments.since.as_deref())?,
        until: times.until(arguments.until.as_deref())?,
        parts: arguments.parts,
    })
}

/// One topic with its losses; several as rows over the same span.
pub fn strips(views: &[CoverageView]) -> String {
    match views {
        [one] => strip(one),
        several => rows(several),
    }
}

fn rows(views: &[CoverageView]) -> String {
    let Some(one) = views.first() else { return "no record yet".to_owned() };
    let row = |view: &CoverageView| {
        let ends = [view.first, view.last].map(|at| or_dash(at.map(seconds)));
        [vec![view.topic.to_string()], ends.to_vec(), vec![view.strip(), view.robots.join(" ")]].concat()
    };
    let of = one.robot.as_ref().map_or_else(String::new, |robot| format!("robot '{robot}': "));
    let signs: String = views.iter().map(CoverageView::strip).collect();
    [
        format!("{of}{} to {}, {} per part", seconds(one.since), seconds(one.until), length(one)),
        table(&["topic", "first record", "last", "coverage", "robots"], views.iter().map(row)),
        coverage_legend(&signs),
    ]
    .join("\n")
}

fn strip(view: &CoverageView) -> String {
    let of = view.robot.as_ref().map_or_else(String::new, |robot| format!(" of robot '{robot}'"));
    let Some(first) = view.first else {
        return [vec![format!("{}{of}: no record yet", view.topic)], recorded_by(view)].concat().join("\n");
    };
    let last = view.last.unwrap_or(first);
    let mut lines = vec![
        format!("{}{of}  first record {}, last {}", view.topic, seconds(first), seconds(last)),
        format!("{} to {}, {} per part", seconds(view.since), seconds(view.until), length(view)),
        view.strip(),
        view.legend(),
    ];
    let lossy: Vec<&CoveragePart> = view.parts.iter().filter(|part| part.lost > 0).collect();
    let listed = lossy.iter().take(MOST_LISTED);
    lines.extend(listed.map(|part| format!("{}  {} lost", seconds(part.at), counted(part.lost, "message"))));
    if lossy.len() > MOST_LISTED {
        lines.push(format!(
            "and {} with losses; --json shows all",
            counted((lossy.len() - MOST_LISTED) as u64, "more part")
        ));
    }
    lines.extend(recorded_by(view));
    lines.join("\n")
}

fn recorded_by(view: &CoverageView) -> Vec<String> {
    let robots = view.robots.join(", ");
    match (&view.robot, view.robots.is_empty()) {
        (_, true) => Vec::new(),
        (None, false) => vec![format!("robots that recorded it: {robots}; --robot NAME shows one of them alone")],
        (Some(robot), false) if view.robots.contains(robot) => {
            vec![format!("what it lost itself is in its reports: `authros robot show {robot}`")]
        }
        (Some(_), false) => vec![format!("robots that recorded it: {robots}")],
    }
}

fn seconds(moment: Timestamp) -> String {
    let text = moment.to_string();
    text.get(..19).map_or_else(|| text.clone(), |head| format!("{head}Z"))
}

fn length(view: &CoverageView) -> String {
    let parts = (view.parts.len() as u64).max(1);
    let part = Duration::from_nanos(view.until.0.saturating_sub(view.since.0) / parts);
    if part.as_secs() == 0 { "under 1 s".to_owned() } else { coarse(part) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(minute: u64, lost: u64) -> CoveragePart {
        let at = Timestamp::from_seconds(1_700_000_000 + 60 * minute);
        CoveragePart { at, data: minute != 1, quarantined: minute == 2, tampered: false, lost }
    }

    #[test]
    fn a_strip_shows_the_worst_of_each_part_and_says_what_its_signs_mean() {
        let at = Timestamp::from_seconds;
        let view = CoverageView {
            topic: "/robot1/odom".parse().expect("a topic"),
            robot: None,
            robots: Vec::new(),
            since: at(1_700_000_000),
            until: at(1_700_000_240),
            first: Some(at(1_700_000_000)),
            last: Some(at(1_700_000_239)),
            parts: vec![part(0, 0), part(1, 0), part(2, 0), part(3, 7)],
        };
        let text = strip(&view);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "2023-11-14T22:13:20Z to 2023-11-14T22:17:20Z, 60 s per part");
        assert_eq!(lines[2], "█·QL");
        assert_eq!(lines[3], "█ recorded  · nothing  L messages lost  Q quarantined");
        assert_eq!(lines[4], "2023-11-14T22:16:20Z  7 messages lost");
        let of = |robot: &str| {
            let robots = vec!["scout-1".to_owned(), "scout-2".to_owned()];
            strip(&CoverageView { robot: Some(robot.to_owned()), robots, ..view.clone() })
        };
        assert!(of("scout-1").starts_with("/robot1/odom of robot 'scout-1'  first record 2023-11-14T22:13:20Z"));
        assert!(of("scout-1").ends_with("`authros robot show scout-1`"));
        let none = CoverageView { first: None, last: None, ..view };
        assert_eq!(strip(&none), "/robot1/odom: no record yet");
        let other = CoverageView { robot: Some("scout-3".to_owned()), robots: vec!["scout-1".to_owned()], ..none };
        assert_eq!(strip(&other), "/robot1/odom of robot 'scout-3': no record yet\nrobots that recorded it: scout-1");
    }

    #[test]
    fn several_topics_are_rows_over_one_span_with_the_meaning_of_all_signs() {
        let at = Timestamp::from_seconds;
        let view = |topic: &str, parts: Vec<CoveragePart>, robots: &[&str]| CoverageView {
            topic: topic.parse().expect("a topic"),
            robot: Some("scout-1".to_owned()),
            robots: robots.iter().map(|robot| (*robot).to_owned()).collect(),
            since: at(1_700_000_000),
            until: at(1_700_000_240),
            first: Some(at(1_700_000_000)),
            last: Some(at(1_700_000_239)),
            parts,
        };
        let (odom, camera) = (vec![part(0, 0), part(1, 0)], vec![part(0, 0), part(3, 7)]);
        let views = [view("/robot1/odom", odom, &["scout-1"]), view("/robot1/camera", camera, &[])];
        let text = strips(&views);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "robot 'scout-1': 2023-11-14T22:13:20Z to 2023-11-14T22:17:20Z, 2 min per part");
        let ends = ["2023-11-14T22:13:20Z", "2023-11-14T22:17:19Z"];
        let cells = |line: usize| lines[line].split_whitespace().collect::<Vec<_>>();
        assert_eq!(cells(2), ["/robot1/odom", ends[0], ends[1], "█·", "scout-1"]);
        assert_eq!(cells(3), ["/robot1/camera", ends[0], ends[1], "█L"]);
        assert_eq!(lines[4..], ["█ recorded  · nothing  L messages lost"]);
        assert!(strips(&views[..1]).starts_with("/robot1/odom of robot 'scout-1'  first record"), "one has all of it");
    }
}
