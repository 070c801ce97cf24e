//! ROS graph names: topics and message types.

use crate::clean;
use crate::text::{as_text, is_name, names};

/// The longest topic or type name accepted, in bytes.
pub const LONGEST_NAME: usize = 255;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    #[error(
        "'{0}' is not a topic name; it must start with /, and each part is letters, digits and _, starting with a \
         letter, as in /robot1/odom"
    )]
    Topic(String),
    #[error("'{0}' is not a message type; use package/Type, as in nav_msgs/Odometry")]
    Type(String),
}

/// Prefix of the names under which the program files its own statements.
const STATEMENTS: &str = "authros/";

/// Whether a record may be filed under this name: a topic's, or that of the program's own statements (`authros/…`).
pub fn is_record_topic(name: &str) -> bool {
    let fits = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
    let is_word = |part: &str| is_name(part, LONGEST_NAME, fits, fits);
    match name.strip_prefix(STATEMENTS) {
        Some(rest) => name.len() <= LONGEST_NAME && rest.split('/').all(is_word),
        None => name.parse::<TopicName>().is_ok(),
    }
}

fn is_part(part: &str) -> bool {
    let begins = |b: u8| b.is_ascii_alphabetic() || b == b'_';
    is_name(part, LONGEST_NAME, begins, |b| begins(b) || b.is_ascii_digit())
}

/// A resolved, absolute ROS topic name such as `/robot1/odom`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicName(String);

/// A message type, `package/Type`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeName(String);

names! {
    TopicName: |text| {
        text.len() <= LONGEST_NAME && text.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_part))
    }, else NameError by |text| NameError::Topic(clean(text, 80));
    TypeName: |text| {
        let parts = text.split_once('/');
        text.len() <= LONGEST_NAME && parts.is_some_and(|(package, name)| is_part(package) && is_part(name))
    }, else NameError by |text| NameError::Type(clean(text, 80));
}
as_text!(TopicName, TypeName);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topic_names() {
        for good in ["/odom", "/robot1/camera/compressed", "/a/_hidden/b2"] {
            assert!(good.parse::<TopicName>().is_ok(), "{good}");
        }
        for bad in ["", "/", "odom", "/1x", "/a//b", "/a/", "/a b", "/a\u{202e}b", "~x"] {
            assert!(bad.parse::<TopicName>().is_err(), "{bad}");
        }
        assert!(format!("/{}", "a".repeat(300)).parse::<TopicName>().is_err());
    }

    #[test]
    fn records_are_filed_under_topics_and_statements() {
        for good in ["/odom", "authros/audit", "authros/keys/00ff"] {
            assert!(is_record_topic(good), "{good}");
        }
        for bad in ["", "authros", "authros/", "authros//a", "authros/a b", "authros/a\n", "other/a", "/a\nb"] {
            assert!(!is_record_topic(bad), "{bad}");
        }
    }

    #[test]
    fn type_names() {
        assert!("nav_msgs/Odometry".parse::<TypeName>().is_ok());
        for bad in ["Odometry", "a/b/c", "/a/b", "*", "a/"] {
            assert!(bad.parse::<TypeName>().is_err(), "{bad}");
        }
    }
}
