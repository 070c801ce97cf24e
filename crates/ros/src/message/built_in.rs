//! The common messages of ROS 1, for publishers that send no definition. They are derived from the interfaces of ROS 2, and
//! used only where the md5sum proves that they are the same.

use std::collections::BTreeSet;

use super::line::{Line, Primitive, parse_line};
use super::{md5sum, ros2};

/// The header of ROS 1, which has a number that ROS 2 dropped.
const HEADER: (&str, &str) = ("std_msgs/Header", include_str!("../msg/Header.msg"));

/// The most types of one definition.
const MOST: usize = 64;

/// The full definition of a common message type, if there is one with this md5sum (32 hex characters).
pub fn built_in_definition(type_name: &str, sum: &str) -> Option<String> {
    let mut whole = own_text(type_name)?;
    let mut known = BTreeSet::from([type_name.to_owned()]);
    let mut waiting = nested(type_name, &whole);
    while let Some(name) = waiting.pop() {
        if !known.insert(name.clone()) {
            continue;
        }
        if known.len() > MOST {
            return None;
        }
        let text = own_text(&name)?;
        waiting.extend(nested(&name, &text));
        whole.push_str(&format!("\n{}\nMSG: {name}\n{text}", "=".repeat(80)));
    }
    (md5sum(type_name, &whole).ok()? == sum).then_some(whole)
}

/// The own lines of a type named `package/Type`, as ROS 1 has them.
fn own_text(name: &str) -> Option<String> {
    if name == HEADER.0 {
        return Some(HEADER.1.to_owned());
    }
    let (package, bare) = name.split_once('/')?;
    let text = ros2::interface(&format!("{package}/msg/{bare}"))?;
    let lines = text.lines().filter(|line| !line.starts_with("===="));
    let in_ros1 = |line: &str| {
        let (kind, rest) = line.split_once(' ').unwrap_or((line, ""));
        let (base, array) = kind.find('[').map_or((kind, ""), |at| kind.split_at(at));
        let base = match base {
            "builtin_interfaces/Time" => "time",
            "builtin_interfaces/Duration" => "duration",
            other => other,
        };
        format!("{base}{array} {rest}")
    };
    Some(lines.map(in_ros1).collect::<Vec<_>>().join("\n"))
}

/// The types that a text names, as `package/Type`.
fn nested(inside: &str, text: &str) -> Vec<String> {
    let package = inside.split('/').next().unwrap_or_default();
    let base = |line: &str| match parse_line(line) {
        Ok(Some(Line::Field { base, .. })) if Primitive::parse(base).is_none() => {
            Some(if base.contains('/') { base.to_owned() } else { format!("{package}/{base}") })
        }
        _ => None,
    };
    text.lines().filter_map(base).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_messages_are_known_by_the_md5sum_that_ros_computes() {
        // As `rosmsg md5` of Debian prints them.
        for (name, sum) in [
            ("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1"),
            ("sensor_msgs/Imu", "6a62c6daae103f4ff57a132d6f95cec2"),
            ("nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7"),
            ("sensor_msgs/CompressedImage", "8f7a12909da2c9d3332d540a0977563f"),
            ("sensor_msgs/LaserScan", "90c7ef2dc6895d81024acba2ac42f369"),
            ("geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a"),
            ("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec"),
        ] {
            let text = built_in_definition(name, sum).unwrap_or_else(|| panic!("{name} is not known"));
            assert_eq!(md5sum(name, &text).as_deref(), Ok(sum));
        }
        assert_eq!(built_in_definition("std_msgs/String", "d41d8cd98f00b204e9800998ecf8427e"), None, "another md5sum");
        assert_eq!(built_in_definition("a/B", "992ce8a1687cec8c8bd883ec73ca41d1"), None);
        assert_eq!(built_in_definition("no slash", "x"), None);
    }
}
