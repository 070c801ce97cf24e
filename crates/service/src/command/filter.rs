//! Terms of a list of records: flags of the command line (`--since 1h`) and words of the console's filter (`since:1h`).

use std::fmt::Display;
use std::str::FromStr;

use strum::VariantArray as _;

use super::UploadQuery;
use crate::model::{Clock, RecordKind, RecordState, clean};
use crate::reply::{Result, input};

/// The state's word without quotes for a shell.
const RIGHT_ENDED: &str = "unauthorised";

#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Term {
    Owner,
    Topic,
    Type,
    /// Several tags must all be present.
    Tag,
    State,
    Kind,
    Since,
    Until,
    Incident,
    Robot,
}

crate::model::words!(Term);

impl Term {
    pub fn named(word: &str) -> Option<Self> {
        word.parse().ok()
    }

    /// `since:10m` in two; `None` if the word is no term. A word with `:` that is no term is refused: nothing else has one.
    pub fn split(word: &str) -> Result<Option<(Self, &str)>> {
        let Some((name, text)) = word.split_once(':') else { return Ok(None) };
        match Self::named(name) {
            Some(term) => Ok(Some((term, text))),
            None => {
                let all: Vec<String> = Self::VARIANTS.iter().map(|term| format!("{}:", term.word())).collect();
                let near = meant(&format!("{name}:"), all.iter().map(String::as_str));
                Err(input(format!("{near}'{}:' is not a filter; use one of {}", clean(name, 40), all.join(" "))))
            }
        }
    }
}

/// The words of a filter; those of one time are one: `since:yesterday 18:00 UTC`.
pub fn words(text: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let is_clock = word.starts_with(|first: char| first.is_ascii_digit()) && word.contains(':');
        let goes_on = is_clock || word.eq_ignore_ascii_case("utc");
        match words.last_mut().filter(|last| last.starts_with("since:") || last.starts_with("until:")) {
            Some(last) if goes_on => *last = format!("{last} {word}"),
            _ => words.push(word.to_owned()),
        }
    }
    words
}

/// `did you mean 'since:'? ` if one of the words is close to this one.
fn meant<'a>(word: &str, all: impl Iterator<Item = &'a str>) -> String {
    let word: String = word.chars().take(40).collect();
    let nearest = all.map(|known| (strsim::levenshtein(&word, known), known)).min();
    let close = nearest.filter(|(distance, known)| *distance * 3 <= known.len());
    close.map_or_else(String::new, |(_, known)| format!("did you mean '{known}'? "))
}

impl UploadQuery {
    /// Adds a term. Durations are counted back from the clock's moment.
    pub fn take(&mut self, term: Term, text: &str, clock: &Clock) -> Result<()> {
        match term {
            Term::Owner => self.owner = Some(parsed(text)?),
            Term::Topic => self.topic = Some(parsed(text)?),
            Term::Type => self.type_name = Some(parsed(text)?),
            Term::Tag => self.tags.push(tag(text)?),
            // The word as shown, or the one that needs no quotes.
            Term::State if text == RecordState::RightEnded.word() => self.state = Some(RecordState::RightEnded),
            Term::State => self.state = Some(one_of(text, "state", RecordState::ALL.iter().copied(), state_word)?),
            Term::Kind => {
                let kinds = (1..=u8::MAX).filter_map(RecordKind::from_code);
                self.kind = Some(one_of(text, "kind of record", kinds, RecordKind::word)?);
            }
            Term::Since => self.since = Some(clock.back(text).map_err(|error| input(error.to_string()))?),
            Term::Until => self.until = Some(clock.back(text).map_err(|error| input(error.to_string()))?),
            Term::Incident => self.incident = Some(parsed(text)?),
            Term::Robot => self.robot = Some(robot(text)?),
        }
        Ok(())
    }
}

fn state_word(state: RecordState) -> &'static str {
    if state == RecordState::RightEnded { RIGHT_ENDED } else { state.word() }
}

fn parsed<T: FromStr<Err: Display>>(text: &str) -> Result<T> {
    text.parse().map_err(|error: T::Err| input(error.to_string()))
}

