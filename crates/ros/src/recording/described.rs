//! The definition that a recorded message is read by.

use std::sync::Arc;

use super::Encoding;
use crate::ros::message::{Definition, Folders, Source, built_in_definition, plain_text, type_hash};
use crate::ros::{Result, RosError};

/// MCAP's name for the hash of a channel's type.
pub const TYPE_HASH: &str = "topic_type_hash";

#[derive(Debug, Clone, Copy)]
pub struct TypeFacts<'a> {
    pub name: &'a str,
    pub encoding: Encoding,
    /// An empty definition counts as none, unless its messages are empty too.
    pub text: Option<&'a str>,
    /// Of ROS 1; `*` or empty if unknown.
    pub md5sum: &'a str,
    /// As given in the recording; empty = none.
    pub hash: Option<&'a str>,
}

#[derive(Debug, Clone, Default)]
pub struct Described {
    /// `None` if only the bytes can be shown.
    pub definition: Option<Arc<Definition>>,
    /// Why there is none, or a doubt about it.
    pub note: Option<String>,
}

impl Described {
    /// From the recording; for ROS 2 otherwise from `folders`, or built in.
    pub fn of(facts: TypeFacts<'_>, folders: &Folders) -> Self {
        let text = facts.text.filter(|text| !text.trim().is_empty()).or(has_no_fields(facts).then_some(""));
        let text = text.map(|text| plain_text(facts.name, text));
        let facts = TypeFacts { text: text.as_deref(), hash: facts.hash.filter(|hash| !hash.is_empty()), ..facts };
        let own = own(facts).map(|definition| (definition, None));
        let found = match own.or_else(|error| completed(facts, folders).ok_or(error)) {
            Ok((definition, note)) => Ok((definition, note.or_else(|| differs(facts)))),
            Err(_) if facts.encoding != Encoding::Ros1 && folders.may_know(facts.name) => {
                let note = |source| format!("fields are read by {}: {}", words(source), trust(facts));
                elsewhere(facts, folders).map(|(definition, source)| (definition, Some(note(source))))
            }
            Err(error) => Err(error),
        };
        match found {
            Ok((definition, note)) => Self { definition: Some(Arc::new(definition)), note },
            Err(error) => Self { definition: None, note: Some(error.to_string()) },
        }
    }
}

const NOTHING: &str = "d41d8cd98f00b204e9800998ecf8427e";

/// Whether an empty text is the whole definition: by its md5sum or hash the type has no fields.
fn has_no_fields(facts: TypeFacts<'_>) -> bool {
    match facts.encoding {
        Encoding::Ros1 => facts.md5sum == NOTHING,
        Encoding::Cdr { .. } => {
            facts.hash.is_some_and(|hash| type_hash(facts.name, "").is_ok_and(|empty| empty == hash))
        }
        Encoding::Beside(_) => false,
    }
}

fn own(facts: TypeFacts<'_>) -> Result<Definition> {
    let no_fields = |reason: &str| Err(RosError::no_fields(facts.name, reason));
    match (facts.encoding, facts.text) {
        (Encoding::Cdr { .. }, None) => no_fields(
            "its definition is in no record that can be read here; give the directory where its package is installed \
             (ros.definitions, AMENT_PREFIX_PATH)",
        ),
        (Encoding::Ros1, None) => {
            no_fields("its publisher sent no definition, or it is in no record that can be read here; write it as .bin")
        }
        (Encoding::Ros1, Some(text)) => Definition::parse(facts.name, text),
        // rosbag2 describes records of `ros2 bag record --service` by the service.
        (Encoding::Cdr { idl: false }, Some(text)) if text.lines().any(|line| line.trim() == "---") => no_fields(
            "the recording describes a service, not a message; events of services are kept as bytes, write it as .bin",
        ),
        (Encoding::Cdr { idl: false }, Some(text)) => Definition::parse_ros2(facts.name, text),
        (Encoding::Cdr { idl: true }, Some("")) => Definition::parse_ros2(facts.name, ""),
        (Encoding::Beside(_), _) => no_fields("it is an attachment to a recording, not a message"),
        (Encoding::Cdr { idl: true }, Some(_)) => no_fields(
            "the recording describes its type in IDL, which is not supported; give the directory where its package is \
             installed (ros.definitions, AMENT_PREFIX_PATH)",
        ),
    }
}

