//! Who may publish a topic: caller id, host, type and definition sum, all mere claims of the publisher.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::topic::{LONGEST_NAME, TypeName};
use super::{TopicName, clean};
use crate::text::is_name;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PublisherError {
    #[error(
        "'{0}' is not a publisher; use CALLER_ID@HOST:TYPE:MD5, such as \
         /driver@127.0.0.1:std_msgs/String:992ce8a1687cec8c8bd883ec73ca41d1; for ROS 2 the host is domain0 (the \
         domain's number) and the md5sum is the type's hash, RIHS01_ and 64 digits; * stands for an unknown hash"
    )]
    Publisher(String),
    #[error("'{0}' is not TOPIC=CALLER_ID@HOST:TYPE:MD5; separate several with commas")]
    Listed(String),
}

/// A publisher as written in pins, `CALLER_ID@HOST:TYPE:MD5`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Publisher {
    /// Its node name, as [`pinned_name`] has it. A peer may send any text: clean it before it is shown.
    pub caller_id: String,
    /// The host in its URI, in lower case.
    pub host: String,
    /// Message type, `package/Type`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// The type's md5sum, 32 hex digits in lower case; for ROS 2 the 64 of its hash; `*` if the publisher tells none.
    pub md5sum: String,
}

/// Prefix of a ROS 2 type hash.
const HASH: &str = "RIHS01_";

/// Hex digits of an md5sum, and of a type hash.
const SUM: usize = 32;
const LONGEST_SUM: usize = 64;

impl fmt::Display for Publisher {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lead = if self.md5sum.len() == LONGEST_SUM { HASH } else { "" };
        write!(formatter, "{}@{}:{}:{lead}{}", self.caller_id, self.host, self.type_name, self.md5sum)
    }
}

impl FromStr for Publisher {
    type Err = PublisherError;

    fn from_str(text: &str) -> Result<Self, PublisherError> {
        parse(text).ok_or_else(|| PublisherError::Publisher(clean(text, 120)))
    }
}

/// Node names of tools that end in their process number.
const BY_PROCESS: [&str; 4] = ["_ros2cli_", "launch_ros_", "rqt_gui_py_node_", "rqt_gui_cpp_node_"];
/// This many digits are a time or a random number, not part of a given name.
const DRAWN_DIGITS: usize = 13;

fn are_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The name by which a node is pinned: `#` replaces the digits (time, random number, process) that an anonymous node of
/// ROS draws at each start, so that every run has one name: `/talker_#`.
pub fn pinned_name(caller_id: &str) -> Cow<'_, str> {
    let begin = caller_id.rfind('/').map_or(0, |at| at + 1);
    let own = caller_id.get(begin..).unwrap_or_default();
    let tool = BY_PROCESS.iter().find(|tool| own.strip_prefix(**tool).is_some_and(are_digits));
    if let Some(tool) = tool {
        return format!("{}{tool}#", caller_id.get(..begin).unwrap_or_default()).into();
    }
    let drawn = |(_, digits): &(&str, &str)| digits.len() >= DRAWN_DIGITS && are_digits(digits);
    let Some((stem, drawn)) = own.rsplit_once('_').filter(drawn) else { return caller_id.into() };
    // rospy and roslaunch put the process number first; roscpp has 19 digits alone. Shorter numbers belong to the name.
    let shortest = if drawn.len() == DRAWN_DIGITS { 1 } else { 3 };
    let process = |(_, digits): &(&str, &str)| (shortest..=7).contains(&digits.len()) && are_digits(digits);
    let stem = stem.rsplit_once('_').filter(process).map_or(stem, |(stem, _)| stem);
    if stem.is_empty() {
        return caller_id.into();
    }
    format!("{}{stem}_#", caller_id.get(..begin).unwrap_or_default()).into()
}

