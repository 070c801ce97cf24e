//! Times as people type them, one grammar for the command line, the console's forms and its filters: `10m`, `-10m`,
//! `18:00`, `tomorrow 18:00`, `2026-11-27 18:00`, RFC 3339. A clock without `Z`, `UTC` or an offset is in the reader's
//! time zone. What clocks skip or show twice there is refused, not guessed.

use jiff::civil::{Date, Time, Weekday};
use jiff::tz::{AmbiguousOffset, Offset, TimeZone};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::{Timestamp, clean, positive_span};

/// What a time without a day or sign is read towards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Of records: `10m` is ten minutes ago, `18:00` the last one.
    Back,
    /// Of ends: `10m` is in ten minutes, `18:00` the next one.
    Ahead,
}

impl Direction {
    fn forms(self) -> &'static str {
        match self {
            Self::Back => "10m (ten minutes ago), 18:00, yesterday 18:00, 2026-11-27 18:00 or 2026-11-27T18:00:00Z",
            Self::Ahead => "30d (in thirty days), 18:00, tomorrow 18:00, 2026-11-27 18:00 or 2026-11-27T18:00:00Z",
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MomentError {
    #[error("write {forms}; '{0}' is not a time", forms = .1.forms())]
    Form(String, Direction),
    #[error("enter another time: clocks there skip {0}")]
    Skipped(String),
    #[error("add the offset to UTC, as in 2026-10-25T02:30:00+01:00: clocks there show {0} twice")]
    Twice(String),
    #[error("enter a later time: {0} has passed")]
    Passed(String),
}

/// The reader's time zone; `None` = UTC, nothing local to show.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Zone(Option<TimeZone>);

impl Zone {
    pub fn new(zone: TimeZone) -> Self {
        Self(Some(zone))
    }

    /// Of this machine, or of `TZ`.
    pub fn system() -> Self {
        Self::new(TimeZone::system())
    }

    /// `15:04:05`.
    pub fn clock(&self, moment: Timestamp) -> Option<String> {
        let there = zoned(moment, self.0.clone()?)?;
        Some(format!("{:02}:{:02}:{:02}", there.hour(), there.minute(), there.second()))
    }

    fn zone(&self) -> TimeZone {
        self.0.clone().unwrap_or(TimeZone::UTC)
    }
}

/// What typed times are read against.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Clock {
    pub now: Timestamp,
    pub zone: Zone,
}

impl Clock {
    pub fn system() -> Self {
        Self { now: Timestamp::now(), zone: Zone::system() }
    }

    /// The boundary of a span of records.
    pub fn back(&self, text: &str) -> Result<Timestamp, MomentError> {
        self.read(text, Direction::Back)
    }

    /// The end of a right: later than now, rounded up to the chain's whole second.
    pub fn end(&self, text: &str) -> Result<Timestamp, MomentError> {
        let end = self.read(text, Direction::Ahead)?.to_whole_second();
        if end <= self.now { Err(MomentError::Passed(self.meaning(end))) } else { Ok(end) }
    }

    /// `2026-11-27 18:00:00 local = 2026-11-27 17:00:00 UTC`; UTC alone where both are the same.
    pub fn meaning(&self, moment: Timestamp) -> String {
        let utc = format!("{} UTC", civil(moment, TimeZone::UTC).unwrap_or_else(|| moment.to_string()));
        match zoned(moment, self.zone.zone()).filter(|there| there.offset() != Offset::UTC) {
            Some(_) => format!("{} local = {utc}", civil(moment, self.zone.zone()).unwrap_or_default()),
            None => utc,
        }
    }

    /// A text that names these times in UTC, with the reader's time before each.
    pub fn explained(&self, text: &str, times: &[Timestamp]) -> String {
        times.iter().fold(text.to_owned(), |text, time| text.replace(&time.in_utc(), &self.meaning(*time)))
    }

    /// Whether a text says all of it, so that nothing is to be explained.
    pub fn is_absolute(text: &str) -> bool {
        OffsetDateTime::parse(text.trim(), &Rfc3339).is_ok()
    }

    pub fn read(&self, text: &str, direction: Direction) -> Result<Timestamp, MomentError> {
        let text = text.trim();
        let wrong = || MomentError::Form(clean(text, 40), direction);
        if text.eq_ignore_ascii_case("now") {
            return Ok(self.now);
        }
        if let Some(moment) = self.by_span(text, direction) {
            return Ok(moment);
        }
        if let Ok(moment) = OffsetDateTime::parse(text, &Rfc3339) {
            return u64::try_from(moment.unix_timestamp_nanos()).map(Timestamp).map_err(|_| wrong());
        }
        let typed = Typed::read(text).ok_or_else(wrong)?;
        let zone = typed.zone.clone().unwrap_or_else(|| self.zone.zone());
        let date = self.day_of(&typed, &zone, direction).ok_or_else(wrong)?;
        moment_of(date, typed.time, &zone)?.ok_or_else(wrong)
    }

