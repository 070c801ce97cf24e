//! The palette.

use crate::app::form::Field;

#[derive(Debug, Default)]
pub struct Palette {
    pub field: Field,
    pub selected: usize,
    /// Recalled command, counted from the newest.
    pub recalled: Option<usize>,
}