fn parse(text: &str) -> Option<Publisher> {
    let (rest, md5sum) = text.rsplit_once(':')?;
    let (rest, type_name) = rest.rsplit_once(':')?;
    let (caller_id, host) = rest.rsplit_once('@')?;
    let fits = |b: u8| b.is_ascii_alphanumeric() || b"/_".contains(&b);
    let named = caller_id.starts_with('/')
        && (2..=LONGEST_NAME).contains(&caller_id.len())
        && caller_id.strip_suffix("_#").unwrap_or(caller_id).bytes().all(fits);
    let of_host = |b: u8| b.is_ascii_alphanumeric() || b"-._:%".contains(&b);
    let placed = is_name(host, LONGEST_NAME, of_host, of_host);
    // ROS 2 has `msg` between package and type.
    let typed = type_name.replacen("/msg/", "/", 1).parse::<TypeName>().is_ok();
    let md5sum = md5sum.strip_prefix(HASH).filter(|hash| hash.len() == LONGEST_SUM).unwrap_or(md5sum);
    let are_digits = || md5sum.bytes().all(|b| b.is_ascii_hexdigit());
    let summed = md5sum == "*" || [SUM, LONGEST_SUM].contains(&md5sum.len()) && are_digits();
    (named && placed && typed && summed).then(|| Publisher {
        caller_id: pinned_name(caller_id).into_owned(),
        host: host.to_ascii_lowercase(),
        type_name: type_name.to_owned(),
        md5sum: md5sum.to_ascii_lowercase(),
    })
}

/// Publishers allowed by the settings, topic by topic: `TOPIC=CALLER_ID@HOST:TYPE:MD5, …`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ListedPublishers(pub Vec<(TopicName, Publisher)>);

impl FromStr for ListedPublishers {
    type Err = PublisherError;

