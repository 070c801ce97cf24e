//! ROS 2 definitions: `.msg` texts with all their types, and the hash that identifies them. They become the same
//! layouts as ROS 1 messages; only bodies differ.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::{borrow::Cow, ffi::OsStr, fmt::Write as _, fs::File, io::Read as _, sync::LazyLock};

use sha2::{Digest as _, Sha256};

use super::definition::{
    Arity, Definition, Field, Kind, LONGEST_DEFINITION, Layout, MOST_TYPES, Nesting, Primitive, is_name, sections,
};
use crate::{Result, RosError, model::bytes::hex, model::topic::LONGEST_NAME};

impl Definition {
    /// `text` is as in MCAP's `ros2msg`: the type's own lines, then `MSG: package/Type` sections. Fails if it is too
    /// long, broken, incomplete, recursive or too deep.
    pub fn parse_ros2(type_name: &str, text: &str) -> Result<Self> {
        let failed = |reason: String| RosError::definition(type_name, reason);
        let name = full_name(type_name, None).ok_or_else(|| failed("its type is not package/msg/Type".into()))?;
        let texts = sections(&name, text, |name| full_name(name, None)).map_err(failed)?;
        let layouts = Nesting::layouts_of(&name, texts, layout).map_err(failed)?;
        Ok(Self { layouts, cdr: true })
    }
}

/// As ROS 2 computes it: `RIHS01_` and 64 hex characters.
pub fn type_hash(type_name: &str, text: &str) -> Result<String> {
    Definition::parse_ros2(type_name, text).map(|definition| of(&definition.layouts))
}

/// Whether the built-in definition has this hash.
pub fn is_built_in(type_name: &str, hash: &str) -> bool {
    let text = Folders::default().text_of(type_name);
    text.is_ok_and(|(text, _)| type_hash(type_name, &text).is_ok_and(|found| found == hash))
}

/// The text in MCAP's form. rosbag2 describes a service's event (`package/srv/Type_Event`) by the service's own text,
/// in which dashes divide request and response.
pub(crate) fn plain_text<'a>(type_name: &str, text: &'a str) -> Cow<'a, str> {
    const RULE: &str = "================================================================================";
    let service = type_name.strip_suffix("_Event").filter(|name| name.contains("/srv/"));
    let headless = || text.strip_prefix(RULE)?.trim_start().strip_prefix("SRV: ")?.split_once('\n');
    let content = headless().map_or(text, |(_, rest)| rest);
    let (own, others) = content.find("\n====").map_or((content, ""), |end| content.split_at(end));
    let is_divider = |line: &str| line.trim_end() == "---";
    let Some(service) = service.filter(|_| own.lines().any(is_divider)) else { return text.into() };
    let lines: Vec<&str> = own.lines().collect();
    let request = lines.split(|line| is_divider(line)).next().unwrap_or_default();
    let response = lines.get(request.len() + 1..).unwrap_or_default();
    let part = |name: &str, lines: &[&str]| format!("{RULE}\nMSG: {service}_{name}\n{}\n", lines.join("\n"));
    let members = ["Request", "Response"].map(|name| format!("{service}_{name}[<=1] {}\n", name.to_lowercase()));
    let (members, request, response) = (members.concat(), part("Request", request), part("Response", response));
    format!("service_msgs/ServiceEventInfo info\n{members}{request}{response}{}", others.trim_start()).into()
}

/// `package/msg/Type` from any form of the name; a bare name belongs to `package`.
fn full_name(name: &str, package: Option<&str>) -> Option<String> {
    let parts: Vec<&str> = name.split('/').collect();
    let full = match (parts.as_slice(), package) {
        ([package, kind @ ("msg" | "srv" | "action"), name], _) => {
            format!("{package}/{kind}/{name}")
        }
        ([package, name], _) => format!("{package}/msg/{name}"),
        ([name], Some(package)) => format!("{package}/msg/{name}"),
        _ => return None,
    };
    (full.len() <= LONGEST_NAME && parts.iter().all(|part| is_name(part))).then_some(full)
}

fn layout(nesting: &mut Nesting<'_>, name: &str, lines: &[&str]) -> Result<(Layout, usize), String> {
    let (mut layout, mut height) = (Layout::new(name), 1);
    for line in lines {
        let read = parse_line(line).map_err(|reason| format!("{reason} in {name}"))?;
        let Some(Line { written, base, arity, name: member, .. }) = read else { continue };
        let (kind, below) = kind(nesting, name, base)?;
        height = height.max(below + 1);
        layout.add(&nesting.layouts, Field { name: member.into(), kind, arity, written: written.to_owned() });
    }
    // Padding depends on where a message begins, so no type has a fixed size; one without fields has a byte.
    (layout.minimum, layout.fixed) = (layout.minimum.max(1), false);
    Ok((layout, height))
}

