//! Nested types: texts are turned into layouts, innermost first. The result has no cycles and is at most [`DEEPEST`]
//! deep.

use std::collections::HashMap;

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
    ///
    /// # Errors
    /// As in [`Nesting::layouts_of`].
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
