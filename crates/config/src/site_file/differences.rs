//! The changes a site file would make in a home.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Serialize;

use super::text::terms;
use super::{Decisions, Here, HomeSettings, KnownAccount, SiteFile, holds_secret};
use crate::DEFINITIONS;
use crate::model::{Address, ContactName, Publisher, TopicName, TopicRules, TypeName};

/// One change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "what")]
pub enum Difference {
    /// A setting gets another value.
    Setting {
        /// Its name.
        name: &'static str,
        /// Its value now.
        before: String,
        /// Its value then.
        after: String,
    },
    /// A rule for topics is removed.
    RuleGone {
        /// Its terms.
        rule: String,
    },
    /// A rule for topics is added.
    RuleNew {
        /// Its terms.
        rule: String,
    },
    /// The same rules in another order: the first that matches a topic applies.
    RulesInOrder,
    /// A topic is watched, or watched with another type.
    Watch {
        /// The topic.
        topic: TopicName,
        /// The type requested for it.
        #[serde(rename = "type")]
        type_name: Option<TypeName>,
    },
    /// A topic is no longer watched.
    Unwatch {
        /// The topic.
        topic: TopicName,
    },
    /// A publisher is accepted.
    Pin {
        /// On this topic.
        topic: TopicName,
        /// The publisher.
        publisher: Publisher,
    },
    /// A publisher is no longer accepted.
    Unpin {
        /// On this topic.
        topic: TopicName,
        /// The publisher.
        publisher: Publisher,
    },
    /// An account is removed from the address book.
    RemoveContact {
        /// Its name.
        name: ContactName,
    },
    /// An account is added to the address book.
    AddContact {
        /// Its name.
        name: ContactName,
        /// Its address.
        address: Address,
        /// The fingerprint of its key.
        fingerprint: Option<String>,
    },
    /// An owner may no longer use the gateway.
    Dismiss {
        /// The owner.
        owner: Address,
    },
    /// An owner may use the gateway.
    Admit {
        /// The owner.
        owner: Address,
    },
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let or_nothing = |text: &str| if text.is_empty() { "(nothing)".to_owned() } else { text.to_owned() };
        match self {
            Self::Setting { name, before, after } => {
                write!(formatter, "~ {name}: {} -> {}", or_nothing(before), or_nothing(after))
            }
            Self::RuleGone { rule } => write!(formatter, "- rule {rule}"),
            Self::RuleNew { rule } => write!(formatter, "+ rule {rule}"),
            Self::RulesInOrder => formatter.write_str("~ topic rules: same rules, different order"),
            Self::Watch { topic, type_name: None } => write!(formatter, "+ watch {topic}"),
            Self::Watch { topic, type_name: Some(name) } => write!(formatter, "+ watch {topic}, only {name}"),
            Self::Unwatch { topic } => write!(formatter, "- watch {topic}"),
            Self::Pin { topic, publisher } => write!(formatter, "+ publisher {publisher} of {topic}"),
            Self::Unpin { topic, publisher } => write!(formatter, "- publisher {publisher} of {topic}"),
            Self::RemoveContact { name } => write!(formatter, "- contact {name}"),
            Self::AddContact { name, address, fingerprint: None } => write!(formatter, "+ contact {name} {address}"),
            Self::AddContact { name, address, fingerprint: Some(fingerprint) } => {
                write!(formatter, "+ contact {name} {address} with key {fingerprint}")
            }
            Self::Dismiss { owner } => write!(formatter, "- admitted {owner}"),
            Self::Admit { owner } => write!(formatter, "+ admitted {owner}"),
        }
    }
}

impl Difference {
    /// Whether it concerns `config.toml`, which a running site reads when it starts.
    pub fn is_setting(&self) -> bool {
        match self {
            Self::Setting { .. } | Self::RuleGone { .. } | Self::RuleNew { .. } | Self::RulesInOrder => true,
            Self::Watch { .. }
            | Self::Unwatch { .. }
            | Self::Pin { .. }
            | Self::Unpin { .. }
            | Self::RemoveContact { .. }
            | Self::AddContact { .. }
            | Self::Dismiss { .. }
            | Self::Admit { .. } => false,
        }
    }
}

