//! Topic names of recordings, resolved: `rosbag` records whatever a publisher called its topic, while a record's topic
//! is a graph name. The recorded name is stored as well, for export.

use std::collections::HashMap;
use std::sync::Arc;

use crate::model::TopicName;
use crate::model::topic::LONGEST_NAME;

/// The names of one recording; the same file gives the same names each time.
#[derive(Debug, Default)]
pub struct RecordedNames {
    resolved: HashMap<Arc<str>, Result<Arc<str>, &'static str>>,
    /// The owner of a name, and whether it is that name except for a leading slash: only such names share one.
    taken: HashMap<Arc<str>, (Arc<str>, bool)>,
}

impl RecordedNames {
    /// The graph name for a recorded one: itself if it is valid, with `/` in front if it is relative, with `_` for
    /// every character not allowed in a graph name.
    pub fn resolve(&mut self, recorded: &Arc<str>) -> Result<Arc<str>, &'static str> {
        if let Some(known) = self.resolved.get(recorded) {
            return known.clone();
        }
        let found = self.find(recorded);
        self.resolved.insert(Arc::clone(recorded), found.clone());
        found
    }

    fn find(&mut self, recorded: &Arc<str>) -> Result<Arc<str>, &'static str> {
        if recorded.len() > LONGEST_NAME {
            return Err("its topic name is longer than 255 bytes");
        }
        let parts: Vec<String> = recorded.split('/').filter(|part| !part.is_empty()).map(graph_part).collect();
        if parts.is_empty() {
            return Err("its topic has no name");
        }
        let name = format!("/{}", parts.join("/"));
        // `odom` and `/odom` are one topic; `a-b` and `a_b` are two.
        let exact = recorded.trim_start_matches('/') == name.trim_start_matches('/');
        let mut candidate: Arc<str> = name.as_str().into();
        for number in 2.. {
            let free = self.taken.get(&candidate).is_none_or(|(_, same)| exact && *same && number == 2);
            if candidate.parse::<TopicName>().is_err() {
                return Err("its topic name is too long for a graph name");
            }
            if free {
                break;
            }
            candidate = format!("{name}_{number}").into();
        }
        self.taken.entry(Arc::clone(&candidate)).or_insert_with(|| (Arc::clone(recorded), exact));
        Ok(candidate)
    }
}

fn graph_part(part: &str) -> String {
    let allowed = |character: char| if character.is_ascii_alphanumeric() { character } else { '_' };
    let clean: String = part.chars().map(allowed).collect();
    if clean.starts_with(|first: char| first.is_ascii_digit()) { format!("_{clean}") } else { clean }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn resolved(names: &[&str]) -> Vec<String> {
        let mut known = RecordedNames::default();
        names
            .iter()
            .map(|&name| known.resolve(&name.into()).map_or_else(str::to_owned, |name| name.to_string()))
            .collect()
    }

    #[test]
    fn names_legal_to_rosbag_get_a_graph_name() {
        let given = ["/odom", "foo", "foo/bar", "ORB-SLAM", "/1num", "/ünï", "/a//b/", "~own"];
        let expected = ["/odom", "/foo", "/foo/bar", "/ORB_SLAM", "/_1num", "/_n_", "/a/b", "/_own"];
        assert_eq!(resolved(&given), expected);
        assert_eq!(resolved(&["", "///"]), ["its topic has no name"; 2]);
        assert_eq!(resolved(&[&"a".repeat(300)]), ["its topic name is longer than 255 bytes"]);
    }

    #[test]
    fn relative_names_join_their_topic_and_others_stay_apart() {
        assert_eq!(resolved(&["odom", "/odom"]), ["/odom", "/odom"]);
        assert_eq!(resolved(&["/a_b", "a-b", "a.b", "a-b"]), ["/a_b", "/a_b_2", "/a_b_3", "/a_b_2"]);
        assert_eq!(resolved(&["a-b", "a_b", "/a_b"]), ["/a_b", "/a_b_2", "/a_b_3"], "met later, they stay apart");
    }

    proptest! {
        #[test]
        fn every_name_given_is_a_graph_name(names in proptest::collection::vec(".{0,300}", 1..20)) {
            let mut known = RecordedNames::default();
            for name in names {
                let name: Arc<str> = name.into();
                if let Ok(resolved) = known.resolve(&name) {
                    prop_assert!(resolved.parse::<TopicName>().is_ok());
                    prop_assert_eq!(known.resolve(&name), Ok(resolved));
                }
            }
        }
    }
}
