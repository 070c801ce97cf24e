//! Turns the text of arguments into the model's words, with errors of kind `Input`.

use std::fmt::Display;
use std::str::FromStr;
use std::time::Duration;

use crate::model::{ErrorKind, RecordKind, RecordState, SignerId, Timestamp, bytes::unhex, clean, positive_span};
use crate::service::{Failure, UploadQuery};

use super::args::ListArguments;

/// Parses one value.
///
/// # Errors
/// A [`Failure`] of kind `Input` with the type's own words.
pub fn value<T: FromStr<Err: Display>>(text: &str) -> Result<T, Failure> {
    text.parse().map_err(|error: T::Err| Failure::new(ErrorKind::Input, error.to_string()))
}

/// Parses several values.
///
/// # Errors
/// As [`value`], for the first that fails.
pub fn values<T: FromStr<Err: Display>>(texts: &[String]) -> Result<Vec<T>, Failure> {
    texts.iter().map(|text| value(text)).collect()
}

/// A length of time that is not 0.
///
/// # Errors
/// A [`Failure`] of kind `Input` that says how to write it.
pub fn duration(text: &str) -> Result<Duration, Failure> {
    positive_span(text).map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))
}

/// A gateway's fingerprint: the whole id, with or without spaces between.
///
/// # Errors
/// A [`Failure`] of kind `Input` that says how to write it.
pub fn fingerprint(text: &str) -> Result<SignerId, Failure> {
    let digits: String = text.chars().filter(|character| !character.is_whitespace()).collect();
    unhex(&digits).and_then(|bytes| SignerId::from_slice(&bytes)).ok_or_else(|| {
        let advice = match digits.len() {
            32 => "that is the fingerprint; give the key of 64 hex characters that the gateway shows beside it",
            _ => "a gateway's operator shows it as 64 hex characters",
        };
        Failure::new(ErrorKind::Input, format!("'{}' is no gateway's key; {advice}", clean(text, 80)))
    })
}

/// A tag, `key=value`.
///
/// # Errors
/// A [`Failure`] of kind `Input` that says how to write it.
pub fn tag(text: &str) -> Result<(String, String), Failure> {
    let usable = |key: &str| {
        !key.is_empty() && key.len() <= 64 && key.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
    };
    match text.split_once('=') {
        Some((key, value)) if usable(key) && value.len() <= 1024 => Ok((key.to_owned(), value.to_owned())),
        _ => Err(Failure::new(
            ErrorKind::Input,
            format!("'{}' is not a tag; write key=value, the key of letters, digits, - and _", clean(text, 60)),
        )),
    }
}

fn word<T: Copy>(text: &str, what: &str, all: &[(&str, T)]) -> Result<T, Failure> {
    all.iter().find(|(word, _)| *word == text).map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<&str> = all.iter().map(|(word, _)| *word).collect();
        Failure::new(ErrorKind::Input, format!("'{}' is no {what}; it is one of {}", clean(text, 40), words.join(", ")))
    })
}

pub fn moment(text: &str) -> Result<Timestamp, Failure> {
    serde_json::from_value(serde_json::Value::String(text.to_owned())).map_err(|_| {
        Failure::new(ErrorKind::Input, format!("'{}' is not a time; write it as 2026-11-21T08:30:00Z", clean(text, 40)))
    })
}

/// The query of a list command.
///
/// # Errors
/// A [`Failure`] of kind `Input` naming the filter at fault.
pub fn query(arguments: &ListArguments) -> Result<UploadQuery, Failure> {
    let states: Vec<(&str, RecordState)> = RecordState::ALL.iter().map(|state| (state.word(), *state)).collect();
    let kinds: Vec<(&str, RecordKind)> =
        (1..=9).filter_map(RecordKind::from_code).map(|kind| (kind.word(), kind)).collect();
    if !(1..=1000).contains(&arguments.limit) {
        return Err(Failure::new(ErrorKind::Input, format!("--limit {} is not between 1 and 1000", arguments.limit)));
    }
    Ok(UploadQuery {
        owner: arguments.owner.as_deref().map(value).transpose()?,
        topic: arguments.topic.as_deref().map(value).transpose()?,
        type_name: arguments.type_name.as_deref().map(value).transpose()?,
        words: Vec::new(),
        tags: arguments.tags.iter().map(|text| tag(text)).collect::<Result<_, _>>()?,
        kind: arguments.kind.as_deref().map(|text| word(text, "kind of record", &kinds)).transpose()?,
        state: arguments.state.as_deref().map(|text| word(text, "state", &states)).transpose()?,
        since: arguments.since.as_deref().map(moment).transpose()?,
        until: arguments.until.as_deref().map(moment).transpose()?,
        after: arguments.after.clone(),
        limit: arguments.limit,
        newest_first: arguments.newest,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations() {
        assert_eq!(duration("10s").expect("10s"), Duration::from_secs(10));
        assert_eq!(duration("30d").expect("30d"), Duration::from_secs(30 * 86_400));
        for bad in ["", "10", "s", "0s", "-1s", "1y", "99999999999999999999s"] {
            assert_eq!(duration(bad).expect_err(bad).kind, ErrorKind::Input);
        }
    }

    #[test]
    fn tags_and_times() {
        assert_eq!(tag("mission=a=b").expect("tag"), ("mission".to_owned(), "a=b".to_owned()));
        assert!(tag("mission").is_err() && tag("=x").is_err() && tag("a b=x").is_err());
        assert!(moment("2026-11-21T08:30:00Z").is_ok() && moment("yesterday").is_err());
    }
}