/// The recording's definition, completed; with a note on the source of the rest.
fn completed(facts: TypeFacts<'_>, folders: &Folders) -> Option<(Definition, Option<String>)> {
    match (facts.encoding, facts.text) {
        (Encoding::Ros1, None) => {
            let text = built_in_definition(facts.name, facts.md5sum)?;
            let note = "its publisher sent no definition; fields are read by the definition built into this program, \
                        whose md5sum matches";
            Some((Definition::parse(facts.name, &text).ok()?, Some(note.to_owned())))
        }
        (Encoding::Cdr { idl: false }, Some(text)) => {
            let (text, added) = folders.complete(facts.name, text).ok().filter(|(_, added)| !added.is_empty())?;
            let added = crate::model::clean(&added.join(", "), 200);
            let note = format!("its definition lacks {added}: taken from this machine or built into this program");
            Some((Definition::parse_ros2(facts.name, &text).ok()?, Some(note)))
        }
        _ => None,
    }
}

/// From the folders; if they have none or another one, built in.
fn elsewhere(facts: TypeFacts<'_>, folders: &Folders) -> Result<(Definition, Source)> {
    let found = found_by(facts, folders);
    if found.is_ok() || folders.is_empty() {
        return found;
    }
    found_by(facts, &Folders::default()).or(found)
}

fn found_by(facts: TypeFacts<'_>, folders: &Folders) -> Result<(Definition, Source)> {
    let (text, source) = folders.text_of(facts.name)?;
    let found = type_hash(facts.name, &text)?;
    match facts.hash {
        Some(hash) if hash != found => {
            let hash = crate::model::clean(hash, 80);
            let help = match source {
                Source::Folders => "",
                Source::BuiltIn => {
                    "; give the directory where its package is installed (ros.definitions, AMENT_PREFIX_PATH)"
                }
            };
            let reason = format!("{} has the hash {found}, its own is {hash}{help}", words(source));
            Err(RosError::no_fields(facts.name, &reason))
        }
        _ => Ok((Definition::parse_ros2(facts.name, &text)?, source)),
    }
}

fn words(source: Source) -> &'static str {
    match source {
        Source::Folders => "the definition installed on this machine",
        Source::BuiltIn => "the definition built into this program",
    }
}

