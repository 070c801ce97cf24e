//! Definitions of ROS 1 messages: their layout with every nested type resolved, their md5sum, and built-in types.

use std::{collections::HashMap, sync::Arc};

use md5::{Digest as _, Md5};

use super::{md5sum, ros2};
use crate::model::topic::{LONGEST_NAME, TypeName};
use crate::{Result, RosError, model::bytes::hex};

/// Bytes.
pub const LONGEST_DEFINITION: usize = 1 << 20;

/// Types in one definition.
pub(super) const MOST_TYPES: usize = 512;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Primitive(Primitive),
    Message(usize),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    /// Shared with every value read by it.
    pub name: Arc<str>,
    pub kind: Kind,
    pub arity: Arity,
    /// As written, with its brackets.
    pub written: String,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    pub name: String,
    pub fields: Vec<Field>,
    /// `type name=value` lines, for the md5sum.
    pub constants: Vec<String>,
    /// Fewest bytes of a message of this type.
    pub minimum: usize,
    /// Whether every message has exactly `minimum` bytes.
    pub fixed: bool,
}

/// The type itself is the last layout; each layout comes after those it consists of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Definition {
    pub(super) layouts: Vec<Layout>,
    pub(super) cdr: bool,
}

impl Definition {
    /// `text` is the type's own lines, then `MSG: package/Type` sections, as in a publisher's header or a bag. Fails if
    /// it is too long, broken, incomplete, recursive or too deep.
    pub fn parse(type_name: &str, text: &str) -> Result<Self> {
        let failed = |reason: String| RosError::definition(type_name, reason);
        type_name.parse::<TypeName>().map_err(|_| failed("its type is not package/Type".into()))?;
        let texts = sections(type_name, text, |name| Some(name.to_owned())).map_err(failed)?;
        let layouts = Nesting::layouts_of(type_name, texts, layout).map_err(failed)?;
        Ok(Self { layouts, cdr: false })
    }

    /// `package/Type`; for ROS 2 `package/msg/Type`.
    pub fn type_name(&self) -> &str {
        self.root().map_or("", |layout| layout.name.as_str())
    }

    pub fn short_name(&self) -> String {
        self.type_name().replacen("/msg/", "/", 1)
    }

    /// As ROS 1 computes it: over the constants and fields without comments, nested types replaced by their own md5sum.
    pub fn md5sum(&self) -> String {
        let mut sums: Vec<String> = Vec::with_capacity(self.layouts.len());
        for layout in &self.layouts {
            let mut lines = layout.constants.clone();
            lines.extend(layout.fields.iter().map(|field| match field.kind {
                Kind::Primitive(_) => format!("{} {}", field.written, field.name),
                Kind::Message(index) => format!("{} {}", sums.get(index).map_or("", String::as_str), field.name),
            }));
            sums.push(hex(&Md5::digest(lines.join("\n"))));
        }
        sums.pop().unwrap_or_default()
    }

    /// Whether messages begin with a `std_msgs/Header`, and so with its `seq`.
    pub fn begins_with_header(&self) -> bool {
        let first = self.root().and_then(|layout| layout.fields.first()).filter(|field| field.arity == Arity::One);
        let Some(Field { kind: Kind::Message(index), .. }) = first else { return false };
        self.layouts.get(*index).is_some_and(|layout| [HEADER, OLD_HEADER].contains(&layout.name.as_str()))
    }

    pub(super) fn root(&self) -> Option<&Layout> {
        self.layouts.last()
    }
}

const HEADER: &str = "std_msgs/Header";

/// The header's name before 2011.
const OLD_HEADER: &str = "roslib/Header";

/// Splits the text at `MSG:` lines with names that `named` accepts; a type given twice keeps its first text.
pub(super) fn sections<'a>(
    root: &str,
    text: &'a str,
    named: impl Fn(&str) -> Option<String>,
) -> Result<Texts<'a>, String> {
    if text.len() > LONGEST_DEFINITION {
        return Err(format!("it is longer than {LONGEST_DEFINITION} bytes"));
    }
    let mut found: Vec<(String, Vec<&str>)> = vec![(root.to_owned(), Vec::new())];
    let mut after_rule = false;
    for line in text.lines() {
        let rule = line.len() >= 20 && line.bytes().all(|byte| byte == b'=');
        let name = line.strip_prefix("MSG: ").filter(|_| after_rule);
        if let Some(name) = name.and_then(|name| named(name.trim())) {
            found.push((name, Vec::new()));
        } else if after_rule && line.starts_with("IDL: ") {
            return Err("part of it is IDL, which is not supported".into());
        } else if let (false, Some((_, lines))) = (rule, found.last_mut()) {
            lines.push(line);
        }
        after_rule = rule;
        if found.len() > MOST_TYPES {
            return Err(format!("it has more than {MOST_TYPES} types"));
        }
    }
    let mut texts = Texts::new();
    for (name, lines) in found {
        texts.entry(name).or_insert(lines);
    }
    Ok(texts)
}

impl Layout {
    pub fn new(name: &str) -> Self {
        Self { name: name.to_owned(), fields: Vec::new(), constants: Vec::new(), minimum: 0, fixed: true }
    }

