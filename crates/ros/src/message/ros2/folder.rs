//! Definitions that no recording brought: installed on this machine, as ROS 2 does it (`share/PACKAGE/msg/TYPE.msg` below a
//! prefix), else those built into this program.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::super::definition::{LONGEST_DEFINITION, MOST_TYPES};
use super::built_in;
use super::line::{Line, parse_line, plain};
use super::schema::{full_name, sections};
use crate::ros::RosError;

/// Where a type's own lines were found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// In a folder of this machine.
    Folders,
    /// Among the common interfaces that are built into this program.
    BuiltIn,
}

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

    /// Whether there is any hope that [`Folders::text_of`] finds this type.
    pub fn may_know(&self, type_name: &str) -> bool {
        !self.is_empty() || full_name(type_name, None).is_some_and(|name| built_in::text_of(&name).is_some())
    }

    /// The text of a type with all the types it consists of, as in MCAP, and where the type itself was found. What no
    /// folder has is taken from the common interfaces.
    ///
    /// # Errors
    /// [`RosError::NoFields`] if a definition is missing, cannot be read or is broken.
    pub fn text_of(&self, type_name: &str) -> Result<(String, Source), RosError> {
        let root = full_name(type_name, None)
            .ok_or_else(|| RosError::no_fields(type_name, "its type is not package/msg/Type"))?;
        let (own, source) = self.own_lines(&root).ok_or_else(|| missing(type_name, &root))?;
        let (whole, _) = self.complete(type_name, &own)?;
        Ok((whole, source))
    }

    /// A type's text, completed with the sections of nested types that it lacks; and the names of these types.
    ///
    /// # Errors
    /// See [`Folders::text_of`].
    pub fn complete(&self, type_name: &str, text: &str) -> Result<(String, Vec<String>), RosError> {
        let failed = |reason: String| RosError::no_fields(type_name, &reason);
        let root = full_name(type_name, None).ok_or_else(|| failed("its type is not package/msg/Type".into()))?;
        let mut own: Vec<(String, Vec<&str>)> = sections(&root, text).map_err(failed)?.into_iter().collect();
        own.sort();
        let mut known: BTreeSet<String> = own.iter().map(|(name, _)| name.clone()).collect();
        let mut waiting = Vec::new();
        for (name, lines) in &own {
            waiting.extend(nested_in(name, &lines.join("\n")).map_err(|reason| failed(format!("{reason} in {name}")))?);
        }
        let (mut whole, mut added) = (text.to_owned(), Vec::new());
        while let Some(name) = waiting.pop() {
            if !known.insert(name.clone()) {
                continue;
            }
            let (text, _) = self.own_lines(&name).ok_or_else(|| missing(type_name, &name))?;
            if !whole.ends_with('\n') {
                whole.push('\n');
            }
            whole.push_str(&format!("{}\nMSG: {}\n", "=".repeat(80), name.replacen("/msg/", "/", 1)));
            whole.push_str(&text);
            waiting.extend(nested_in(&name, &text).map_err(|reason| failed(format!("{reason} in {name}.msg")))?);
            if known.len() > MOST_TYPES || whole.len() > LONGEST_DEFINITION {
                return Err(failed("its definition is too long".into()));
            }
            added.push(name);
        }
        Ok((whole, added))
    }

    /// The lines of one type, with an end of line at their end.
    fn own_lines(&self, name: &str) -> Option<(String, Source)> {
        let here = self.file_of(name).map(|text| (text, Source::Folders));
        let (text, source) = here.or_else(|| Some((built_in::text_of(name)?.to_owned(), Source::BuiltIn)))?;
        Some((format!("{}\n", text.trim_end()), source))
    }

    /// The text of a `.msg` file; `None` if no folder has a readable one of bounded length.
    fn file_of(&self, name: &str) -> Option<String> {
        let mut parts = name.split('/');
        let (package, kind, name) = (parts.next()?, parts.next()?, parts.next()?);
        let file = format!("{name}.msg");
        self.0.iter().find_map(|prefix| read(&prefix.join("share").join(package).join(kind).join(&file)))
    }
}

fn missing(type_name: &str, name: &str) -> RosError {
    let reason = format!("{name}.msg is neither in the installed ROS 2 (ros.definitions) nor built into this program");
    RosError::no_fields(type_name, &reason)
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
        let (text, source) = folders.text_of("a/msg/Root").expect("found");
        assert_eq!(source, Source::Folders);
        assert_eq!(text.matches("MSG: ").count(), 2, "{text}");
        assert!(Definition::parse_ros2("a/msg/Root", &text).is_ok());
        assert!(folders.text_of("a/msg/Nothing").expect_err("missing").to_string().contains("a/msg/Nothing.msg"));
        assert!(folders.text_of("../x").is_err() && folders.text_of("a/msg/..").is_err());
        put("one", "b", "Other", "std_msgs/Header header");
        let (text, _) = folders.text_of("a/Root").expect("what is nested may be built in");
        assert!(text.contains("MSG: builtin_interfaces/Time\nint32 sec\n"), "{text}");
        put("one", "b", "Other", "c/Missing x");
        assert!(folders.text_of("a/Root").expect_err("missing").to_string().contains("c/msg/Missing"));
    }
    #[test]
    fn a_text_is_completed_with_the_nested_types_that_it_lacks() {
        let folders = Folders::default();
        let (text, added) = folders.complete("a/msg/B", "builtin_interfaces/Time stamp\nint32 v").expect("built in");
        assert_eq!(added, ["builtin_interfaces/msg/Time"]);
        assert_eq!(
            Definition::parse_ros2("a/msg/B", &text).map(|it| it.type_name().to_owned()).as_deref(),
            Ok("a/msg/B")
        );
        assert_eq!(folders.complete("a/msg/B", &text).expect("whole"), (text, Vec::new()), "nothing is added twice");
        let (text, added) = folders.complete("a/msg/B", "std_msgs/Header h\ngeometry_msgs/Point p").expect("built in");
        assert_eq!(added.len(), 3, "{text}");
        assert!(folders.complete("a/msg/B", "c/Missing x").is_err());
    }
}