impl SiteFile {
    /// The changes, in the order of application: removals before additions.
    pub fn differences(&self, home: &HomeSettings, here: &Here) -> Vec<Difference> {
        let mut differences = self.of_settings(home);
        differences.extend(of_rules(&home.rules, &self.rules));
        let Decisions { watches, publishers, contacts, admitted } = &self.decisions;
        differences.extend(watches.iter().flat_map(|wanted| of_watches(here, wanted)));
        differences.extend(publishers.iter().flat_map(|wanted| of_publishers(here, wanted)));
        differences.extend(contacts.iter().flat_map(|wanted| of_contacts(here, wanted)));
        differences.extend(admitted.iter().flat_map(|wanted| of_admitted(here, wanted)));
        differences
    }

    fn of_settings(&self, home: &HomeSettings) -> Vec<Difference> {
        let (now, wanted) = (home.all(), home.wanted(self));
        let changed = DEFINITIONS.iter().filter_map(|definition| {
            let name = definition.name;
            let [before, after] =
                [&now, &wanted].map(|settings| settings.get(name).map_or(definition.default, String::as_str));
            (before != after).then(|| Difference::Setting {
                name,
                before: shown(name, before),
                after: shown(name, after),
            })
        });
        changed.collect()
    }
}

fn of_watches(here: &Here, wanted: &BTreeMap<TopicName, Option<TypeName>>) -> Vec<Difference> {
    let now = here.decisions.watches.clone().unwrap_or_default();
    let gone = now.keys().filter(|topic| !wanted.contains_key(topic)).cloned();
    let new = wanted.iter().filter(|(topic, type_name)| now.get(topic) != Some(type_name));
    let new = new.map(|(topic, type_name)| Difference::Watch { topic: topic.clone(), type_name: type_name.clone() });
    gone.map(|topic| Difference::Unwatch { topic }).chain(new).collect()
}

fn of_publishers(here: &Here, wanted: &BTreeSet<(TopicName, Publisher)>) -> Vec<Difference> {
    let now = here.decisions.publishers.clone().unwrap_or_default();
    let gone = now.difference(wanted).cloned();
    let new = wanted.difference(&now).filter(|pin| !here.seen_first.contains(pin)).cloned();
    let gone = gone.map(|(topic, publisher)| Difference::Unpin { topic, publisher });
    gone.chain(new.map(|(topic, publisher)| Difference::Pin { topic, publisher })).collect()
}

fn of_contacts(here: &Here, wanted: &BTreeMap<ContactName, KnownAccount>) -> Vec<Difference> {
    let now = here.decisions.contacts.clone().unwrap_or_default();
    // If the file does not give a key, the present one stays.
    let same_key = |one: &KnownAccount, other: &KnownAccount| other.fingerprint.is_none() || one == other;
    let is_same = |name: &ContactName| {
        let both = now.get(name).zip(wanted.get(name));
        both.is_some_and(|(one, other)| one.address == other.address && same_key(one, other))
    };
    let gone = now.keys().filter(|name| !is_same(name)).cloned();
    let new = wanted.iter().filter(|(name, _)| !is_same(name)).map(|(name, known)| {
        let KnownAccount { address, fingerprint } = known.clone();
        Difference::AddContact { name: name.clone(), address, fingerprint }
    });
    gone.map(|name| Difference::RemoveContact { name }).chain(new).collect()
}

fn of_admitted(here: &Here, wanted: &BTreeSet<Address>) -> Vec<Difference> {
    let now = here.decisions.admitted.clone().unwrap_or_default();
    let others = |owner: &&Address| !here.own.contains(owner);
    let gone = now.difference(wanted).filter(others).map(|owner| Difference::Dismiss { owner: *owner });
    let new = wanted.difference(&now).filter(others).map(|owner| Difference::Admit { owner: *owner });
    gone.chain(new).collect()
}

fn shown(name: &str, value: &str) -> String {
    if holds_secret(name, value) { "(a value with a secret)".to_owned() } else { value.to_owned() }
}

fn of_rules(now: &TopicRules, wanted: &TopicRules) -> Vec<Difference> {
    let texts = |rules: &TopicRules| rules.0.iter().map(|rule| terms(rule).join(", ")).collect::<Vec<_>>();
    let (now, wanted) = (texts(now), texts(wanted));
    if now == wanted {
        return Vec::new();
    }
    let known = |rules: &[String]| rules.iter().cloned().collect::<BTreeSet<_>>();
    let (here, then) = (known(&now), known(&wanted));
    let gone = here.difference(&then).map(|rule| Difference::RuleGone { rule: rule.clone() });
    let new = then.difference(&here).map(|rule| Difference::RuleNew { rule: rule.clone() });
    let changed: Vec<Difference> = gone.chain(new).collect();
    if changed.is_empty() { vec![Difference::RulesInOrder] } else { changed }
}