    fn by_span(&self, text: &str, direction: Direction) -> Option<Timestamp> {
        let (back, length) = match text.split_at_checked(1) {
            Some(("-", rest)) => (true, rest),
            Some(("+", rest)) => (false, rest),
            _ => (direction == Direction::Back, text),
        };
        let length = positive_span(length).ok()?.as_nanos();
        let length = u64::try_from(length).unwrap_or(u64::MAX);
        Some(Timestamp(if back { self.now.0.saturating_sub(length) } else { self.now.0.saturating_add(length) }))
    }

    fn day_of(&self, typed: &Typed, zone: &TimeZone, direction: Direction) -> Option<Date> {
        let today = zoned(self.now, zone.clone())?.date();
        let (wanted, days) = match typed.day {
            Some(Day::Of(date)) => return Some(date),
            Some(Day::Away(days)) => return shifted(today, days),
            Some(Day::Named(weekday)) => (shifted(today, -i32::from(today.weekday().since(weekday)))?, 7),
            None => (today, 1),
        };
        // Decides only the day; whether clocks there show the time on it is checked afterwards.
        let at = wanted.to_datetime(typed.time.unwrap_or_default());
        let at = of_jiff(zone.to_ambiguous_zoned(at).compatible().ok()?.timestamp())?;
        match direction {
            Direction::Back if at > self.now => shifted(wanted, -days),
            Direction::Ahead if at <= self.now => shifted(wanted, days),
            Direction::Back | Direction::Ahead => Some(wanted),
        }
    }
}

/// `None`: no moment that a ledger can hold.
fn moment_of(date: Date, time: Option<Time>, zone: &TimeZone) -> Result<Option<Timestamp>, MomentError> {
    let Some(time) = time else {
        // A day begins at its first moment, even where clocks skip midnight.
        return Ok(date.to_zoned(zone.clone()).ok().and_then(|start| of_jiff(start.timestamp())));
    };
    let at = zone.to_ambiguous_zoned(date.to_datetime(time));
    let named = || format!("{date} {time}");
    match at.offset() {
        AmbiguousOffset::Gap { .. } => Err(MomentError::Skipped(named())),
        AmbiguousOffset::Fold { .. } => Err(MomentError::Twice(named())),
        AmbiguousOffset::Unambiguous { .. } => Ok(at.compatible().ok().and_then(|at| of_jiff(at.timestamp()))),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Day {
    Of(Date),
    /// Days from today.
    Away(i32),
    Named(Weekday),
}

/// A day, a clock, or both, and perhaps a zone.
#[derive(Debug, Clone, PartialEq)]
struct Typed {
    day: Option<Day>,
    time: Option<Time>,
    zone: Option<TimeZone>,
}

impl Typed {
    fn read(text: &str) -> Option<Self> {
        let lower = text.to_ascii_lowercase();
        // `2026-11-27T18:00`, `2026-11-27Z`
        let joined = lower
            .split_at_checked(10)
            .filter(|(date, rest)| date_of(date).is_some() && rest.starts_with(|sign: char| !sign.is_ascii_digit()));
        let split = |(date, rest): (&str, &str)| format!("{date} {}", rest.strip_prefix('t').unwrap_or(rest));
        let lower = joined.map_or_else(|| lower.clone(), split);
        let mut words = lower.split_whitespace().peekable();
        let day = words.next_if(|word| day_of(word).is_some()).and_then(day_of);
        let clock = words.peek().copied().map(split_zone).filter(|(clock, _)| time_of(clock).is_some());
        let (time, mut zone) = match clock {
            Some((clock, zone)) => {
                words.next();
                (time_of(clock), zone)
            }
            None => (None, None),
        };
        if zone.is_none() {
            zone = words.next_if(|word| zone_of(word).is_some());
        }
        let zone = match zone {
            Some(zone) => Some(zone_of(zone)?),
            None => None,
        };
        let whole = words.next().is_none() && (day.is_some() || time.is_some());
        whole.then_some(Self { day, time, zone })
    }
}

/// `18:00+01:00` and `18:00z` in two.
fn split_zone(word: &str) -> (&str, Option<&str>) {
    let place = word.find(['+', '-', 'z', 'u']);
    place.and_then(|place| word.split_at_checked(place)).map_or((word, None), |(clock, zone)| (clock, Some(zone)))
}

fn day_of(word: &str) -> Option<Day> {
    const DAYS: [(&str, Weekday); 7] = [
        ("monday", Weekday::Monday),
        ("tuesday", Weekday::Tuesday),
        ("wednesday", Weekday::Wednesday),
        ("thursday", Weekday::Thursday),
        ("friday", Weekday::Friday),
        ("saturday", Weekday::Saturday),
        ("sunday", Weekday::Sunday),
    ];
    match word {
        "today" => Some(Day::Away(0)),
        "yesterday" => Some(Day::Away(-1)),
        "tomorrow" => Some(Day::Away(1)),
        _ => {
            let is_it = |(name, _): &&(&str, Weekday)| *name == word || name.get(..3) == Some(word);
            let named = DAYS.iter().find(is_it).map(|(_, weekday)| Day::Named(*weekday));
            named.or_else(|| date_of(word).map(Day::Of))
        }
    }
}

/// `2026-11-27`.
fn date_of(word: &str) -> Option<Date> {
    let [year, month, day] = parts(word, '-')?;
    if (year.len(), month.len(), day.len()) != (4, 2, 2) {
        return None;
    }
    Date::new(number(year)?, number(month)?, number(day)?).ok()
}

/// `18:00`, `18:00:05`, `18:00:05.250`; at most nine digits of the second.
fn time_of(word: &str) -> Option<Time> {
    let (clock, part) = word.split_once('.').map_or((word, None), |(clock, part)| (clock, Some(part)));
    let [hour, minute, second] = match parts(clock, ':') {
        Some(all) => all,
        None if part.is_none() => {
            let [hour, minute] = parts(clock, ':')?;
            [hour, minute, "00"]
        }
        None => return None,
    };
    if !(1..=2).contains(&hour.len()) || minute.len() != 2 || second.len() != 2 {
        return None;
    }
    let nanoseconds = match part {
        Some(digits) if (1..=9).contains(&digits.len()) => number(&format!("{digits:0<9}"))?,
        Some(_) => return None,
        None => 0,
    };
    Time::new(number(hour)?, number(minute)?, number(second)?, nanoseconds).ok()
}

/// `utc`, `z`, `+01:00`.
fn zone_of(word: &str) -> Option<TimeZone> {
    if matches!(word, "utc" | "z") {
        return Some(TimeZone::UTC);
    }
    let (sign, rest) = word.split_at_checked(1).filter(|(sign, _)| matches!(*sign, "+" | "-"))?;
    let [hours, minutes] = parts(rest, ':').filter(|[hours, minutes]| hours.len() == 2 && minutes.len() == 2)?;
    let (hours, minutes): (i32, i32) = (number(hours)?, number(minutes)?);
    let seconds = (hours * 60 + minutes) * 60;
    let usual = hours < 24 && minutes < 60;
    Offset::from_seconds(if sign == "-" { -seconds } else { seconds }).ok().filter(|_| usual).map(TimeZone::fixed)
}

fn parts<const N: usize>(text: &str, sign: char) -> Option<[&str; N]> {
    let parts: Vec<&str> = text.split(sign).collect();
    parts.try_into().ok()
}

/// Digits alone: no sign.
fn number<T: std::str::FromStr>(digits: &str) -> Option<T> {
    digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok()).flatten()
}

fn shifted(date: Date, days: i32) -> Option<Date> {
    date.checked_add(jiff::Span::new().days(days)).ok()
}

fn zoned(moment: Timestamp, zone: TimeZone) -> Option<jiff::Zoned> {
    jiff::Timestamp::from_nanosecond(i128::from(moment.0)).ok().map(|moment| moment.to_zoned(zone))
}

fn of_jiff(moment: jiff::Timestamp) -> Option<Timestamp> {
    u64::try_from(moment.as_nanosecond()).ok().map(Timestamp)
}

/// `2026-11-27 18:00:00`, with milliseconds if there are any.
fn civil(moment: Timestamp, zone: TimeZone) -> Option<String> {
    let there = zoned(moment, zone)?;
    let clock = format!("{:02}:{:02}:{:02}", there.hour(), there.minute(), there.second());
    let thousandths = there.subsec_nanosecond() / 1_000_000;
    let part = if thousandths > 0 { format!(".{thousandths:03}") } else { String::new() };
    Some(format!("{} {clock}{part}", there.date()))
}

#[cfg(test)]
mod tests;