fn kind(nesting: &mut Nesting<'_>, inside: &str, base: &str) -> Result<(Kind, usize), String> {
    if let Some((primitive, _)) = plain(base) {
        return Ok((Kind::Primitive(primitive), 0));
    }
    let package = inside.split('/').next();
    let full = full_name(base, package).ok_or_else(|| format!("a type's name is broken in {inside}"))?;
    let (index, height) = nesting.resolve(&full, layout)?;
    Ok((Kind::Message(index), height))
}

/// Digits of a number, with leading zeros: the text is kept, and shown with every array.
const LONGEST_NUMBER: usize = 20;

/// Default values and values of constants are not part of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Line<'a> {
    /// As written, with its bounds.
    written: &'a str,
    base: &'a str,
    /// The most characters of a text; 0 if unbounded.
    bound: usize,
    arity: Arity,
    name: &'a str,
}

/// A type without a definition: its layout in a body, and its number in type descriptions.
pub(super) fn plain(base: &str) -> Option<(Primitive, u8)> {
    Some(match base {
        "int8" => (Primitive::Int8, 2),
        // In ROS 2 a char is an eight-bit number.
        "uint8" | "char" => (Primitive::Uint8, 3),
        "int16" => (Primitive::Int16, 4),
        "uint16" => (Primitive::Uint16, 5),
        "int32" => (Primitive::Int32, 6),
        "uint32" => (Primitive::Uint32, 7),
        "int64" => (Primitive::Int64, 8),
        "uint64" => (Primitive::Uint64, 9),
        "float32" => (Primitive::Float32, 10),
        "float64" => (Primitive::Float64, 11),
        "bool" => (Primitive::Bool, 15),
        "byte" => (Primitive::Uint8, 16),
        "string" => (Primitive::Text, 17),
        "wstring" => (Primitive::Wide, 18),
        _ => return None,
    })
}

fn parse_line(line: &str) -> Result<Option<Line<'_>>, &'static str> {
    let line = without_comment(line).trim();
    if line.is_empty() {
        return Ok(None);
    }
    let (written, rest) = line.split_once(char::is_whitespace).ok_or("a line has no field name")?;
    let rest = rest.trim_start();
    if rest.split_once('=').is_some_and(|(name, _)| is_name(name.trim_end())) {
        let base = written.split_once("<=").map_or(written, |(base, _)| base);
        return plain(base).map(|_| None).ok_or("a constant is broken");
    }
    // The default value follows the name.
    let name = rest.split(char::is_whitespace).next().unwrap_or_default();
    field_line(written, name).map(Some)
}

/// A `#` between quotes begins no comment.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut escaped = false;
    for (at, character) in line.char_indices() {
        match (quote, character) {
            _ if escaped => escaped = false,
            (Some(_), '\\') => escaped = true,
            (Some(open), close) if open == close => quote = None,
            (None, '#') => return line.get(..at).unwrap_or_default(),
            (None, '"' | '\'') => quote = Some(character),
            _ => {}
        }
    }
    // An unclosed quote is an ordinary character.
    if quote.is_some() { line.split('#').next().unwrap_or_default() } else { line }
}

/// Base, the most characters of a text, and arity.
fn written_type(written: &str) -> Result<(&str, usize, Arity), &'static str> {
    let bounded = |text: &str| text.len() <= LONGEST_NUMBER;
    let number = |text: &str| text.parse().ok().filter(|count: &usize| *count > 0 && bounded(text));
    let (element, arity) = match written.strip_suffix(']').and_then(|inner| inner.rsplit_once('[')) {
        None => (written, Arity::One),
        Some((element, "")) => (element, Arity::Variable),
        Some((element, count)) => {
            let arity = match count.strip_prefix("<=") {
                Some(most) => number(most).map(Arity::Bounded),
                None => number(count).map(Arity::Fixed),
            };
            (element, arity.ok_or("an array has a broken length")?)
        }
    };
    match element.split_once("<=") {
        Some((base @ ("string" | "wstring"), most)) => {
            Ok((base, number(most).ok_or("a text has a broken bound")?, arity))
        }
        Some(_) => Err("a bound where none is allowed"),
        None => Ok((element, 0, arity)),
    }
}

