//! Names as ROS 2 writes them into DDS, and as people know them.

/// The longest name accepted.
const LONGEST: usize = 255;

/// The ROS 2 topic that says which node has which writers.
pub const NODES: &str = "ros_discovery_info";

/// `/robot1/odom` for `rt/robot1/odom`; `None` for what is not a ROS 2 topic (services have other prefixes).
pub fn topic(dds: &str) -> Option<String> {
    let name = dds.strip_prefix("rt").filter(|name| name.len() <= LONGEST)?;
    let is_part = |part: &str| {
        part.bytes().next().is_some_and(|byte| byte.is_ascii_alphabetic() || byte == b'_')
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    name.strip_prefix('/')?.split('/').all(is_part).then(|| name.to_owned())
}

/// The DDS name of a topic.
pub fn dds_topic(topic: &str) -> String {
    format!("rt{topic}")
}

/// The DDS names of the topics by which a node is asked for the description of a type, and answers; `None` for what is not
/// the name of a node.
pub fn description_topics(node: &str) -> Option<(String, String)> {
    topic(&dds_topic(node))?;
    Some((format!("rq{node}/get_type_descriptionRequest"), format!("rr{node}/get_type_descriptionReply")))
}

/// `nav_msgs/msg/Odometry` for `nav_msgs::msg::dds_::Odometry_`.
pub fn type_name(dds: &str) -> Option<String> {
    let parts: Vec<&str> = dds.split("::").collect();
    let [package, kind, "dds_", name] = parts[..] else { return None };
    let name = name.strip_suffix('_')?;
    let is_word =
        |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    let known = [package, kind, name].into_iter().all(is_word) && dds.len() <= LONGEST;
    known.then(|| format!("{package}/{kind}/{name}"))
}

/// The DDS name of a type, `nav_msgs::msg::dds_::Odometry_`; `None` for what is not the name of one.
pub fn dds_type(type_name: &str) -> Option<String> {
    let parts: Vec<&str> = type_name.split('/').collect();
    let [package, kind, name] = parts[..] else { return None };
    let dds = format!("{package}::{kind}::dds_::{name}_");
    self::type_name(&dds).is_some_and(|back| back == type_name).then_some(dds)
}

/// The type's hash from a writer's user data, which is `key=value;` after a length, padded.
pub fn type_hash(user_data: &[u8]) -> Option<String> {
    const KEY: &[u8] = b"typehash=";
    let begin = user_data.windows(KEY.len()).position(|window| window == KEY)? + KEY.len();
    let value = user_data[begin..].split(|byte| *byte == b';' || *byte == 0).next()?;
    let text = std::str::from_utf8(value).ok()?;
    let digits = text.strip_prefix("RIHS01_")?;
    (digits.len() == 64 && digits.bytes().all(|byte| byte.is_ascii_hexdigit())).then(|| text.to_owned())
}

/// The maker of a participant's middleware, from the first bytes of its id.
pub fn vendor(id: [u8; 16]) -> String {
    match id[..2] {
        [1, 1] => "connext".to_owned(),
        [1, 3] => "opendds".to_owned(),
        [1, 15] => "fastdds".to_owned(),
        [1, 16] => "cyclonedds".to_owned(),
        [1, 17] => "gurumdds".to_owned(),
        [1, 18] => "rustdds".to_owned(),
        [1, 20] => "dustdds".to_owned(),
        [one, two] => format!("vendor_{one:02x}{two:02x}"),
        _ => "unknown".to_owned(),
    }
}

/// Bytes as hex.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_dds_and_of_people() {
        assert_eq!(topic("rt/robot1/odom").as_deref(), Some("/robot1/odom"));
        for none in ["rq/x", "rt", "rt/", "rtx/y", "rt//x", "rt/1x", "rt/a\u{1b}b", "Square"] {
            assert_eq!(topic(none), None, "{none}");
        }
        assert_eq!(type_name("nav_msgs::msg::dds_::Odometry_").as_deref(), Some("nav_msgs/msg/Odometry"));
        assert_eq!(dds_type("nav_msgs/msg/Odometry").as_deref(), Some("nav_msgs::msg::dds_::Odometry_"));
        for none in ["nav_msgs/Odometry", "a/b/c/d", "a//b", "a/msg/b::c", "a/msg/b c", ""] {
            assert_eq!(dds_type(none), None, "{none}");
        }
        for none in ["ShapeType", "a::msg::dds_::B", "a::msg::B_", "::msg::dds_::B_", "a::msg::dds_::B\u{7}_"] {
            assert_eq!(type_name(none), None, "{none}");
        }
    }

    #[test]
    fn a_node_is_asked_under_its_own_name() {
        let topics = description_topics("/robot1/driver").expect("a name");
        assert_eq!(topics.0, "rq/robot1/driver/get_type_descriptionRequest");
        assert_eq!(topics.1, "rr/robot1/driver/get_type_descriptionReply");
        for none in ["", "/", "driver", "/a//b", "/a b"] {
            assert_eq!(description_topics(none), None, "{none}");
        }
    }

    #[test]
    fn the_hash_is_found_behind_its_length_and_before_the_padding() {
        let digits = "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let data = [b"Q\0\0\0".as_slice(), format!("typehash=RIHS01_{digits};\0\0\0").as_bytes()].concat();
        assert_eq!(type_hash(&data), Some(format!("RIHS01_{digits}")));
        assert_eq!(type_hash(b"\x0a\0\0\0typehash=RIHS01_12;"), None);
        assert_eq!(type_hash(b""), None);
        assert_eq!(type_hash(format!("typehash=RIHS01_{}\u{1b};", &digits[1..]).as_bytes()), None);
    }
}
