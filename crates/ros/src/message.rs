//! Messages of any type, of ROS 1 and ROS 2: definitions, their md5sum or type hash, and decoding for display.
//! Definition and body are hostile (cycles, depth, counts without bytes, types without size); captured bodies never
//! change.

mod decode;
mod definition;
mod json;
mod ros2;

pub use decode::{Limits, Picture, Value};
pub use definition::{DEEPEST, Definition, LONGEST_DEFINITION, built_in_definition};
pub use json::layout;
pub(super) use ros2::plain_text;
pub use ros2::{Folders, Source, is_built_in, type_hash};

use super::Result;

/// From the full text of a definition: 32 hex characters.
pub fn md5sum(type_name: &str, definition: &str) -> Result<String> {
    Definition::parse(type_name, definition).map(|definition| definition.md5sum())
}

#[cfg(test)]
mod tests;
