//! Definitions installed on this machine, as ROS 2 does it: `share/PACKAGE/msg/TYPE.msg` below a prefix.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::super::definition::{LONGEST_DEFINITION, MOST_TYPES};
use super::line::{Line, parse_line, plain};
use super::schema::full_name;
use crate::ros::RosError;

/// Folders searched for definitions, in this order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Folders(Vec<PathBuf>);

impl Folders {
    /// The prefixes from a list like `AMENT_PREFIX_PATH`.
    pub fn of_prefixes(list: &OsStr) -> Self {
        Self(std::env::split_paths(list).filter(|prefix| prefix.is_absolute()).collect())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The text of a type with all the types it consists of, as in MCAP.
    ///
    /// # Errors
    /// [`RosError::NoFields`] if a file is missing, cannot be read or is broken.
    pub fn text_of(&self, type_name: &str) -> Result<String, RosError> {
        let failed = |reason: String| RosError::no_fields(type_name, &reason);
        let root = full_name(type_name, None).ok_or_else(|| failed("its type is not package/msg/Type".into()))?;
        let (mut known, mut waiting, mut whole) = (BTreeSet::from([root.clone()]), vec![root.clone()], String::new());
        while let Some(name) = waiting.pop() {
            let text = self
                .file_of(&name)
                .ok_or_else(|| failed(format!("no {name}.msg was found where ROS 2 is installed (ros.definitions)")))?;
            if name != root {
                whole.push_str(&format!("{}\nMSG: {}\n", "=".repeat(80), name.replacen("/msg/", "/", 1)));
            }
            whole.push_str(text.trim_end());
            whole.push('\n');
            for nested in nested_in(&name, &text).map_err(|reason| failed(format!("{reason} in {name}.msg")))? {
                if known.insert(nested.clone()) {
                    waiting.push(nested);
                }
            }
            if known.len() > MOST_TYPES || whole.len() > LONGEST_DEFINITION {
                return Err(failed("its definition is too long".into()));
            }
        }
        Ok(whole)
    }

    /// The text of a `.msg` file; `None` if no folder has a readable one of bounded length.
    fn file_of(&self, name: &str) -> Option<String> {
        let mut parts = name.split('/');
        let (package, kind, name) = (parts.next()?, parts.next()?, parts.next()?);
        let file = format!("{name}.msg");
        self.0.iter().find_map(|prefix| read(&prefix.join("share").join(package).join(kind).join(&file)))
    }
}

fn read(path: &Path) -> Option<String> {
    let mut text = String::new();
    let most = LONGEST_DEFINITION as u64;
    File::open(path).ok()?.take(most + 1).read_to_string(&mut text).ok().filter(|length| *length as u64 <= most)?;
    Some(text)
}

/// The types that a text names.
fn nested_in(name: &str, text: &str) -> Result<Vec<String>, &'static str> {
    let package = name.split('/').next();
    let mut nested = Vec::new();
    for line in text.lines() {
        let Some(Line::Field { base, .. }) = parse_line(line)? else { continue };
        if plain(base).is_none() {
            nested.push(full_name(base, package).ok_or("a type's name is broken")?);
        }
    }
    Ok(nested)
}

#[cfg(test)]
mod tests {
    use super::super::super::Definition;
    use super::*;

    #[test]
    fn a_type_is_gathered_from_the_folders_of_its_packages() {
        let home = tempfile::tempdir().expect("a folder");
        let put = |prefix: &str, package: &str, name: &str, text: &str| {
            let folder = home.path().join(prefix).join("share").join(package).join("msg");
            std::fs::create_dir_all(&folder).expect("created");
            std::fs::write(folder.join(format!("{name}.msg")), text).expect("written");
        };
        put("one", "a", "Root", "Part[] parts\nb/Other other\nPart again");
        put("two", "a", "Part", "uint8 x # small");
        put("two", "b", "Other", "string<=5 text");
        let list = std::env::join_paths(["one", "two"].map(|prefix| home.path().join(prefix))).expect("a list");
        let folders = Folders::of_prefixes(&list);
        let text = folders.text_of("a/msg/Root").expect("found");
        assert_eq!(text.matches("MSG: ").count(), 2, "{text}");
        assert!(Definition::parse_ros2("a/msg/Root", &text).is_ok());
        assert!(folders.text_of("a/msg/Nothing").expect_err("missing").to_string().contains("a/msg/Nothing.msg"));
        assert!(folders.text_of("../x").is_err() && folders.text_of("a/msg/..").is_err());
        put("one", "b", "Other", "c/Missing x");
        assert!(folders.text_of("a/Root").expect_err("missing").to_string().contains("c/msg/Missing"));
    }
}
