//! Parses arguments into the model's types, with errors of kind `Input`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::{fmt::Display, io::BufRead as _, str::FromStr, time::Duration};

use clap::builder::{PathBufValueParser, TypedValueParser};

use super::args::ListArguments;
use crate::model::{Clock, ErrorKind, SignerId, Timestamp, TopicPattern, bytes::unhex, clean, positive_span};
use crate::service::command::Term;
pub use crate::service::command::filter::tag;
use crate::service::{Failure, UploadQuery, reply::input};
use authros_output::Output;

pub fn value<T: FromStr<Err: Display>>(text: &str) -> Result<T, Failure> {
    text.parse().map_err(|error: T::Err| input(error.to_string()))
}

pub fn usage(text: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Usage, text)
}

pub fn optional<T: FromStr<Err: Display>>(text: Option<&str>) -> Result<Option<T>, Failure> {
    text.map(value).transpose()
}

pub fn values<T: FromStr<Err: Display>>(texts: &[String]) -> Result<Vec<T>, Failure> {
    texts.iter().map(|text| value(text)).collect()
}

/// Whether this word is typed, and nothing else.
pub fn typed(word: &str) -> bool {
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line).is_ok_and(|_| line.trim() == word)
}

pub fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|error| input(format!("{}: {error}", path.display())))
}

/// Refuses a file whose name breaks a line: what follows the break would look like a line of ours.
pub fn names_on_one_line(mut arguments: impl Iterator<Item = OsString>) -> Result<(), Failure> {
    let breaks = |argument: &OsString| {
        argument.to_string_lossy().chars().any(char::is_control) && Path::new(argument).symlink_metadata().is_ok()
    };
    arguments.find(breaks).map_or(Ok(()), |name| {
        let name = clean(&name.to_string_lossy(), 200);
        Err(input(format!("rename the file {name} first: its name has a line break or another control character")))
    })
}

/// Of a file to write: `-` would be one of that name.
pub fn new_file() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match path.as_os_str() == "-" {
        true => Err("nothing is written to standard output here; name a file"),
        false => Ok(path),
    })
}

pub fn tags(texts: &[String]) -> Result<Vec<(String, String)>, Failure> {
    texts.iter().map(|text| tag(text)).collect()
}

/// The times of one command, read against one moment. What each means is told, unless its text says all of it.
pub struct Times<'a> {
    pub clock: Clock,
    output: &'a Output,
}

impl<'a> Times<'a> {
    pub fn now(output: &'a Output) -> Self {
        Self { clock: Clock::system(), output }
    }

    /// The beginning of a span of records.
    pub fn since(&self, text: Option<&str>) -> Result<Option<Timestamp>, Failure> {
        text.map(|text| self.begin(text)).transpose()
    }

    pub fn begin(&self, text: &str) -> Result<Timestamp, Failure> {
        self.read("since", text, Clock::back)
    }

    /// The end of a span of records, which is not part of it.
    pub fn until(&self, text: Option<&str>) -> Result<Option<Timestamp>, Failure> {
        text.map(|text| self.read("until", text, Clock::back)).transpose()
    }

    /// The end of a right.
    pub fn end(&self, text: Option<&str>) -> Result<Option<Timestamp>, Failure> {
        text.map(|text| self.read("ends", text, Clock::end)).transpose()
    }

    fn read<E: Display>(
        &self,
        word: &str,
        text: &str,
        read: impl Fn(&Clock, &str) -> Result<Timestamp, E>,
    ) -> Result<Timestamp, Failure> {
        let moment = read(&self.clock, text).map_err(|error| input(error.to_string()))?;
        if !Clock::is_absolute(text) {
            self.output.note(&format!("{word} {}", self.clock.meaning(moment)));
        }
        Ok(moment)
    }
}

/// Topics by name, pattern or robot.
pub fn topic(topic: Option<&str>, robot: Option<&str>) -> Result<Option<TopicPattern>, Failure> {
    match robot {
        Some(robot) => TopicPattern::of_robot(robot).map(Some).map_err(|error| input(error.to_string())),
        None => optional(topic),
    }
}

/// Topics by name or pattern, and all of these robots.
pub fn topics(texts: &[String], robots: &[String]) -> Result<Vec<TopicPattern>, Failure> {
    let of_robots = robots.iter().map(|robot| TopicPattern::of_robot(robot).map_err(|error| input(error.to_string())));
    texts.iter().map(|text| value(text)).chain(of_robots).collect()
}

pub fn duration(text: &str) -> Result<Duration, Failure> {
    positive_span(text).map_err(|error| input(error.to_string()))
}

pub fn fingerprint(text: &str) -> Result<SignerId, Failure> {
    let digits: String = text.chars().filter(|character| !character.is_whitespace()).collect();
    unhex(&digits).and_then(|bytes| SignerId::from_slice(&bytes)).ok_or_else(|| {
        let advice = match digits.len() {
            32 => "that is the fingerprint; give the 64-digit hex key that the gateway prints beside it",
            _ => "its operator can give it to you as 64 hex characters",
        };
        input(format!("'{}' is not a gateway key; {advice}", clean(text, 80)))
    })
}

