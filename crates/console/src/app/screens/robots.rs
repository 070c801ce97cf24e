//! Topics grouped by robot: the first part of their names, as ROS namespaces are. A folded robot is one row.

use crate::service::reply::{HeldUp, TopicRow};

/// The robot of a topic: `/robot1` of `/robot1/odom`; none of `/tf`.
pub fn robot_of(topic: &str) -> Option<&str> {
    let end = topic.get(1..)?.find('/')? + 1;
    topic.get(..end)
}

/// The name of a folded robot's row. No topic name ends like this.
pub fn name_of(robot: &str) -> String {
    format!("{robot}/")
}

/// The robot of a folded robot's row.
pub fn folded(name: &str) -> Option<&str> {
    name.strip_suffix('/')
}

/// A robot's topics in one row: the sum of rates and counts, and the worst state of any.
pub fn together(robot: &str, rows: &[&TopicRow]) -> TopicRow {
    let sum = |of: fn(&TopicRow) -> u64| rows.iter().map(|row| of(row)).sum();
    let rate = |of: fn(&TopicRow) -> Option<f64>| {
        let known = rows.iter().filter_map(|row| of(row));
        rows.iter().any(|row| of(row).is_some()).then(|| known.sum())
    };
    let held_up = |wanted| rows.iter().any(|row| row.watched && row.held_up == Some(wanted)).then_some(wanted);
    let mut publishers: Vec<String> = rows.iter().flat_map(|row| row.publishers.clone()).collect();
    publishers.sort();
    publishers.dedup();
    TopicRow {
        topic: name_of(robot),
        ros: rows.iter().map(|row| row.ros).min().unwrap_or(1),
        type_hash: None,
        qos: None,
        type_name: Some(format!("{} topics", rows.len())),
        publishers,
        unreached: rows.iter().flat_map(|row| row.unreached.clone()).collect(),
        watched: rows.iter().any(|row| row.watched),
        held_up: held_up(HeldUp::WaitsForKey).or(held_up(HeldUp::Paused)),
        simulated: rows.iter().all(|row| row.simulated),
        hz: rate(|row| row.hz),
        bytes_per_second: rate(|row| row.bytes_per_second),
        messages: sum(|row| row.messages),
        lost_in_transport: sum(|row| row.lost_in_transport),
        lost_in_recorder: sum(|row| row.lost_in_recorder),
        left_out: sum(|row| row.left_out),
        last_message: rows.iter().filter_map(|row| row.last_message).max(),
        pins: sum(|row| row.pins),
        unpinned: rows.iter().flat_map(|row| row.unpinned.clone()).collect(),
        quarantined: sum(|row| row.quarantined),
        alarm: rows.iter().any(|row| row.alarm),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::tests::fixtures;

    #[test]
    fn a_robot_is_the_first_part_of_a_name() {
        assert_eq!(robot_of("/robot1/camera/compressed"), Some("/robot1"));
        assert_eq!([robot_of("/tf"), robot_of(""), robot_of("odom")], [None; 3]);
        assert_eq!(robot_of("/机/odom"), Some("/机"));
        assert_eq!(folded(&name_of("/robot1")), Some("/robot1"));
        assert_eq!(folded("/robot1/odom"), None);
    }

    #[test]
    fn its_row_says_the_sum_and_the_worst() {
        let one = TopicRow { watched: true, messages: 7, ..fixtures::topic("/r/odom", 20.0) };
        let other = TopicRow { alarm: true, hz: None, ..fixtures::topic("/r/camera", 2.0) };
        let row = together("/r", &[&one, &other]);
        assert_eq!((row.topic.as_str(), row.hz, row.messages), ("/r/", Some(20.0), 7));
        assert_eq!(row.bytes_per_second, Some(130_400.0));
        assert!(row.alarm && row.watched);
    }
}
