//! What the publisher of a ROS 2 message offered its subscribers, by the tags beside the message.

use std::collections::BTreeMap;

use crate::pipeline::importer;
use crate::ros::recording::tags::CHANNEL;
use crate::ros::ros2::{Offer, QUALITY};

/// Messages kept where the publisher did not say: as a node of ROS 2 does, and for those who subscribe later.
const USUAL: u32 = 10;
const LATCHED: u32 = 1;
/// The most that are kept.
const DEEPEST: u32 = 1000;

/// The offer to be made with a message. Publishers of DDS do not announce how many messages they keep; recordings tell it.
pub(super) fn offer(tags: &BTreeMap<String, String>) -> Offer {
    let profiles = tags.get(&format!("{CHANNEL}{QUALITY}")).map(String::as_str).unwrap_or_default();
    let said = |name: &str| first(profiles, name);
    let latched = match said("durability") {
        Some("transient_local" | "1") => true,
        Some("volatile" | "2") => false,
        _ => tags.contains_key(importer::LATCHING),
    };
    let reliable = !matches!(said("reliability"), Some("best_effort" | "2"));
    let usual = if latched { LATCHED } else { USUAL };
    let depth = match (said("history"), said("depth").and_then(|depth| depth.parse().ok())) {
        (Some("keep_all" | "2"), _) => DEEPEST,
        (_, Some(depth)) if depth > 0 => depth,
        _ => usual,
    };
    Offer { reliable, latched, depth: depth.min(DEEPEST) }
}

/// The value of a name in the first of several profiles, which are a list in YAML.
fn first<'a>(profiles: &'a str, name: &str) -> Option<&'a str> {
    let lines = profiles.lines().enumerate();
    let own = lines.take_while(|(place, line)| *place == 0 || !line.starts_with('-')).map(|(_, line)| line);
    own.filter_map(|line| line.trim_start_matches(['-', ' ']).split_once(':'))
        .find(|(key, _)| key.trim() == name)
        .map(|(_, value)| value.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(profiles: &str, latching: bool) -> Offer {
        let mut tags = BTreeMap::from([("mcap.channel.offered_qos_profiles".to_owned(), profiles.to_owned())]);
        if latching {
            tags.insert("latching".into(), "yes".into());
        }
        offer(&tags)
    }

    #[test]
    fn profiles_of_recorders_old_and_new_are_understood() {
        // As rosbag2 writes them since Iron, and as it did before.
        let new = "- history: keep_last\n  depth: 5\n  reliability: best_effort\n  durability: volatile\n  deadline:\n    sec: \
                   9223372036\n    nsec: 854775807\n- history: keep_last\n  depth: 7\n  reliability: reliable\n";
        assert_eq!(of(new, false), Offer { reliable: false, latched: false, depth: 5 });
        let old = "- history: 1\n  depth: 3\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 0\n";
        assert_eq!(of(old, false), Offer { reliable: true, latched: true, depth: 3 });
        assert_eq!(of("- history: keep_all\n  depth: 0\n", false).depth, 1000);
        assert_eq!(of("- depth: 99999999\n", false).depth, 1000);
    }

    #[test]
    fn what_is_not_said_is_what_a_node_does() {
        let unknown = "- history: unknown\n  depth: 0\n  reliability: reliable\n  durability: transient_local\n";
        assert_eq!(of(unknown, true), Offer { reliable: true, latched: true, depth: 1 });
        assert_eq!(of("", false), Offer { reliable: true, latched: false, depth: 10 });
        assert_eq!(of("depth: x\nreliability: no", true), Offer { reliable: true, latched: true, depth: 1 });
    }
}
