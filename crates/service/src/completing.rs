//! Completions for a word of a command line, read from a home without a site: names of topics, contacts and profiles,
//! ids of records. Bounded, cleaned, and silent if something is wrong.

use serde::Deserialize;

use crate::model::{ProfileName, clean};
use crate::paths::Home;
use crate::site::BOOK;
use crate::store::Glance;

/// The most words returned.
const MOST: usize = 200;
/// The longest word, characters.
const LONGEST: usize = 255;

/// The kind of word to complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completed {
    /// A topic with records.
    Topic,
    /// A name of the address book.
    Contact,
    /// A record, by its id.
    Record,
    /// A profile of the home.
    Profile,
}

#[derive(Deserialize)]
struct Named {
    name: String,
}

/// Words of a kind with this prefix; none if the home does not exist or cannot be read.
pub fn words(home: &Home, kind: Completed, begun: &str) -> Vec<String> {
    let glance = || Glance::at(&home.ledger()).ok();
    let found = match kind {
        Completed::Topic => glance().and_then(|glance| glance.topics(begun, MOST).ok()),
        Completed::Record => glance().and_then(|glance| glance.ids(begun, MOST).ok()),
        Completed::Contact => glance().and_then(|glance| contacts(&glance)),
        Completed::Profile => Some(home.profiles().iter().map(ProfileName::to_string).collect()),
    };
    let fits = |word: &String| word.starts_with(begun) && !word.is_empty();
    // A word with a space would be two words to the shell.
    let one = |word: &String| !word.chars().any(|character| character.is_whitespace() || character.is_control());
    let words = found.unwrap_or_default().into_iter().map(|word| clean(&word, LONGEST));
    let lower = |word: &String| kind == Completed::Record && word.starts_with(&begun.to_ascii_lowercase());
    words.filter(|word| one(word) && (fits(word) || lower(word))).take(MOST).collect()
}

fn contacts(glance: &Glance) -> Option<Vec<String>> {
    let book: Vec<Named> = serde_json::from_str(&glance.setting(BOOK).ok()??).ok()?;
    Some(book.into_iter().map(|contact| contact.name).collect())
}