    fn from_str(text: &str) -> Result<Self, PublisherError> {
        let one = |entry: &str| {
            let listed = entry.split_once('=').and_then(|(topic, publisher)| {
                Some((topic.trim().parse::<TopicName>().ok()?, parse(publisher.trim())?))
            });
            listed.ok_or_else(|| PublisherError::Listed(clean(entry.trim(), 120)))
        };
        let entries = text.split(',').filter(|entry| !entry.trim().is_empty());
        entries.map(one).collect::<Result<_, _>>().map(Self)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PinMode {
    /// The first ones seen, if none are named.
    #[default]
    First,
    /// Only those named by the operator or the settings.
    List,
    /// Anyone may publish; nothing is quarantined.
    Off,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    New,
    /// A pinned caller id, but another host.
    Host,
    /// A pinned caller id and host, but another type or definition.
    Type,
    /// Identical to a pinned publisher, but registered while that one was still there.
    Replaced,
    /// Identical to a pinned publisher after such a replacement, and the operator has not decided about it.
    Undecided,
    /// Announced by somebody other than the master.
    Unconfirmed,
}

crate::words!(Doubt);

impl Doubt {
    pub const ALL: [Self; 6] = [Self::New, Self::Host, Self::Type, Self::Replaced, Self::Undecided, Self::Unconfirmed];

    pub fn text(self) -> &'static str {
        match self {
            Self::New => "it is not a pinned publisher",
            Self::Host => "the pinned publisher of this name is on another host",
            Self::Type => "the pinned publisher of this name sends another type",
            Self::Replaced => "it registered under the pinned publisher's name while that publisher was still running",
            Self::Undecided => "a publisher of this name was replaced, and nobody has decided yet which one is genuine",
            Self::Unconfirmed => "the master does not list it, so no connection was made",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MD5: &str = "992ce8a1687cec8c8bd883ec73ca41d1";

    #[test]
    fn good_ones_and_bad_ones() {
        let text = format!("/ns/driver@Robot-1.local:std_msgs/String:{}", MD5.to_uppercase());
        let publisher: Publisher = text.parse().expect("good");
        assert_eq!((publisher.caller_id.as_str(), publisher.host.as_str()), ("/ns/driver", "robot-1.local"));
        assert_eq!(publisher.to_string(), format!("/ns/driver@robot-1.local:std_msgs/String:{MD5}"));
        let six: Publisher = format!("/a@::1:a/B:{MD5}").parse().expect("IPv6");
        assert_eq!((six.host.as_str(), six.type_name.as_str()), ("::1", "a/B"));
        for bad in ["", "/a", "/a@h:a/B", "a@h:a/B:MD5", "/@h:a/B:MD5", "/a@:a/B:MD5", "/a@h:aB:MD5", "/a b@h:a/B:MD5"]
        {
            assert!(bad.replace("MD5", MD5).parse::<Publisher>().is_err(), "{bad}");
        }
        assert!(format!("/a@h:a/B:{}", &MD5[1..]).parse::<Publisher>().is_err());
    }

    #[test]
    fn a_publisher_of_ros_2_is_named_by_its_type_s_hash() {
        let text = format!("/talker@domain0:std_msgs/msg/String:RIHS01_{MD5}{MD5}");
        let publisher: Publisher = text.parse().expect("good");
        assert_eq!((publisher.md5sum.as_str(), publisher.type_name.as_str()), (&*MD5.repeat(2), "std_msgs/msg/String"));
        assert_eq!(publisher.to_string(), text);
        assert_eq!(text.replace("RIHS01_", "").parse(), Ok(publisher));
        let none: Publisher = "/talker@domain0:std_msgs/msg/String:*".parse().expect("it tells none");
        assert_eq!(none.to_string(), "/talker@domain0:std_msgs/msg/String:*");
        for bad in [format!("RIHS01_{MD5}"), format!("RIHS02_{MD5}{MD5}"), format!("{MD5}{}", &MD5[1..]), "**".into()] {
            assert!(format!("/a@domain0:a/msg/B:{bad}").parse::<Publisher>().is_err(), "{bad}");
        }
        assert!(format!("/a@domain0:a/msg/B/C:{MD5}").parse::<Publisher>().is_err());
    }

    #[test]
    fn every_run_of_an_anonymous_node_has_one_name() {
        for (given, pinned) in [
            // roscpp, rospy, roslaunch's anon, then tools of ROS 2.
            ("/ns/driver_1609459200123456789", "/ns/driver_#"),
            ("/driver_2_1609459200123456789", "/driver_2_#"),
            ("/driver_4711_1609459200123", "/driver_#"),
            ("/driver_robot1_4711_1234567890123456789", "/driver_robot1_#"),
            ("/_ros2cli_4711", "/_ros2cli_#"),
            ("/ns/launch_ros_4711", "/ns/launch_ros_#"),
            ("/driver_#", "/driver_#"),
        ] {
            assert_eq!(pinned_name(given), pinned, "{given}");
            let publisher = format!("{given}@h:a/B:{MD5}").parse::<Publisher>().expect("a publisher");
            assert_eq!(publisher.caller_id, pinned);
        }
        for own in ["/driver", "/driver_2", "/camera_0012345678", "/_1609459200123456789", "/1609459200123456789", ""] {
            assert_eq!(pinned_name(own), own);
        }
        assert!(format!("/a_#b@h:a/B:{MD5}").parse::<Publisher>().is_err());
    }

    #[test]
    fn lists() {
        let text = format!("/t=/a@h:a/B:{MD5}, /u=/b@h:a/B:{MD5} ,");
        let listed: ListedPublishers = text.parse().expect("a list");
        let topics: Vec<&str> = listed.0.iter().map(|(topic, _)| topic.as_str()).collect();
        assert_eq!(topics, ["/t", "/u"]);
        assert_eq!("".parse(), Ok(ListedPublishers::default()));
        assert!(format!("/a@h:a/B:{MD5}").parse::<ListedPublishers>().is_err());
    }

    #[test]
    fn every_doubt_has_its_own_word() {
        let mut words: Vec<&str> = Doubt::ALL.iter().map(|doubt| doubt.word()).collect();
        words.sort_unstable();
        words.dedup();
        assert_eq!(words.len(), Doubt::ALL.len());
    }

    proptest! {
        #[test]
        fn round_trip(caller in "/[a-zA-Z0-9_/]{1,40}", host in "[a-z0-9.:-]{1,30}", type_name in "[a-z_]{1,9}/[A-Z][a-z]{0,9}",
                      md5sum in "[0-9a-f]{32}|[0-9a-f]{64}|[*]") {
            let publisher = Publisher { caller_id: caller, host, type_name, md5sum };
            prop_assert_eq!(publisher.to_string().parse(), Ok(publisher));
        }

        #[test]
        fn noise_never_panics(text in any::<String>(), tail in "[ -~]{0,60}") {
            for noise in [&text, &tail, &format!("/a@{tail}:a/B:{MD5}")] {
                if let Ok(publisher) = noise.parse::<Publisher>() {
                    prop_assert_eq!(publisher.to_string().parse(), Ok(publisher));
                }
                let _ = noise.parse::<ListedPublishers>();
            }
        }
    }
}