fn field_line<'a>(written: &'a str, name: &'a str) -> Result<Line<'a>, &'static str> {
    let (base, bound, arity) = written_type(written)?;
    let mut parts = base.split('/');
    let base_ok = parts.by_ref().take(3).all(is_name) && parts.next().is_none();
    if !base_ok || !is_name(name) {
        return Err("a field is broken");
    }
    Ok(Line { written, base, bound, arity, name })
}

const FILLER: &str = "structure_needs_at_least_one_member";

/// Type numbers of an interface, and of [`FILLER`].
const INTERFACE: u8 = 1;
const UINT8: u8 = 3;

/// Bounded texts have other numbers.
const BOUNDED_TEXTS: u8 = 4;

fn of(layouts: &[Layout]) -> String {
    let Some((root, others)) = layouts.split_last() else { return String::new() };
    let mut others: Vec<&Layout> = others.iter().collect();
    others.sort_by(|one, other| one.name.cmp(&other.name));
    // Hashed while it is written: a definition of a megabyte has a description of hundreds of megabytes.
    let mut hash = Sha256::new();
    hash.update("{\"type_description\": ");
    describe(layouts, root, &mut hash);
    hash.update(", \"referenced_type_descriptions\": [");
    for (place, other) in others.into_iter().enumerate() {
        hash.update(if place > 0 { ", " } else { "" });
        describe(layouts, other, &mut hash);
    }
    hash.update("]}");
    format!("RIHS01_{}", hex(&hash.finalize()))
}

fn describe(layouts: &[Layout], layout: &Layout, hash: &mut Sha256) {
    hash.update(format!("{{\"type_name\": \"{}\", \"fields\": [", layout.name));
    for (place, field) in layout.fields.iter().enumerate() {
        hash.update(if place > 0 { ", " } else { "" });
        hash.update(described(layouts, field));
    }
    if layout.fields.is_empty() {
        hash.update(put_field(FILLER, UINT8, 0, 0, ""));
    }
    hash.update("]}");
}

fn described(layouts: &[Layout], field: &Field) -> String {
    // This parsed before.
    let (base, bound, _) = written_type(&field.written).unwrap_or(("", 0, Arity::One));
    let (number, nested) = match field.kind {
        Kind::Primitive(_) => {
            let number = plain(base).map_or(0, |(_, number)| number);
            (if bound > 0 { number + BOUNDED_TEXTS } else { number }, "")
        }
        Kind::Message(index) => (INTERFACE, layouts.get(index).map_or("", |nested| nested.name.as_str())),
    };
    let (more, capacity) = match field.arity {
        Arity::One => (0, 0),
        Arity::Fixed(count) => (48, count),
        Arity::Bounded(most) => (96, most),
        Arity::Variable => (144, 0),
    };
    put_field(&field.name, number + more, capacity, bound, nested)
}

fn put_field(name: &str, number: u8, capacity: usize, bound: usize, nested: &str) -> String {
    let mut out = format!("{{\"name\": \"{name}\", \"type\": {{\"type_id\": {number}, ");
    // Writing to a String cannot fail.
    let _ =
        write!(out, "\"capacity\": {capacity}, \"string_capacity\": {bound}, \"nested_type_name\": \"{nested}\"}}}}");
    out
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// In a folder of this machine.
    Folders,
    /// Built into this program.
    BuiltIn,
}

/// Searched for definitions in this order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Folders(Vec<PathBuf>);