fn trust(facts: TypeFacts<'_>) -> &'static str {
    match facts.hash {
        Some(_) => "its type hash matches the message",
        None => "the message has no type hash to compare with",
    }
}

/// Whether a recording's definition differs from the hash in it.
fn differs(facts: TypeFacts<'_>) -> Option<String> {
    let (hash, Encoding::Cdr { .. }) = (facts.hash?, facts.encoding) else { return None };
    let found = type_hash(facts.name, facts.text?).ok().filter(|found| found != hash)?;
    let hash = crate::model::clean(hash, 80);
    Some(format!(
        "the recording's definition has type hash {found}, but the recording names {hash}: values may be wrong"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::message::{Limits, Value};

    const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    const IDL: Encoding = Encoding::Cdr { idl: true };
    const MSG: Encoding = Encoding::Cdr { idl: false };

    fn described(encoding: Encoding, text: Option<&str>, hash: Option<&str>, folders: &Folders) -> (bool, String) {
        let described =
            Described::of(TypeFacts { name: "std_msgs/msg/String", encoding, text, hash, md5sum: "*" }, folders);
        (described.definition.is_some(), described.note.unwrap_or_default())
    }

    #[test]
    fn a_type_without_fields_needs_no_text() {
        const EMPTY: &str = "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312";
        let folders = Folders::default();
        for (encoding, text) in
            [(MSG, None), (MSG, Some("")), (MSG, Some("\n")), (MSG, Some("# nothing\n")), (IDL, None)]
        {
            let facts = TypeFacts { name: "std_msgs/msg/Empty", encoding, text, hash: Some(EMPTY), md5sum: "*" };
            let described = Described::of(facts, &folders);
            let definition = described.definition.unwrap_or_else(|| panic!("{text:?}: {:?}", described.note));
            assert_eq!(described.note, None, "{text:?}");
            for body in [&[0, 1, 0, 0, 0][..], &[0, 1, 0, 3, 0, 0, 0, 0]] {
                let value = definition.decode(body, Limits::default()).expect("an empty message");
                assert_eq!(value, Value::Message(Vec::new()));
            }
        }
        let other =
            TypeFacts { name: "rig_msgs/msg/Empty", encoding: MSG, text: Some(""), hash: Some(EMPTY), md5sum: "*" };
        assert!(Described::of(other, &folders).definition.is_none(), "another type's hash");
    }

    /// A type that is not built in.
    fn own_kind(encoding: Encoding, text: Option<&str>) -> (bool, String) {
        let facts = TypeFacts { name: "a/msg/Own", encoding, text, hash: None, md5sum: "*" };
        let described = Described::of(facts, &Folders::default());
        (described.definition.is_some(), described.note.unwrap_or_default())
    }

    #[test]
    fn a_note_says_why_there_are_no_fields_or_what_speaks_against_them() {
        let none = Folders::default();
        let said = |encoding, text, hash| described(encoding, text, hash, &none);
        assert_eq!(said(MSG, Some("string data"), Some(STRING)), (true, String::new()));
        assert_eq!(said(MSG, Some("string data"), None), (true, String::new()));
        assert_eq!(said(MSG, Some("string<=9 data"), Some("")), (true, String::new()), "no hash");
        let (found, note) = said(MSG, Some("string<=9 data"), Some(STRING));
        assert!(found && note.contains("values may be wrong") && note.contains(STRING), "{note}");
        let (found, note) = own_kind(IDL, Some("module a {};"));
        assert!(!found && note.contains("IDL") && note.contains("a/msg/Own"), "{note}");
        let (found, note) = own_kind(MSG, None);
        assert!(!found && note.contains("in no record") && note.contains("AMENT_PREFIX_PATH"), "{note}");
        assert!(own_kind(MSG, Some("line")).1.contains("no field name"));
        let (found, note) = own_kind(MSG, Some("int64 a\n---\nint64 sum"));
        assert!(!found && note.contains("describes a service"), "{note}");
        assert_eq!(said(MSG, Some("string data"), Some("")), (true, String::new()), "an empty hash is none");
        assert!(!said(Encoding::Ros1, Some("string data"), None).0, "its name is none of ROS 1");
    }

    #[test]
    fn common_interfaces_need_no_folder_but_their_own_hash() {
        let none = Folders::default();
        let said = |encoding, text, hash| described(encoding, text, hash, &none);
        let (found, note) = said(IDL, Some("module std_msgs {};"), Some(STRING));
        assert!(found && note.contains("built into") && note.contains("matches the message"), "{note}");
        let (found, note) = said(MSG, None, None);
        assert!(found && note.contains("built into") && note.contains("has no type hash"), "{note}");
        let (found, note) = said(MSG, None, Some("RIHS01_00\x1b"));
        assert!(!found && note.contains("RIHS01_00") && note.contains(STRING) && !note.contains('\x1b'), "{note}");
        assert!(note.contains("AMENT_PREFIX_PATH"), "what helps: {note}");
    }

    #[test]
    fn folders_help_where_the_recording_does_not_but_only_with_the_right_hash() {
        let home = tempfile::tempdir().expect("a folder");
        let folder = home.path().join("share/std_msgs/msg");
        std::fs::create_dir_all(&folder).expect("created");
        let put = |text: &str| std::fs::write(folder.join("String.msg"), text).expect("written");
        let folders = Folders::of_prefixes(home.path().as_os_str());
        let said = |encoding, text, hash| described(encoding, text, hash, &folders);
        put("string data # text");
        let (found, note) = said(IDL, Some("module x {};"), Some(STRING));
        assert!(found && note.contains("installed on this machine") && note.contains("matches the message"), "{note}");
        let (found, note) = said(MSG, None, None);
        assert!(found && note.contains("installed on this machine") && note.contains("has no type hash"), "{note}");
        let (found, note) = said(IDL, None, Some("RIHS01_00"));
        assert!(!found && note.contains("RIHS01_00") && note.contains(STRING), "{note}");
        // Another release than that of the message.
        put("string<=5 data");
        let (found, note) = said(MSG, None, Some(STRING));
        assert!(found && note.contains("built into"), "{note}");
    }
    #[test]
    fn an_empty_text_is_no_definition_unless_its_messages_are_empty() {
        let of = |name, md5sum, text| {
            let facts = TypeFacts { name, encoding: Encoding::Ros1, text, hash: None, md5sum };
            let described = Described::of(facts, &Folders::default());
            (described.definition.is_some(), described.note.unwrap_or_default())
        };
        let (known, note) = of("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", Some(""));
        assert!(known && note.contains("sent no definition") && note.contains("md5sum matches"), "{note}");
        assert_eq!(of("std_msgs/Empty", NOTHING, Some("")), (true, String::new()));
        for (name, md5sum) in [("std_msgs/String", "*"), ("a/Own", "00000000000000000000000000000001")] {
            let (known, note) = of(name, md5sum, Some(""));
            assert!(!known && note.contains("sent no definition"), "{note}");
        }
        let (known, note) = described(MSG, Some(""), None, &Folders::default());
        assert!(known && note.contains("built into this program"), "a CDR body without a definition: {note}");
    }

    #[test]
    fn the_event_of_a_service_is_read_by_the_service_s_own_text() {
        const NAME: &str = "rcl_interfaces/srv/SetParameters_Event";
        // By ROS 2 Jazzy.
        const HASH: &str = "RIHS01_5060f52369bcff7f9dbd6eca21ee521859e471e71b33a8a8df26d5236fe54a80";
        const OWN: &str =
            "# A list.\nParameter[] parameters\n\n---\n# Whether, and why.\nSetParametersResult[] results\n";
        let rule = "=".repeat(80);
        let nested =
            format!("{OWN}\n{rule}\nMSG: rcl_interfaces/SetParametersResult\nbool successful\nstring reason\n");
        for text in [OWN.to_owned(), format!("{rule}\nSRV: rcl_interfaces/srv/SetParameters\n{OWN}"), nested] {
            let plain = plain_text(NAME, &text);
            let (whole, _) = Folders::default().complete(NAME, &plain).expect("all is built in");
            assert_eq!(type_hash(NAME, &whole).expect("a definition"), HASH);
            let facts = TypeFacts { name: NAME, encoding: MSG, text: Some(&text), hash: Some(HASH), md5sum: "*" };
            let described = Described::of(facts, &Folders::default());
            assert!(described.definition.is_some(), "{:?}", described.note);
        }
    }

    #[test]
    fn nested_types_are_completed_from_where_types_are_looked_for() {
        let (known, note) = own_kind(MSG, Some("builtin_interfaces/Time stamp\nint32 v"));
        assert!(known && note.contains("lacks builtin_interfaces/msg/Time"), "{note}");
        let (known, note) = own_kind(MSG, Some("c/Missing x"));
        assert!(!known && note.contains("c/msg/Missing"), "{note}");
    }
}
