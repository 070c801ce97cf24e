//! ROS 1 message definitions: their lines, their layout with every nested type resolved, their md5sum, and the types that
//! are built in.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use super::{md5sum, ros2};
use crate::model::bytes::hex;
use crate::model::topic::{LONGEST_NAME, TypeName};
use crate::ros::RosError;
use md5::{Digest as _, Md5};

/// The longest definition text, bytes.
pub const LONGEST_DEFINITION: usize = 1 << 20;

/// The most types in one definition.
pub(super) const MOST_TYPES: usize = 512;

/// The type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Primitive(Primitive),
    /// Index of a layout.
    Message(usize),
}

/// One field of a layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    /// Shared with every value read by it.
    pub name: Arc<str>,
    pub kind: Kind,
    pub arity: Arity,
    /// The type as written, with its brackets.
    pub written: String,
}

/// The layout of one message type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    pub name: String,
    pub fields: Vec<Field>,
    /// `type name=value` lines, as the md5sum needs them.
    pub constants: Vec<String>,
    /// Fewest bytes of a message of this type.
    pub minimum: usize,
    /// Whether every message of this type has exactly `minimum` bytes.
    pub fixed: bool,
}

/// A message type with all the types it consists of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Definition {
    /// The type itself is last; every layout comes after those it consists of.
    pub(super) layouts: Vec<Layout>,
    /// Whether bodies are CDR, as in ROS 2.
    pub(super) cdr: bool,
}

impl Definition {
    /// Parses the full text of a definition, as found in a publisher's header or a bag: the type's own lines, then
    /// `MSG: package/Type` sections.
    ///
    /// # Errors
    /// [`RosError::Definition`] if the text is too long, broken, incomplete, recursive or too deep.
    pub fn parse(type_name: &str, text: &str) -> Result<Self, RosError> {
        let failed = |reason: String| RosError::definition(type_name, reason);
        type_name.parse::<TypeName>().map_err(|_| failed("its type is not package/Type".into()))?;
        if text.len() > LONGEST_DEFINITION {
            return Err(failed(format!("it is longer than {LONGEST_DEFINITION} bytes")));
        }
        let sections = sections(type_name, text).map_err(failed)?;
        let layouts = Nesting::layouts_of(type_name, sections, layout).map_err(failed)?;
        Ok(Self { layouts, cdr: false })
    }

    /// The type's name, `package/Type`; for ROS 2 `package/msg/Type`.
    pub fn type_name(&self) -> &str {
        self.root().map_or("", |layout| layout.name.as_str())
    }

    /// The type's name as written in ROS 1.
    pub fn short_name(&self) -> String {
        self.type_name().replacen("/msg/", "/", 1)
    }

    /// The md5sum as ROS 1 computes it: over the constants and fields without comments, each nested
    /// type replaced by its own md5sum.
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
        let first = self.root().and_then(|layout| layout.fields.first());
        first.is_some_and(|field| match field.kind {
            Kind::Message(index) => {
                let named = |layout: &Layout| [HEADER, OLD_HEADER].contains(&layout.name.as_str());
                field.arity == Arity::One && self.layouts.get(index).is_some_and(named)
            }
            Kind::Primitive(_) => false,
        })
    }

    pub(super) fn root(&self) -> Option<&Layout> {
        self.layouts.last()
    }
}

const HEADER: &str = "std_msgs/Header";

/// Its name before 2011.
const OLD_HEADER: &str = "roslib/Header";

/// Splits the text at its `MSG:` lines; a type given twice keeps its first text.
fn sections<'a>(type_name: &'a str, text: &'a str) -> Result<Texts<'a>, String> {
    let mut sections = Texts::new();
    let mut name = type_name;
    let mut lines = Vec::new();
    let mut after_rule = false;
    for line in text.lines() {
        let rule = line.len() >= 20 && line.bytes().all(|b| b == b'=');
        if let Some(next) = line.strip_prefix("MSG: ").filter(|_| after_rule) {
            sections.entry(name.to_owned()).or_insert(std::mem::take(&mut lines));
            name = next.trim();
        } else if !rule {
            lines.push(line);
        }
        after_rule = rule;
        if sections.len() >= MOST_TYPES {
            return Err(format!("it has more than {MOST_TYPES} types"));
        }
    }
    sections.entry(name.to_owned()).or_insert(lines);
    Ok(sections)
}

/// The layout of a type and its number of levels.
fn layout(nesting: &mut Nesting<'_, Layout>, name: &str, lines: &[&str]) -> Result<(Layout, usize), String> {
    let mut layout =
        Layout { name: name.to_owned(), fields: Vec::new(), constants: Vec::new(), minimum: 0, fixed: true };
    let mut height = 1;
    for line in lines {
        match parse_line(line).map_err(|reason| format!("{reason} in {name}"))? {
            None => {}
            Some(Line::Constant { base, name, text }) => layout.constants.push(format!("{base} {name}={text}")),
            Some(Line::Field { written, base, arity, name: field }) => {
                let (kind, below) = kind(nesting, name, base)?;
                height = height.max(below + 1);
                let field = Field { name: field.into(), kind, arity, written: written.to_owned() };
                measure(&nesting.layouts, &mut layout, &field);
                layout.fields.push(field);
            }
        }
    }
    Ok((layout, height))
}