    pub fn add(&mut self, layouts: &[Self], field: Field) {
        let (size, fixed) = element_size(layouts, field.kind);
        let (least, fixed) = match field.arity {
            Arity::One => (size, fixed),
            Arity::Fixed(count) => (size.saturating_mul(count), fixed),
            Arity::Bounded(_) | Arity::Variable => (4, false),
        };
        self.minimum = self.minimum.saturating_add(least);
        self.fixed &= fixed;
        self.fields.push(field);
    }
}

/// The layout of a type and its number of levels.
fn layout(nesting: &mut Nesting<'_>, name: &str, lines: &[&str]) -> Result<(Layout, usize), String> {
    let (mut layout, mut height) = (Layout::new(name), 1);
    for line in lines {
        match parse_line(line).map_err(|reason| format!("{reason} in {name}"))? {
            None => {}
            Some(Line::Constant { base, name, text }) => layout.constants.push(format!("{base} {name}={text}")),
            Some(Line::Field { written, base, arity, name: field }) => {
                let (kind, below) = kind(nesting, name, base)?;
                height = height.max(below + 1);
                let field = Field { name: field.into(), kind, arity, written: written.to_owned() };
                layout.add(&nesting.layouts, field);
            }
        }
    }
    Ok((layout, height))
}

fn kind(nesting: &mut Nesting<'_>, inside: &str, base: &str) -> Result<(Kind, usize), String> {
    if let Some(primitive) = Primitive::parse(base) {
        return Ok((Kind::Primitive(primitive), 0));
    }
    let has = |name: &str| nesting.texts.contains_key(name);
    let full = match (base, inside.split_once('/')) {
        // Bags from before 2011 carry the header under its old name.
        ("Header", _) if has(OLD_HEADER) && !has(HEADER) => OLD_HEADER.to_owned(),
        ("Header", _) => HEADER.to_owned(),
        (_, Some((package, _))) if !base.contains('/') => format!("{package}/{base}"),
        _ => base.to_owned(),
    };
    if full.len() > LONGEST_NAME {
        return Err(String::from("a type name is too long"));
    }
    let (index, height) = nesting.resolve(&full, layout)?;
    Ok((Kind::Message(index), height))
}

/// Fewest bytes of one element, and whether it never has more.
pub(super) fn element_size(layouts: &[Layout], kind: Kind) -> (usize, bool) {
    match kind {
        Kind::Primitive(primitive) => (primitive.size(), !primitive.is_text()),
        Kind::Message(index) => layouts.get(index).map_or((0, true), |layout| (layout.minimum, layout.fixed)),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Primitive {
    Bool,
    Int8,
    Uint8,
    Int16,
    Uint16,
    Int32,
    Uint32,
    Int64,
    Uint64,
    Float32,
    Float64,
    Text,
    /// UTF-16, of ROS 2.
    Wide,
    Time,
    Duration,
}

impl Primitive {
    /// ROS 1 has times but no wide text, and its bytes have a sign.
    pub fn parse(name: &str) -> Option<Self> {
        match name {
            "byte" => Some(Self::Int8),
            "time" => Some(Self::Time),
            "duration" => Some(Self::Duration),
            "wstring" => None,
            _ => ros2::plain(name).map(|(primitive, _)| primitive),
        }
    }

    pub fn is_text(self) -> bool {
        matches!(self, Self::Text | Self::Wide)
    }

    /// In bytes; of a text, its length field.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 | Self::Text | Self::Wide => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 | Self::Time | Self::Duration => 8,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Arity {
    One,
    Fixed(usize),
    /// At most this many, of ROS 2.
    Bounded(usize),
    Variable,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Line<'a> {
    Field { written: &'a str, base: &'a str, arity: Arity, name: &'a str },
    Constant { base: &'a str, name: &'a str, text: &'a str },
}

/// `None` for a blank line or a comment.
pub(super) fn parse_line(line: &str) -> Result<Option<Line<'_>>, &'static str> {
    let plain = line.split('#').next().unwrap_or_default().trim();
    if plain.is_empty() {
        return Ok(None);
    }
    let (written, rest) = plain.split_once(char::is_whitespace).ok_or("a line has no field name")?;
    if plain.contains('=') { constant(line, written, rest).map(Some) } else { field(written, rest.trim()).map(Some) }
}

fn constant<'a>(line: &'a str, base: &'a str, rest: &'a str) -> Result<Line<'a>, &'static str> {
    let whole = if base == "string" {
        // A text constant extends to the end of its line, including '#'.
        line.trim_start().strip_prefix(base).ok_or("a constant is broken")?
    } else {
        rest
    };
    let (name, text) = whole.split_once('=').ok_or("a constant has no value")?;
    let (name, text) = (name.trim(), text.trim());
    let valid = Primitive::parse(base).is_some_and(|base| !matches!(base, Primitive::Time | Primitive::Duration));
    if valid && is_name(name) { Ok(Line::Constant { base, name, text }) } else { Err("a constant is broken") }
}

fn field<'a>(written: &'a str, name: &'a str) -> Result<Line<'a>, &'static str> {
    let (base, arity) = match written.strip_suffix(']').and_then(|inner| inner.rsplit_once('[')) {
        Some((base, "")) => (base, Arity::Variable),
        Some((base, count)) => (base, Arity::Fixed(count.parse().map_err(|_| "an array has a broken length")?)),
        None => (written, Arity::One),
    };
    let mut parts = base.split('/');
    let base_ok = parts.by_ref().take(2).all(is_name) && parts.next().is_none();
    if base_ok && is_name(name) { Ok(Line::Field { written, base, arity, name }) } else { Err("a field is broken") }
}

pub(super) fn is_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    name.len() <= 255
        && bytes.next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_')
        && bytes.all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

pub const DEEPEST: usize = 16;

pub(super) type Texts<'a> = HashMap<String, Vec<&'a str>>;

/// Builds the layout and height of a type from its lines; for nested types it calls [`Nesting::resolve`] with itself.
pub(super) type Make<'a> = fn(&mut Nesting<'a>, &str, &[&str]) -> Result<(Layout, usize), String>;

pub(super) struct Nesting<'a> {
    texts: Texts<'a>,
    /// Index and height (nested levels, itself included) of each resolved type.
    done: HashMap<String, (usize, usize)>,
    path: Vec<String>,
    /// Each comes after those it consists of.
    pub layouts: Vec<Layout>,
}

