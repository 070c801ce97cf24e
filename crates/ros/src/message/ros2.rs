//! ROS 2 definitions: `.msg` texts with all the types they consist of, and the hash that identifies them.
//!
//! They become the same layouts as ROS 1 messages; only bodies are laid out differently.

mod built_in;
mod folder;
mod hash;
mod line;
mod schema;

pub(super) use built_in::text_of as interface;
pub use folder::{Folders, Source};
pub(in super::super) use schema::plain_text;

use super::definition::{Definition, Field, Kind, Layout, element_size};
use super::line::Arity;
use crate::ros::RosError;
use line::Many;
use schema::{Interface, Member, Of, Schema};

impl Definition {
    /// Parses the text of a ROS 2 definition, as in MCAP's `ros2msg`: the type's own lines, then `MSG: package/Type`
    /// sections.
    ///
    /// # Errors
    /// [`RosError::Definition`] if the text is too long, broken, incomplete, recursive or too deep.
    pub fn parse_ros2(type_name: &str, text: &str) -> Result<Self, RosError> {
        Schema::parse(type_name, text).map(|schema| Self::of_schema(&schema))
    }

    fn of_schema(schema: &Schema) -> Self {
        let mut layouts = Vec::with_capacity(schema.interfaces.len());
        for interface in &schema.interfaces {
            layouts.push(layout(interface, &layouts));
        }
        Self { layouts, cdr: true }
    }
}

/// The hash of a type as ROS 2 computes it, `RIHS01_` and 64 hex characters.
///
/// # Errors
/// [`RosError::Definition`] if the text is not a definition of `type_name`.
pub fn type_hash(type_name: &str, text: &str) -> Result<String, RosError> {
    Schema::parse(type_name, text).map(|schema| hash::of(&schema))
}

/// Whether the definition built into this program has this hash.
pub fn is_built_in(type_name: &str, hash: &str) -> bool {
    let text = Folders::default().text_of(type_name);
    text.is_ok_and(|(text, _)| type_hash(type_name, &text).is_ok_and(|found| found == hash))
}

fn layout(interface: &Interface, known: &[Layout]) -> Layout {
    let fields: Vec<Field> = interface.members.iter().map(field).collect();
    let least = |field: &Field| match field.arity {
        Arity::One => element_size(known, field.kind).0,
        Arity::Fixed(count) => element_size(known, field.kind).0.saturating_mul(count),
        Arity::Variable => 4,
    };
    let minimum = fields.iter().map(least).fold(0, usize::saturating_add).max(1);
    // The padding between numbers depends on where a message begins, so none has a fixed size.
    Layout { name: interface.name.clone(), fields, constants: Vec::new(), minimum, fixed: false }
}

fn field(member: &Member) -> Field {
    let arity = match member.many {
        Many::One => Arity::One,
        Many::Fixed(count) => Arity::Fixed(count),
        Many::Bounded(_) | Many::Any => Arity::Variable,
    };
    let kind = match member.of {
        Of::Plain { primitive, .. } => Kind::Primitive(primitive),
        Of::Interface(index) => Kind::Message(index),
    };
    Field { name: member.name.as_str().into(), kind, arity, written: member.written.clone() }
}

#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod tests;
