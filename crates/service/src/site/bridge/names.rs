//! The names of played topics, and whether they stay apart from captured ones.

use std::collections::HashMap;

use crate::model::TopicName;
use crate::service::command::PlayWishes;
use crate::service::failure::input;
use crate::service::reply::Failure;

pub(super) struct Names {
    prefix: Option<String>,
    remaps: HashMap<String, String>,
}

impl Names {
    pub fn of(wishes: &PlayWishes) -> Result<Self, Failure> {
        let mut remaps = HashMap::new();
        for remap in &wishes.remaps {
            if remaps.insert(remap.from.to_string(), remap.to.to_string()).is_some() {
                return Err(input(format!("{} is remapped twice; give it one name", remap.from)));
            }
        }
        let prefix = wishes.prefix.as_ref().map(TopicName::to_string);
        Ok(Self { prefix, remaps })
    }

    pub fn prefix(&self) -> Option<String> {
        self.prefix.clone()
    }

    pub fn played(&self, topic: &str) -> Option<String> {
        if let Some(name) = self.remaps.get(topic) {
            return Some(name.clone());
        }
        let name = format!("{}{topic}", self.prefix.as_deref().unwrap_or_default());
        name.parse::<TopicName>().ok().map(|name| name.to_string())
    }

    pub fn keep_apart(&self) -> Result<(), String> {
        let why = "the graph that this site captures from; anything played there would be captured again as new:";
        let Some(prefix) = &self.prefix else {
            return Err(format!("{why} give a --prefix such as /shared/alice, or another graph with --to or --ros2"));
        };
        match self.remaps.values().find(|name| !is_under(prefix, name)) {
            Some(name) => Err(format!("{why} remap to a name under {prefix}, unlike {name}")),
            None => Ok(()),
        }
    }
}

pub(super) fn is_under(prefix: &str, name: &str) -> bool {
    name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with('/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(prefix: Option<&str>, remaps: &[&str]) -> Result<Names, Failure> {
        Names::of(&PlayWishes {
            prefix: prefix.map(|prefix| prefix.parse().expect("a name")),
            remaps: remaps.iter().map(|remap| remap.parse().expect("a remapping")).collect(),
            ..PlayWishes::default()
        })
    }

    #[test]
    fn a_prefix_stands_before_every_name_that_is_not_remapped() {
        let names = names(Some("/shared/alice"), &["/odom:=/shared/alice/position"]).expect("names");
        assert_eq!(names.played("/imu").as_deref(), Some("/shared/alice/imu"));
        assert_eq!(names.played("/odom").as_deref(), Some("/shared/alice/position"));
        assert_eq!(names.played("no name"), None);
        assert_eq!(names.keep_apart(), Ok(()));
    }

    #[test]
    fn without_a_prefix_or_with_a_remapping_beside_it_the_captured_graph_is_refused() {
        assert!(names(None, &[]).expect("names").keep_apart().is_err());
        for beside in ["/odom:=/odom", "/odom:=/shared/alicex", "/odom:=/shared"] {
            assert!(names(Some("/shared/alice"), &[beside]).expect("names").keep_apart().is_err(), "{beside}");
        }
        assert_eq!(names(None, &[]).expect("names").played("/odom").as_deref(), Some("/odom"));
    }

    #[test]
    fn one_topic_has_one_name() {
        assert!(names(None, &["/a:=/b", "/a:=/c"]).is_err());
    }
}
