//! The hash of an interface (RIHS01): SHA-256 over its description and those of the types it consists of, as ROS 2's
//! JSON text of them. Only names and types count, not comments, constants or default values.

use std::fmt::Write as _;

use sha2::{Digest as _, Sha256};

use super::line::Many;
use super::schema::{Interface, Member, Of, Schema};
use crate::model::bytes::hex;

/// The member of an interface that has none.
const FILLER: &str = "structure_needs_at_least_one_member";

/// The type number of an interface, and of [`FILLER`].
const INTERFACE: u8 = 1;
const UINT8: u8 = 3;

/// Bounded texts have other numbers.
const BOUNDED_TEXTS: u8 = 4;

/// The hash of a type.
pub(super) fn of(schema: &Schema) -> String {
    let Some((root, others)) = schema.interfaces.split_last() else { return String::new() };
    let mut others: Vec<&Interface> = others.iter().collect();
    others.sort_by(|one, other| one.name.cmp(&other.name));
    // Hashed as it is written: a definition of a megabyte has a description of hundreds of megabytes.
    let mut hash = Sha256::new();
    hash.update("{\"type_description\": ");
    describe(schema, root, &mut hash);
    hash.update(", \"referenced_type_descriptions\": [");
    for (place, other) in others.into_iter().enumerate() {
        hash.update(if place > 0 { ", " } else { "" });
        describe(schema, other, &mut hash);
    }
    hash.update("]}");
    format!("RIHS01_{}", hex(&hash.finalize()))
}

fn describe(schema: &Schema, interface: &Interface, hash: &mut Sha256) {
    hash.update(format!("{{\"type_name\": \"{}\", \"fields\": [", interface.name));
    for (place, member) in interface.members.iter().enumerate() {
        hash.update(if place > 0 { ", " } else { "" });
        hash.update(field(schema, member));
    }
    if interface.members.is_empty() {
        hash.update(put_field(FILLER, UINT8, 0, 0, ""));
    }
    hash.update("]}");
}

fn field(schema: &Schema, member: &Member) -> String {
    let (number, nested) = match member.of {
        Of::Plain { number, .. } if member.bound > 0 => (number + BOUNDED_TEXTS, ""),
        Of::Plain { number, .. } => (number, ""),
        Of::Interface(index) => (INTERFACE, schema.interfaces.get(index).map_or("", |nested| nested.name.as_str())),
    };
    let (more, capacity) = match member.many {
        Many::One => (0, 0),
        Many::Fixed(count) => (48, count),
        Many::Bounded(most) => (96, most),
        Many::Any => (144, 0),
    };
    put_field(&member.name, number + more, capacity, member.bound, nested)
}

fn put_field(name: &str, number: u8, capacity: usize, bound: usize, nested: &str) -> String {
    let mut out = format!("{{\"name\": \"{name}\", \"type\": {{\"type_id\": {number}, ");
    // Writing to a String cannot fail.
    let _ =
        write!(out, "\"capacity\": {capacity}, \"string_capacity\": {bound}, \"nested_type_name\": \"{nested}\"}}}}");
    out
}
