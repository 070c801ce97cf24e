//! The common interfaces of ROS 2, for messages that come without their definition.

use std::collections::HashMap;
use std::sync::LazyLock;

static TEXTS: LazyLock<HashMap<&'static str, &'static str>> =
    LazyLock::new(|| sections(include_str!("interfaces.txt")).collect());

/// Each type's name and its own lines.
fn sections(text: &'static str) -> impl Iterator<Item = (&'static str, &'static str)> {
    text.split("\nMSG: ").skip(1).map(|section| section.split_once('\n').unwrap_or((section, "")))
}

/// The own lines of a type that is named as `package/msg/Type`.
pub(in super::super) fn text_of(name: &str) -> Option<&'static str> {
    TEXTS.get(name).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_type_stands_there_once_and_one_without_members_too() {
        let all: Vec<_> = sections(include_str!("interfaces.txt")).collect();
        assert_eq!((all.len(), TEXTS.len()), (162, 162));
        assert_eq!(text_of("std_msgs/msg/Empty"), Some(""));
        assert_eq!(text_of("std_msgs/msg/String").map(str::trim), Some("string data"));
        assert_eq!(text_of("std_msgs/String"), None);
    }
}