impl<'a> Nesting<'a> {
    /// The layouts of `name` and of all types it consists of, itself last. Fails for a type that is missing, contains
    /// itself or is nested too deep.
    pub fn layouts_of(name: &str, texts: Texts<'a>, make: Make<'a>) -> Result<Vec<Layout>, String> {
        let mut nesting = Self { texts, done: HashMap::new(), path: Vec::new(), layouts: Vec::new() };
        nesting.resolve(name, make)?;
        Ok(nesting.layouts)
    }

    pub fn resolve(&mut self, name: &str, make: Make<'a>) -> Result<(usize, usize), String> {
        if self.path.iter().any(|above| above == name) {
            return Err(format!("{name} contains itself"));
        }
        let known = self.done.get(name).copied();
        if self.path.len() + known.map_or(1, |(_, height)| height) > DEEPEST {
            return Err(format!("it is nested more than {DEEPEST} levels deep"));
        }
        if let Some(known) = known {
            return Ok(known);
        }
        let lines = self.texts.get(name).cloned().ok_or_else(|| format!("the definition of {name} is missing"))?;
        self.path.push(name.to_owned());
        let (layout, height) = make(self, name, &lines)?;
        self.path.pop();
        self.layouts.push(layout);
        let resolved = (self.layouts.len() - 1, height);
        self.done.insert(name.to_owned(), resolved);
        Ok(resolved)
    }
}

/// The header's lines in ROS 2, and in ROS 1, where it has a number too.
const HEADERS: [&str; 2] =
    ["builtin_interfaces/Time stamp\nstring frame_id", "uint32 seq\ntime stamp\nstring frame_id"];

/// The definition of a common message type with this md5sum (32 hex characters): that of ROS 2 in the words of ROS 1.
pub fn built_in_definition(type_name: &str, sum: &str) -> Option<String> {
    let (text, _) = ros2::Folders::default().text_of(type_name).ok()?;
    let rule = format!("{}\n", "=".repeat(80));
    let parts = text.split(&rule).filter(|part| !part.starts_with("MSG: builtin_interfaces/"));
    let whole = parts.map(in_ros1).collect::<Vec<_>>().join(&rule);
    (md5sum(type_name, &whole).ok()? == sum).then_some(whole)
}

fn in_ros1(part: &str) -> String {
    let part = part.replace(HEADERS[0], HEADERS[1]);
    let line = |line: &str| {
        let kinds = [("builtin_interfaces/Time", "time"), ("builtin_interfaces/Duration", "duration")];
        let found = kinds.iter().find_map(|(new, old)| Some((old, line.strip_prefix(new)?)));
        found.map_or_else(|| format!("{line}\n"), |(old, rest)| format!("{old}{rest}\n"))
    };
    part.lines().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_and_constants() {
        let field = Line::Field { written: "float64[36]", base: "float64", arity: Arity::Fixed(36), name: "c" };
        assert_eq!(parse_line("  float64[36]\tc # six by six"), Ok(Some(field)));
        let constant = Line::Constant { base: "string", name: "A", text: "x # y = z" };
        assert_eq!(parse_line("string A= x # y = z "), Ok(Some(constant)));
        let constant = Line::Constant { base: "int8", name: "B", text: "-1" };
        assert_eq!(parse_line("int8 B = -1 # minus"), Ok(Some(constant)));
        assert_eq!(parse_line(" # only words"), Ok(None));
        for bad in ["float64", "a b c", "x[ y", "a/b/c d", "int8[-1] x", "foo A=1", "string #A=1", "1a b", "a// b"] {
            assert!(parse_line(bad).is_err(), "{bad}");
        }
    }
}

#[cfg(test)]
mod built_in_tests {
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
