//! The full text of a message definition, parsed into layouts with every nested type resolved.
//! A definition that parses has no cycles, is at most [`super::nesting::DEEPEST`] deep and of bounded size.

use std::sync::Arc;

use md5::{Digest as _, Md5};

use super::line::{Arity, Line, Primitive, parse_line};
use super::nesting::{Nesting, Texts};
use crate::model::bytes::hex;
use crate::model::topic::{LONGEST_NAME, TypeName};
use crate::ros::RosError;

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