pub fn query(arguments: &ListArguments, output: &Output) -> Result<UploadQuery, Failure> {
    if !(1..=1000).contains(&arguments.limit) {
        return Err(input(format!("--limit {} is not between 1 and 1000", arguments.limit)));
    }
    let ListArguments { topic, robot, type_name, tags, state, kind, owner, since, until, incident, .. } = arguments;
    let (after, limit, newest_first) = (arguments.after.clone(), arguments.limit, !arguments.oldest);
    let mut query = UploadQuery { after, limit, newest_first, ..UploadQuery::default() };
    let times = Times::now(output);
    for (term, texts) in [
        (Term::Owner, owner.as_slice()),
        (Term::Topic, topic.as_slice()),
        (Term::Type, type_name.as_slice()),
        (Term::Tag, tags.as_slice()),
        (Term::State, state.as_slice()),
        (Term::Kind, kind.as_slice()),
        (Term::Incident, incident.as_slice()),
        (Term::Robot, robot.as_slice()),
    ] {
        texts.iter().try_for_each(|text| query.take(term, text, &times.clock))?;
    }
    query.since = times.since(since.as_deref())?;
    query.until = times.until(until.as_deref())?;
    Ok(query)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind;

    #[test]
    fn durations() {
        assert_eq!(duration("10s").expect("10s"), Duration::from_secs(10));
        assert_eq!(duration("30d").expect("30d"), Duration::from_secs(30 * 86_400));
        for bad in ["", "10", "s", "0s", "-1s", "1y", "99999999999999999999s"] {
            assert_eq!(duration(bad).expect_err(bad).kind, ErrorKind::Input);
        }
    }

    #[test]
    fn flags_and_the_consoles_filter_ask_for_the_same() {
        use crate::screens::records::state::Wanted;
        use clap::Parser;
        let alice = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";
        let text = format!(
            "owner:{alice} topic:/robot1/odom type:nav_msgs/Odometry tag:mission=harbour tag:shift=a=b state:verified \
             kind:gap since:2026-11-21 until:2026-11-22T08:30:00Z incident:crash robot:scout-1"
        );
        let flags = text.split(' ').flat_map(|word| {
            let (name, value) = word.split_once(':').expect("a term");
            [format!("--{name}"), value.to_owned()]
        });
        let words = ["authros", "records", "list"].map(str::to_owned).into_iter().chain(flags);
        let parsed = super::super::args::Arguments::try_parse_from(words).expect("flags");
        let Some(super::super::args::Verb::Records(super::super::args::RecordsVerb::List(list))) = parsed.verb else {
            panic!("a list");
        };
        let by_flags = query(&list, &Output::new(true)).expect("a query");
        let wanted = Wanted::read(&text, &[], &Clock::system()).expect("a filter");
        assert!(by_flags.newest_first);
        assert_eq!(UploadQuery { limit: 0, newest_first: wanted.asked.newest_first, ..by_flags }, wanted.asked);
        assert_eq!((wanted.asked.tags.len(), wanted.rest.as_str()), (2, ""));
    }

    #[test]
    fn ends_are_times_or_lengths() {
        let output = Output::new(true);
        let times = Times::now(&output);
        let end = |text: &str| times.end(Some(text)).map(|end| end.expect("an end")).map_err(|failure| failure.kind);
        assert_eq!(end("2100-01-31T12:00:00.5Z"), Ok(Timestamp::from_seconds(4_105_080_001)));
        assert_eq!(end("2h"), Ok(Timestamp(times.clock.now.0 + 7_200_000_000_000).to_whole_second()));
        assert!(end("tomorrow 18:00").is_ok());
        assert_eq!((end("yesterday"), end("soon")), (Err(ErrorKind::Input), Err(ErrorKind::Input)));
        assert_eq!(times.since(None).map_err(|failure| failure.kind), Ok(None));
    }

    #[test]
    fn a_file_whose_name_breaks_a_line_is_refused_and_a_text_may_have_lines() {
        let folder = tempfile::tempdir().expect("a folder");
        let name = folder.path().join("g\nPROVEN: all is well.authros");
        let given = |name: &Path| names_on_one_line([OsString::from("verify"), name.into()].into_iter());
        assert_eq!(given(&name).map_err(|failure| failure.kind), Ok(()), "a text");
        std::fs::write(&name, "").expect("written");
        let refused = given(&name).expect_err("a file");
        assert_eq!((refused.kind, refused.message.lines().count()), (ErrorKind::Input, 1), "{}", refused.message);
        assert_eq!(given(folder.path()).map_err(|failure| failure.kind), Ok(()));
    }

    #[test]
    fn tags_and_topics() {
        assert_eq!(tag("mission=a=b").expect("tag"), ("mission".to_owned(), "a=b".to_owned()));
        assert!(tag("mission").is_err() && tag("=x").is_err() && tag("a b=x").is_err());
        let named = topics(&["/odom".to_owned()], &["robot1".to_owned()]).expect("topics");
        assert_eq!(named.iter().map(TopicPattern::as_str).collect::<Vec<_>>(), ["/odom", "/robot1/**"]);
        assert!(topics(&["odom".to_owned()], &[]).is_err() && topics(&[], &["scout-1".to_owned()]).is_err());
    }
}