fn one_of<T: Copy>(text: &str, what: &str, all: impl IntoIterator<Item = T>, word: fn(T) -> &'static str) -> Result<T> {
    let all: Vec<T> = all.into_iter().collect();
    all.iter().find(|one| word(**one) == text).copied().ok_or_else(|| {
        let words: Vec<&str> = all.iter().map(|one| word(*one)).collect();
        let near = meant(text, words.iter().copied());
        input(format!("{near}'{}' is not a {what}; choose one of {}", clean(text, 40), words.join(", ")))
    })
}

/// A robot's name: as enrolled, or the first part of its topics.
pub fn robot(text: &str) -> Result<String> {
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.".contains(&byte);
    match (1..=64).contains(&text.len()) && text.bytes().all(fits) {
        true => Ok(text.to_owned()),
        false => Err(input(format!(
            "'{}' is not a robot's name; give the name that it was enrolled under, or the first part of its topics, as \
             robot1 for /robot1/odom",
            clean(text, 40)
        ))),
    }
}

/// A tag, `key=value`.
pub fn tag(text: &str) -> Result<(String, String)> {
    let usable = |key: &str| {
        !key.is_empty() && key.len() <= 64 && key.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
    };
    match text.split_once('=') {
        Some((key, value)) if usable(key) && value.len() <= 1024 => Ok((key.to_owned(), value.to_owned())),
        _ => Err(input(format!(
            "'{}' is not a tag; use key=value, with letters, digits, - and _ in the key",
            clean(text, 60)
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind;

    #[test]
    fn a_word_with_a_colon_is_a_term_or_an_error() {
        assert_eq!(Term::split("since:21:50:00").expect("a term"), Some((Term::Since, "21:50:00")));
        assert_eq!(Term::split("odom").expect("a word"), None);
        for (word, near) in [
            ("unti:40s", "did you mean 'until:'? 'unti:'"),
            ("sinc:1m", "did you mean 'since:'?"),
            ("topics:/odom", "did you mean 'topic:'?"),
            ("stat:verified", "did you mean 'state:'?"),
            ("colour:red", "'colour:' is not a filter; use one of owner: topic: type: tag: state:"),
            (":", "'"),
        ] {
            let failure = Term::split(word).expect_err(word);
            assert_eq!(failure.kind, ErrorKind::Input);
            assert!(failure.message.starts_with(near), "{word}: {failure}");
            assert!(failure.message.contains("since: until:"), "{word}: {failure}");
        }
    }

    #[test]
    fn the_words_of_a_time_are_one() {
        let text = "odom since:yesterday 18:00 until:2026-11-27 18:05:00.5 UTC state:verified camera 18:00";
        let expected =
            ["odom", "since:yesterday 18:00", "until:2026-11-27 18:05:00.5 UTC", "state:verified", "camera", "18:00"];
        assert_eq!(words(text), expected);
    }

    #[test]
    fn a_term_that_cannot_be_read_leaves_the_query_as_it_was() {
        let mut query = UploadQuery::default();
        for &term in Term::VARIANTS {
            assert_eq!(Term::named(term.word()), Some(term));
            let failure = query.take(term, "%", &Clock::default()).expect_err(term.word());
            assert_eq!(failure.kind, ErrorKind::Input, "{failure}");
        }
        assert_eq!(query, UploadQuery::default());
        let refused = query.take(Term::State, "verifed", &Clock::default()).expect_err("no such state");
        assert!(refused.message.starts_with("did you mean 'verified'?"), "{refused}");
        assert!(refused.message.contains(", unauthorised"), "{refused}");
        for word in ["unauthorised", "waits: unauthorised"] {
            let mut query = UploadQuery::default();
            query.take(Term::State, word, &Clock::default()).expect("both are understood");
            assert_eq!(query.state, Some(RecordState::RightEnded));
        }
        assert!(query.take(Term::Kind, "gap", &Clock::default()).is_ok() && query.kind == Some(RecordKind::Gap));
    }
}
