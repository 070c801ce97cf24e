//! Terms of a list of records: flags of the command line (`--since 1h`) and words of the console's filter (`since:1h`).

use std::fmt::Display;
use std::str::FromStr;

use super::UploadQuery;
use crate::model::{RecordKind, RecordState, Timestamp, clean, positive_span};
use crate::service::failure::input;
use crate::service::reply::Failure;

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
}

impl Term {
    /// Its word: after `--`, or before `:`.
    pub fn word(self) -> &'static str {
        self.into()
    }

    pub fn named(word: &str) -> Option<Self> {
        word.parse().ok()
    }
}

impl UploadQuery {
    /// Adds a term. Durations are counted back from `now`.
    pub fn take(&mut self, term: Term, text: &str, now: Timestamp) -> Result<(), Failure> {
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
            Term::Since => self.since = Some(past(text, now)?),
            Term::Until => self.until = Some(past(text, now)?),
            Term::Incident => self.incident = Some(parsed(text)?),
        }
        Ok(())
    }
}

fn state_word(state: RecordState) -> &'static str {
    if state == RecordState::RightEnded { RIGHT_ENDED } else { state.word() }
}

fn parsed<T: FromStr<Err: Display>>(text: &str) -> Result<T, Failure> {
    text.parse().map_err(|error: T::Err| input(error.to_string()))
}

fn one_of<T: Copy>(
    text: &str,
    what: &str,
    all: impl IntoIterator<Item = T>,
    word: fn(T) -> &'static str,
) -> Result<T, Failure> {
    let all: Vec<T> = all.into_iter().collect();
    all.iter().find(|one| word(**one) == text).copied().ok_or_else(|| {
        let words: Vec<&str> = all.iter().map(|one| word(*one)).collect();
        input(format!("'{}' is not a {what}; choose one of {}", clean(text, 40), words.join(", ")))
    })
}

/// A tag, `key=value`.
pub fn tag(text: &str) -> Result<(String, String), Failure> {
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

pub fn moment(text: &str) -> Result<Timestamp, Failure> {
    serde_json::from_value(serde_json::Value::String(text.to_owned()))
        .map_err(|_| input(format!("'{}' is not a time; use the form 2026-11-21T08:30:00Z", clean(text, 40))))
}

/// A time, the beginning of a day (UTC), or a duration before `now`.
pub fn past(text: &str, now: Timestamp) -> Result<Timestamp, Failure> {
    if let Ok(moment) = moment(text).or_else(|_| moment(&format!("{text}T00:00:00Z"))) {
        return Ok(moment);
    }
    let length = positive_span(text).map_err(|_| {
        let forms = "2026-11-21T08:30:00Z, 2026-11-21, or a duration ago such as 10m, 12h or 2d";
        input(format!("'{}' is not a time; use {forms}", clean(text, 40)))
    })?;
    Ok(Timestamp(now.0.saturating_sub(u64::try_from(length.as_nanos()).unwrap_or(u64::MAX))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind;
    use strum::VariantArray as _;

    #[test]
    fn moments_are_times_days_and_lengths_of_time_ago() {
        let now = Timestamp::from_seconds(1_700_000_000);
        let read = |text| past(text, now).map(|moment| moment.seconds()).map_err(|failure| failure.kind);
        // date -u -d 2023-11-14T22:13:20Z +%s, and for the day
        assert_eq!((read("2023-11-14T22:13:20Z"), read("2023-11-14")), (Ok(1_700_000_000), Ok(1_699_920_000)));
        assert_eq!((read("30s"), read("2w")), (Ok(1_699_999_970), Ok(1_698_790_400)));
        for bad in ["yesterday", "", "0s", "-1d", "2023-13-01"] {
            assert_eq!(read(bad), Err(ErrorKind::Input), "{bad}");
        }
    }

    #[test]
    fn a_term_that_cannot_be_read_leaves_the_query_as_it_was() {
        let mut query = UploadQuery::default();
        for &term in Term::VARIANTS {
            assert_eq!(Term::named(term.word()), Some(term));
            let failure = query.take(term, "%", Timestamp(0)).expect_err(term.word());
            assert_eq!(failure.kind, ErrorKind::Input, "{failure}");
        }
        assert_eq!(query, UploadQuery::default());
        let refused = query.take(Term::State, "verifed", Timestamp(0)).expect_err("no such state");
        assert!(refused.message.contains(", unauthorised"), "{refused}");
        for word in ["unauthorised", "waits: unauthorised"] {
            let mut query = UploadQuery::default();
            query.take(Term::State, word, Timestamp(0)).expect("both are understood");
            assert_eq!(query.state, Some(RecordState::RightEnded));
        }
        assert!(query.take(Term::Kind, "gap", Timestamp(0)).is_ok() && query.kind == Some(RecordKind::Gap));
    }
}