impl Folders {
    pub fn of_prefixes(list: &OsStr) -> Self {
        Self(std::env::split_paths(list).filter(|prefix| prefix.is_absolute()).collect())
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether [`Folders::text_of`] may find this type.
    pub fn may_know(&self, type_name: &str) -> bool {
        !self.is_empty() || full_name(type_name, None).is_some_and(|name| text_of(&name).is_some())
    }

    /// The text of a type with all its parts, as in MCAP, and where the type itself was found. Types in no folder come
    /// from the built-in interfaces.
    pub fn text_of(&self, type_name: &str) -> Result<(String, Source)> {
        let root = full_name(type_name, None)
            .ok_or_else(|| RosError::no_fields(type_name, "its type is not package/msg/Type"))?;
        let (own, source) = self.own_lines(&root).ok_or_else(|| missing(type_name, &root))?;
        let (whole, _) = self.complete(type_name, &own)?;
        Ok((whole, source))
    }

    /// Completes a text with the nested types it lacks; returns their names too.
    pub fn complete(&self, type_name: &str, text: &str) -> Result<(String, Vec<String>)> {
        let failed = |reason: String| RosError::no_fields(type_name, &reason);
        let root = full_name(type_name, None).ok_or_else(|| failed("its type is not package/msg/Type".into()))?;
        let mut own: Vec<(String, Vec<&str>)> =
            sections(&root, text, |name| full_name(name, None)).map_err(failed)?.into_iter().collect();
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

    /// With an end of line at their end.
    fn own_lines(&self, name: &str) -> Option<(String, Source)> {
        let here = self.file_of(name).map(|text| (text, Source::Folders));
        let (text, source) = here.or_else(|| Some((text_of(name)?.to_owned(), Source::BuiltIn)))?;
        Some((format!("{}\n", text.trim_end()), source))
    }

    /// `None` if no folder has a readable file of bounded length.
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

fn nested_in(name: &str, text: &str) -> Result<Vec<String>, &'static str> {
    let package = name.split('/').next();
    let mut nested = Vec::new();
    for line in text.lines() {
        let Some(Line { base, .. }) = parse_line(line)? else { continue };
        if plain(base).is_none() {
            nested.push(full_name(base, package).ok_or("a type's name is broken")?);
        }
    }
    Ok(nested)
}

static TEXTS: LazyLock<HashMap<&'static str, &'static str>> =
    LazyLock::new(|| built_in_sections(include_str!("ros2/interfaces.txt")).collect());

fn built_in_sections(text: &'static str) -> impl Iterator<Item = (&'static str, &'static str)> {
    text.split("\nMSG: ").skip(1).map(|section| section.split_once('\n').unwrap_or((section, "")))
}

fn text_of(name: &str) -> Option<&'static str> {
    TEXTS.get(name).copied()
}

#[cfg(test)]
mod line_tests {
    use super::*;

    fn read(line: &str) -> (String, usize, Arity, String) {
        match parse_line(line) {
            Ok(Some(Line { base, bound, arity, name, .. })) => (base.to_owned(), bound, arity, name.to_owned()),
            other => panic!("{line}: {other:?}"),
        }
    }

    #[test]
    fn fields_have_bounds_and_default_values() {
        let cases = [
            ("  float64[36]\tc # six by six", ("float64", 0, Arity::Fixed(36), "c")),
            ("string<=10 s \"a # b\" # why", ("string", 10, Arity::One, "s")),
            ("wstring<=3[<=4] w", ("wstring", 3, Arity::Bounded(4), "w")),
            ("geometry_msgs/msg/Point[] points", ("geometry_msgs/msg/Point", 0, Arity::Variable, "points")),
            ("int32[] numbers [1, 2]", ("int32", 0, Arity::Variable, "numbers")),
            ("string text 'a=b'", ("string", 0, Arity::One, "text")),
            ("string note # don't", ("string", 0, Arity::One, "note")),
        ];
        for (line, (base, bound, arity, name)) in cases {
            assert_eq!(read(line), (base.to_owned(), bound, arity, name.to_owned()), "{line}");
        }
    }

    #[test]
    fn constants_and_empty_lines_carry_nothing() {
        for line in ["int8 B = -1 # minus", "string A=\"x # y\"", "string<=5 A='b'", "byte OK=0"] {
            assert_eq!(parse_line(line), Ok(None), "{line}");
        }
        for line in ["", "   ", "# only words", "\t# don't"] {
            assert_eq!(parse_line(line), Ok(None), "{line}");
        }
    }

    #[test]
    fn what_is_no_line_is_refused() {
        for bad in [
            "float64",
            "x[ y",
            "a/b/c/d e",
            "int8[-1] x",
            "int8[0] x",
            "int8[<=0] x",
            "int8<=3 x",
            "foo A=1",
            "1a b",
            "a// b",
            "string<= x",
            &format!("string<={}1 x", "0".repeat(LONGEST_NUMBER)),
            "int8[<=99999999999999999999] x",
        ] {
            assert!(parse_line(bad).is_err(), "{bad}");
        }
    }
}

#[cfg(test)]
mod folder_tests {
    use super::*;
    use crate::ros::message::Definition;

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

#[cfg(test)]
mod built_in_tests {
    use super::*;

    #[test]
    fn each_type_stands_there_once_and_one_without_members_too() {
        let all: Vec<_> = built_in_sections(include_str!("ros2/interfaces.txt")).collect();
        assert_eq!((all.len(), TEXTS.len()), (162, 162));
        assert_eq!(text_of("std_msgs/msg/Empty"), Some(""));
        assert_eq!(text_of("std_msgs/msg/String").map(str::trim), Some("string data"));
        assert_eq!(text_of("std_msgs/String"), None);
    }
}

#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod tests;
