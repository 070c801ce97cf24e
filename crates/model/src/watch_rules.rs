//! What a profile watches: topics by name, and patterns that also cover the topics of later robots. The last rule that
//! matches a topic decides.

use serde::{Deserialize, Serialize};

use crate::{Sampling, TopicPattern, TypeName};

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WatchRule {
    pub pattern: TopicPattern,
    /// Messages of other types are not captured.
    pub type_name: Option<TypeName>,
    /// How many messages are kept; `None` = as the settings say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sampling: Option<Sampling>,
    /// Not watched, whatever an earlier rule says.
    pub except: bool,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WatchRules(pub Vec<WatchRule>);

impl WatchRules {
    /// The rule by which a topic is watched.
    pub fn of(&self, topic: &str) -> Option<&WatchRule> {
        self.0.iter().rfind(|rule| rule.pattern.matches(topic)).filter(|rule| !rule.except)
    }

    /// Topics watched by name, whether or not somebody publishes them.
    pub fn named(&self) -> impl Iterator<Item = &WatchRule> {
        let plain = self.0.iter().filter(|rule| rule.pattern.is_plain());
        plain.filter(move |rule| self.of(rule.pattern.as_str()).is_some_and(|decides| decides == *rule))
    }

    /// Whether topics that come later may be watched.
    pub fn has_patterns(&self) -> bool {
        self.0.iter().any(|rule| !rule.except && !rule.pattern.is_plain())
    }

    pub fn watch(&mut self, pattern: TopicPattern, type_name: Option<TypeName>, sampling: Option<Sampling>) {
        self.0.retain(|rule| rule.pattern != pattern);
        self.0.push(WatchRule { pattern, type_name, sampling, except: false });
    }

    /// False if nothing that was watched matches the pattern.
    pub fn unwatch(&mut self, pattern: &TopicPattern) -> bool {
        let before = self.0.len();
        let is_within = |rule: &WatchRule| rule.pattern.is_plain() && pattern.matches(rule.pattern.as_str());
        self.0.retain(|rule| rule.pattern != *pattern && (rule.except || !is_within(rule)));
        let removed = self.0.len() < before;
        // What other patterns cover stays covered without an exception.
        let covered = match pattern.name() {
            Some(name) => self.of(name.as_str()).is_some(),
            None => self.has_patterns(),
        };
        if covered {
            self.0.push(WatchRule { pattern: pattern.clone(), type_name: None, sampling: None, except: true });
        }
        let mut covers = false;
        self.0.retain(|rule| {
            covers |= !rule.except && !rule.pattern.is_plain();
            covers || !rule.except
        });
        removed || covered
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pattern(text: &str) -> TopicPattern {
        text.parse().expect(text)
    }

    fn rules(texts: &[&str]) -> WatchRules {
        let mut rules = WatchRules::default();
        texts.iter().for_each(|text| rules.watch(pattern(text), None, None));
        rules
    }

    #[test]
    fn a_pattern_covers_what_comes_later_and_an_exception_stays() {
        let mut rules = rules(&["/robot*/odom", "/tf"]);
        assert!(rules.of("/robot30/odom").is_some() && rules.of("/tf").is_some() && rules.of("/robot1/imu").is_none());
        assert!(rules.unwatch(&pattern("/robot2/*")));
        assert!(rules.of("/robot2/odom").is_none() && rules.of("/robot3/odom").is_some());
        assert!(rules.unwatch(&pattern("/robot3/odom")) && rules.of("/robot3/odom").is_none());
        rules.watch(pattern("/robot2/odom"), None, None);
        assert!(rules.of("/robot2/odom").is_some(), "the last one decides");
        assert!(rules.unwatch(&pattern("/robot*/odom")));
        assert_eq!(rules, super::tests::rules(&["/tf"]), "exceptions go with the last pattern");
        assert!(!rules.unwatch(&pattern("/robot*/odom")) && !rules.unwatch(&pattern("/imu")));
    }

    #[test]
    fn a_topic_keeps_the_type_of_the_rule_that_decides() {
        let mut rules = rules(&["/robot1/odom"]);
        let odometry: TypeName = "nav_msgs/Odometry".parse().expect("a type");
        rules.watch(pattern("/robot*/odom"), Some(odometry.clone()), None);
        assert_eq!(rules.of("/robot1/odom").and_then(|rule| rule.type_name.clone()), Some(odometry));
        assert_eq!(rules.named().count(), 0, "the pattern decides");
        assert!(rules.unwatch(&pattern("/robot*/odom")));
        assert!(rules.of("/robot1/odom").is_none(), "it goes with the pattern that covers it");
    }

    #[test]
    fn the_rule_that_decides_says_how_many_messages_are_kept() {
        let one_in = |every| Some(Sampling { rate: None, every: Some(every) });
        let mut rules = WatchRules::default();
        rules.watch(pattern("/robot*/odom"), None, one_in(10));
        rules.watch(pattern("/robot2/odom"), None, one_in(2));
        let kept = |rules: &WatchRules, topic: &str| rules.of(topic).and_then(|rule| rule.sampling);
        assert_eq!([kept(&rules, "/robot1/odom"), kept(&rules, "/robot2/odom")], [one_in(10), one_in(2)]);
        rules.watch(pattern("/robot*/odom"), None, None);
        assert_eq!([kept(&rules, "/robot1/odom"), kept(&rules, "/robot2/odom")], [None, None], "the last one decides");
    }

    proptest! {
        #[test]
        fn after_a_change_its_topics_are_as_it_says(
            steps in prop::collection::vec(("/(r1|r2|r\\*|\\*\\*|\\*)(/(a|b|\\*|\\*\\*))?", any::<bool>()), 1..12),
        ) {
            let topics = ["/r1/a", "/r1/b", "/r2/a", "/r2/b", "/r1", "/r2/a/b"];
            let mut rules = WatchRules::default();
            let mut watched = [false; 6];
            for (text, watches) in steps {
                let pattern = pattern(&text);
                if watches {
                    rules.watch(pattern.clone(), None, None);
                } else {
                    rules.unwatch(&pattern);
                }
                for (topic, watched) in topics.iter().zip(&mut watched) {
                    *watched = if pattern.matches(topic) { watches } else { *watched };
                    prop_assert_eq!(rules.of(topic).is_some(), *watched, "{} after {}", topic, text);
                }
            }
        }
    }
}