fn kind(nesting: &mut Nesting<'_, Layout>, inside: &str, base: &str) -> Result<(Kind, usize), String> {
    if let Some(primitive) = Primitive::parse(base) {
        return Ok((Kind::Primitive(primitive), 0));
    }
    let full = match (base, inside.split_once('/')) {
        // Bags from before 2011 carry the header under its old name.
        ("Header", _) if !nesting.has(HEADER) && nesting.has(OLD_HEADER) => OLD_HEADER.to_owned(),
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

fn measure(layouts: &[Layout], layout: &mut Layout, field: &Field) {
    let (size, fixed) = element_size(layouts, field.kind);
    let (least, fixed) = match field.arity {
        Arity::One => (size, fixed),
        Arity::Fixed(count) => (size.saturating_mul(count), fixed),
        Arity::Variable => (4, false),
    };
    layout.minimum = layout.minimum.saturating_add(least);
    layout.fixed &= fixed;
}

/// Fewest bytes of one element, and whether it never has more.
pub(super) fn element_size(layouts: &[Layout], kind: Kind) -> (usize, bool) {
    match kind {
        Kind::Primitive(primitive) => (primitive.size(), !primitive.is_text()),
        Kind::Message(index) => layouts.get(index).map_or((0, true), |layout| (layout.minimum, layout.fixed)),
    }
}

/// A type that needs no definition.
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
    /// A UTF-16 text, of ROS 2.
    Wide,
    Time,
    Duration,
}

impl Primitive {
    pub fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            "int8" | "byte" => Self::Int8,
            "uint8" | "char" => Self::Uint8,
            "int16" => Self::Int16,
            "uint16" => Self::Uint16,
            "int32" => Self::Int32,
            "uint32" => Self::Uint32,
            "int64" => Self::Int64,
            "uint64" => Self::Uint64,
            "float32" => Self::Float32,
            "float64" => Self::Float64,
            "string" => Self::Text,
            "time" => Self::Time,
            "duration" => Self::Duration,
            _ => return None,
        })
    }

    pub fn is_text(self) -> bool {
        matches!(self, Self::Text | Self::Wide)
    }

    /// Size in bytes; for a text, the size of its length field.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 | Self::Text | Self::Wide => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 | Self::Time | Self::Duration => 8,
        }
    }
}

/// How many of its type a field holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Arity {
    One,
    Fixed(usize),
    Variable,
}

/// A meaningful line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Line<'a> {
    Field { written: &'a str, base: &'a str, arity: Arity, name: &'a str },
    Constant { base: &'a str, name: &'a str, text: &'a str },
}

/// Parses one line; `None` if it is blank or a comment.
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

fn is_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    name.len() <= 255
        && bytes.next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_')
        && bytes.all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// The deepest nesting of messages.
pub const DEEPEST: usize = 16;

/// The lines of each type, by its full name.
pub(super) type Texts<'a> = HashMap<String, Vec<&'a str>>;

/// Builds the layout and height of a type from its lines; for nested types it calls [`Nesting::resolve`] with itself.
pub(super) type Make<'a, T> = fn(&mut Nesting<'a, T>, &str, &[&str]) -> Result<(T, usize), String>;

/// The types of one definition resolved so far.
pub(super) struct Nesting<'a, T> {
    texts: Texts<'a>,
    /// Index and height (nested levels, itself included) of each resolved type.
    done: HashMap<String, (usize, usize)>,
    path: Vec<String>,
    /// Each comes after those it consists of.
    pub layouts: Vec<T>,
}

impl<'a, T> Nesting<'a, T> {
    /// The layouts of `name` and of all types it consists of, itself last.
    ///
    /// # Errors
    /// In words: a type that is missing, contains itself or is nested too deep, and errors from `make`.
    pub fn layouts_of(name: &str, texts: Texts<'a>, make: Make<'a, T>) -> Result<Vec<T>, String> {
        let mut nesting = Self { texts, done: HashMap::new(), path: Vec::new(), layouts: Vec::new() };
        nesting.resolve(name, make)?;
        Ok(nesting.layouts)
    }

    /// Whether a type has a text here.
    pub fn has(&self, name: &str) -> bool {
        self.texts.contains_key(name)
    }

    /// Index and height of a type's layout.
    pub fn resolve(&mut self, name: &str, make: Make<'a, T>) -> Result<(usize, usize), String> {
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

/// The header of ROS 1, which has a number that ROS 2 dropped.
const HEADER_TEXT: (&str, &str) = ("std_msgs/Header", include_str!("../msg/Header.msg"));

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
    if name == HEADER_TEXT.0 {
        return Some(HEADER_TEXT.1.to_owned());
    }
    let (package, bare) = name.split_once('/')?;
    let text = ros2::text_of(&format!("{package}/msg/{bare}"))?;
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
