//! A question before an act.

use crate::app::{form::Field, verb::Errand};

/// Answered by `y`; anything else means no.
#[derive(Debug)]
pub struct Confirm {
    pub title: String,
    pub lines: Vec<String>,
    /// The word beside `y`.
    pub yes: &'static str,
    /// Typed instead of `y` for a grave act.
    pub typed: Option<Typed>,
    pub errand: Errand,
}

#[derive(Debug)]
pub struct Typed {
    pub wanted: String,
    pub field: Field,
}

impl Typed {
    pub fn new(wanted: &str) -> Self {
        Self { wanted: wanted.to_owned(), field: Field::default() }
    }

    pub fn is_done(&self) -> bool {
        self.field.text().trim() == self.wanted
    }
}
