//! Records over the last hour as this console has seen them, for the graphs; rates of topics; progress of long work.

use std::collections::VecDeque;
use std::ops::Range;

use crate::model::Timestamp;
use crate::service::reply::{LifeLine, ProgressView, SiteView};

const SECOND: u64 = 1_000_000_000;
/// Minimum distance between points of the newest quarter of an hour, nanoseconds.
const FINE: u64 = SECOND;
/// Minimum distance between older points.
const COARSE: u64 = 10 * SECOND;
/// How long the newest points stay fine, nanoseconds: over the quarter and what its window lags behind, because a line
/// drawn from fewer points is another line.
const FINE_FOR: u64 = 960 * SECOND;
/// How long points are kept, nanoseconds; slightly more than the hour that is shown.
const KEPT: u64 = 3_640 * SECOND;
/// A longer silence counts as no change until just before the next news, nanoseconds.
const QUIET: u64 = 3 * SECOND;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Period {
    Minute,
    #[default]
    Quarter,
    Hour,
}

impl Period {
    pub fn next(self) -> Self {
        match self {
            Self::Minute => Self::Quarter,
            Self::Quarter => Self::Hour,
            Self::Hour => Self::Minute,
        }
    }

    pub fn minutes(self) -> u64 {
        match self {
            Self::Minute => 1,
            Self::Quarter => 15,
            Self::Hour => 60,
        }
    }
}

/// Cells of two parts each, as many as fit of those that divide every period evenly.
pub fn cells(columns: u16) -> u16 {
    [90, 60, 45].into_iter().find(|cells| *cells <= columns).unwrap_or(30)
}

/// The parts a graph shows when that many are over, counted from the beginning of time.
///
/// The window moves by a fifteenth of its width. A line that moved with each part would change all its cells each time;
/// this way a new part changes the newest cell alone, and the terminal gets the whole line four times a minute at most.
pub fn window(over: u64, parts: usize) -> Range<u64> {
    // Whole cells, so that a move leaves the dots of a cell together.
    let step = (parts as u64 / 15).next_multiple_of(2).max(2);
    let end = over.next_multiple_of(step);
    end.saturating_sub(parts as u64)..end
}

/// One part of a line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sample {
    pub low: f64,
    pub mean: f64,
    pub high: f64,
}

impl Sample {
    pub fn level(value: f64) -> Self {
        Self { low: value, mean: value, high: value }
    }
}

/// Captured records a second from which a second with less than half of them is a stop, not chance.
const COUNTED: f64 = 5.0;

/// Of a point and those thinned out before it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extremes {
    /// Captured records a second, over a second at least.
    slowest: f64,
    fastest: f64,
    most_pending: u64,
}

impl Extremes {
    const NOTHING: Self = Self { slowest: f64::INFINITY, fastest: 0.0, most_pending: 0 };

    fn with(self, other: Self) -> Self {
        Self {
            slowest: self.slowest.min(other.slowest),
            fastest: self.fastest.max(other.fastest),
            most_pending: self.most_pending.max(other.most_pending),
        }
    }
}

/// Counts of the site at a moment; they only grow.
#[derive(Debug, Clone, PartialEq)]
struct Point {
    at: Timestamp,
    captured: u64,
    verified: u64,
    pending: u64,
    extremes: Extremes,
    /// Longest time, microseconds, and how many were verified within it, as in [`SiteView::verified_after`].
    spread: Vec<(u64, u64)>,
}

/// The points of the last hour, oldest first.
#[derive(Debug, Default)]
pub struct History {
    points: VecDeque<Point>,
}

/// A sample for each part of a [`window`]; `None` = unknown, or still to come.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Flow {
    /// Per second.
    pub captured: Vec<Option<Sample>>,
    /// Means alone: between two batches nothing is verified.
    pub verified: Vec<Option<Sample>>,
    /// The most at any moment of the part.
    pub pending: Vec<Option<Sample>>,
    /// Seconds within which 99 of 100 records of the part were verified.
    pub slowest: Vec<Option<Sample>>,
    /// Seconds within which half, and 99 of 100, were verified over the whole period.
    pub after: Option<(f64, f64)>,
}

impl Flow {
    pub fn any(&self) -> bool {
        [&self.captured, &self.verified, &self.pending].into_iter().any(|values| highest(values) > 0.0)
    }
}

pub fn highest(values: &[Option<Sample>]) -> f64 {
    values.iter().flatten().map(|sample| sample.high).fold(0.0, f64::max)
}

impl History {
    pub fn observe(&mut self, site: &SiteView, now: Timestamp) {
        let life = &site.life;
        let mut point = Point {
            at: now,
            captured: life.captured,
            verified: life.verified,
            pending: life.pending,
            extremes: Extremes { most_pending: life.pending, ..Extremes::NOTHING },
            spread: site.verified_after.clone(),
        };
        if let Some(last) = self.points.back() {
            // Another site, or another chain: earlier counts say nothing.
            if last.captured > point.captured || last.verified > point.verified || last.at > now {
                self.points.clear();
            } else if now.0 - last.at.0 > QUIET {
                let mut until_now = Point { at: Timestamp(now.0 - FINE), ..last.clone() };
                (until_now.extremes.slowest, until_now.extremes.fastest) = (0.0, 0.0);
                self.points.push_back(until_now);
            }
        }
        let before = self.points.iter().rev().nth(1);
        if before.is_some_and(|before| now.0 - before.at.0 < FINE) {
            self.points.pop_back();
        }
        if let Some(rate) = self.rate_until(&point) {
            (point.extremes.slowest, point.extremes.fastest) = (rate, rate);
        }
        self.points.push_back(point);
        self.thin(now);
    }

    /// Captured a second since the newest point that is at least a second older.
    fn rate_until(&self, point: &Point) -> Option<f64> {
        let before = self.before(Timestamp(point.at.0.checked_sub(SECOND)?))?;
        let seconds = float(point.at.0 - before.at.0) / float(SECOND);
        Some(float(point.captured - before.captured) / seconds)
    }

    fn thin(&mut self, now: Timestamp) {
        let mut kept = Timestamp(0);
        let mut thinned = Extremes::NOTHING;
        self.points.retain_mut(|point| {
            let age = now.0.saturating_sub(point.at.0);
            let keep = age <= FINE_FOR || age <= KEPT && point.at.0.saturating_sub(kept.0) >= COARSE;
            if keep {
                point.extremes = point.extremes.with(thinned);
                (thinned, kept) = (Extremes::NOTHING, point.at);
            } else if age <= KEPT {
                thinned = thinned.with(point.extremes);
            }
            keep
        });
    }

    pub fn flow(&self, period: Period, parts: usize, now: Timestamp) -> Flow {
        let (part, over) = (part(period, parts), now.0 / part(period, parts));
        let shown = window(over, parts);
        let line = |of: &dyn Fn(Timestamp, Timestamp) -> Option<Sample>| -> Vec<Option<Sample>> {
            let sample = |number| of(Timestamp(number * part), Timestamp((number + 1) * part));
            shown.clone().map(|number| if number < over { sample(number) } else { None }).collect()
        };
        Flow {
            captured: line(&|from, to| self.captured(from, to)),
            verified: line(&|from, to| self.rate(from, to, |point| point.verified).map(Sample::level)),
            pending: line(&|from, to| self.pending(from, to).map(Sample::level)),
            slowest: line(&|from, to| self.within(from, to, 99).map(Sample::level)),
            after: self.after(Timestamp(shown.start * part), now),
        }
    }

    /// `None` = nothing shown can move.
    pub fn moves_at(&self, period: Period, parts: usize, now: Timestamp) -> Option<Timestamp> {
        let part = part(period, parts);
        let from = Timestamp(window(now.0 / part, parts).start * part);
        let (first, last) = (self.before(from).or(self.points.front())?, self.points.back()?);
        let flowed = first.captured != last.captured || first.verified != last.verified;
        let moves = flowed || self.between(from, now).any(|point| point.pending != first.pending);
        moves.then_some(Timestamp((now.0 / part + 1).saturating_mul(part)))
    }

    /// A low or a high is shown only if it is far from the mean: the counts come about once a second, and not evenly.
    fn captured(&self, from: Timestamp, to: Timestamp) -> Option<Sample> {
        let mean = self.rate(from, to, |point| point.captured)?;
        let found = self.between(from, to).fold(Extremes::NOTHING, |found, point| found.with(point.extremes));
        let low = if mean >= COUNTED && found.slowest < mean / 2.0 { found.slowest } else { mean };
        let high = if found.fastest >= COUNTED && found.fastest > mean * 2.0 { found.fastest } else { mean };
        Some(Sample { low, mean, high })
    }

    fn pending(&self, from: Timestamp, to: Timestamp) -> Option<f64> {
        let most = self.between(from, to).map(|point| point.extremes.most_pending).max();
        most.or_else(|| self.before(to).map(|point| point.pending)).map(float)
    }

    fn between(&self, from: Timestamp, to: Timestamp) -> impl Iterator<Item = &Point> {
        let start = self.points.partition_point(|point| point.at <= from);
        self.points.iter().skip(start).take_while(move |point| point.at <= to)
    }

    fn after(&self, from: Timestamp, to: Timestamp) -> Option<(f64, f64)> {
        let from = from.max(self.points.front()?.at);
        Some((self.within(from, to, 50)?, self.within(from, to, 99)?))
    }

    /// The last point at or before a moment.
    fn before(&self, at: Timestamp) -> Option<&Point> {
        let behind = self.points.partition_point(|point| point.at <= at);
        self.points.get(behind.checked_sub(1)?)
    }

    /// Interpolated between two points as if the count had grown evenly.
    fn count(&self, at: Timestamp, of: fn(&Point) -> u64) -> Option<f64> {
        let behind = self.points.partition_point(|point| point.at <= at);
        let before = self.points.get(behind.checked_sub(1)?)?;
        let Some(after) = self.points.get(behind) else { return Some(float(of(before))) };
        let share = float(at.0 - before.at.0) / float(after.at.0 - before.at.0);
        Some(float(of(before)) + share * float(of(after).saturating_sub(of(before))))
    }

    fn rate(&self, from: Timestamp, to: Timestamp, of: fn(&Point) -> u64) -> Option<f64> {
        let seconds = float(to.0 - from.0) / float(SECOND);
        Some((self.count(to, of)? - self.count(from, of)?) / seconds)
    }

    /// Seconds within which `percent` of the records between two moments were verified.
    fn within(&self, from: Timestamp, to: Timestamp, percent: u64) -> Option<f64> {
        let (first, last) = (&self.before(from)?.spread, &self.before(to)?.spread);
        let counted = |end: u64| first.iter().find(|(other, _)| *other == end).map_or(0, |(_, count)| *count);
        let new: Vec<(u64, u64)> =
            last.iter().map(|(end, count)| (*end, count.saturating_sub(counted(*end)))).collect();
        let all: u64 = new.iter().map(|(_, count)| count).sum();
        let rank = (all * percent).div_ceil(100).max(1);
        let mut seen = 0;
        let found = new.iter().find(|(_, count)| {
            seen += count;
            seen >= rank
        });
        found.filter(|_| all > 0).map(|(end, _)| std::time::Duration::from_micros(*end).as_secs_f64())
    }
}

fn part(period: Period, parts: usize) -> u64 {
    period.minutes() * 60 * SECOND / (parts.max(1) as u64)
}

#[expect(clippy::cast_precision_loss, reason = "counts of records and nanoseconds of an hour stay below 2^53")]
fn float(count: u64) -> f64 {
    count as f64
}

/// Shortest time over which a rate is computed, nanoseconds.
const WINDOW: u64 = 2_000_000_000;
/// Silence after which rates are zero, nanoseconds.
const STILL_AFTER: u64 = 6_000_000_000;

/// Stages of a record: captured, stored, anchored, confirmed, verified.
pub const STATIONS: usize = 5;

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Rates {
    base: Option<(Timestamp, [u64; STATIONS])>,
    /// By stage.
    pub stations: [f64; STATIONS],
}

impl Rates {
    pub fn observe(&mut self, life: &LifeLine, now: Timestamp) {
        let counts = [life.captured, life.stored, life.anchored, life.confirmed, life.verified];
        let Some((since, before)) = self.base else {
            self.base = Some((now, counts));
            return;
        };
        let nanoseconds = now.0.saturating_sub(since.0);
        if nanoseconds < WINDOW {
            return;
        }
        self.stations =
            std::array::from_fn(|place| per_second(counts[place].saturating_sub(before[place]), nanoseconds));
        self.base = Some((now, counts));
    }

    pub fn captured(&self) -> f64 {
        self.stations[0]
    }

    pub fn verified(&self) -> f64 {
        self.stations[STATIONS - 1]
    }

    /// When the rates fall to zero without news.
    pub fn still_at(&self) -> Option<Timestamp> {
        let flows = self.stations.iter().any(|rate| *rate > 0.0);
        self.base.filter(|_| flows).map(|(since, ..)| Timestamp(since.0.saturating_add(STILL_AFTER)))
    }

    pub fn settle(&mut self, now: Timestamp) {
        if self.still_at().is_some_and(|at| at <= now) {
            *self = Self::default();
        }
    }
}

fn per_second(count: u64, nanoseconds: u64) -> f64 {
    let count = f64::from(u32::try_from(count).unwrap_or(u32::MAX));
    count / std::time::Duration::from_nanos(nanoseconds).as_secs_f64()
}

/// Nanoseconds; a shorter run says nothing about its pace.
const LEAST: u64 = 2_000_000_000;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Run {
    view: ProgressView,
    /// When its present step was first seen, and the progress then.
    seen: (Timestamp, u64),
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress(Vec<Run>);

impl Progress {
    pub fn set(&mut self, views: Vec<ProgressView>, now: Timestamp) {
        let before = std::mem::take(&mut self.0);
        let same = |view: &ProgressView, run: &&Run| run.view.file == view.file && run.view.step == view.step;
        self.0 = views
            .into_iter()
            .map(|view| {
                let seen = before.iter().find(|run| same(&view, run)).map_or((now, view.done), |run| run.seen);
                Run { view, seen }
            })
            .collect();
    }

    pub fn any(&self) -> bool {
        !self.0.is_empty()
    }

    pub fn lines(&self, now: Timestamp) -> Vec<String> {
        self.0.iter().map(|run| run.line(now)).collect()
    }
}

impl Run {
    fn line(&self, now: Timestamp) -> String {
        let ProgressView { step, file, done, of, messages, unit } = &self.view;
        let share = done.saturating_mul(100).checked_div(*of).map_or_else(String::new, |share| format!(" {share} %"));
        let left = self.left(now).map_or_else(String::new, |seconds| format!(", about {} left", length(seconds)));
        format!("{step} {file}:{share} {messages} {unit}{left}")
    }

    /// Seconds at the pace since the step was first seen.
    fn left(&self, now: Timestamp) -> Option<u64> {
        let took = now.0.saturating_sub(self.seen.0.0);
        let made = self.view.done.checked_sub(self.seen.1).filter(|made| *made > 0 && took >= LEAST)?;
        let rest = self.view.of.checked_sub(self.view.done).filter(|rest| *rest > 0)?;
        let left = u128::from(took) * u128::from(rest) / u128::from(made) / 1_000_000_000;
        u64::try_from(left).ok()
    }
}

/// Coarse, so that it does not change at each look.
fn length(seconds: u64) -> String {
    match seconds {
        0..10 => "10 s".to_owned(),
        10..60 => format!("{} s", seconds.div_ceil(10) * 10),
        60..5_400 => format!("{} min", seconds.div_ceil(60)),
        _ => format!("{} h", seconds.div_ceil(3_600)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::tests::fixtures;
    use crate::service::reply::LifeLine;

    fn site(captured: u64, verified: u64, spread: &[(u64, u64)]) -> SiteView {
        let life = LifeLine { captured, verified, pending: captured - verified, ..LifeLine::default() };
        SiteView { life, verified_after: spread.to_vec(), ..fixtures::site() }
    }

    fn at(seconds: u64) -> Timestamp {
        Timestamp::from_seconds(1_200_000_000 + seconds)
    }

    fn close(values: &[Option<Sample>], wanted: &[Option<f64>]) {
        let near = |(one, other): (&Option<Sample>, &Option<f64>)| match (one, other) {
            (Some(one), Some(other)) => [one.low, one.mean, one.high].iter().all(|one| (one - other).abs() < 1e-6),
            (one, other) => one.is_none() && other.is_none(),
        };
        assert!(values.len() == wanted.len() && values.iter().zip(wanted).all(near), "{values:?}");
    }

    #[test]
    fn a_steady_flow_is_level_a_stop_is_zero_and_what_was_before_the_console_is_unknown() {
        let mut history = History::default();
        for second in 0..=30 {
            history.observe(&site(40 * second, 40 * second, &[]), at(second));
        }
        let flow = history.flow(Period::Minute, 6, at(60));
        let some = |rate| Some(rate);
        close(&flow.captured, &[some(40.0), some(40.0), some(40.0), some(0.0), some(0.0), some(0.0)]);
        assert!(flow.any());
        let earlier = history.flow(Period::Minute, 6, at(30));
        close(&earlier.captured, &[None, None, some(40.0), some(40.0), some(40.0), None]);
        assert!(!history.flow(Period::Minute, 6, at(200)).any(), "the minute is over");
        assert_eq!(history.moves_at(Period::Minute, 6, at(200)), None);
        assert_eq!(history.moves_at(Period::Minute, 6, at(61)), Some(at(70)));
    }

    #[test]
    fn silence_is_no_slow_flow() {
        let mut history = History::default();
        history.observe(&site(0, 0, &[]), at(0));
        history.observe(&site(100, 0, &[]), at(600));
        let flow = history.flow(Period::Quarter, 15, at(900));
        let moved = flow.captured.iter().flatten().filter(|rate| rate.high > 0.0).count();
        assert_eq!(moved, 1, "{:?}", flow.captured);
        close(&flow.pending[flow.pending.len() - 2..], &[Some(100.0), None]);
    }

    #[test]
    fn a_stop_of_two_seconds_is_in_every_period_and_stays_when_points_are_thinned() {
        let periods =
            [(Period::Minute, 60, 300u64, 30), (Period::Quarter, 60, 900, 300), (Period::Hour, 45, 3_000, 2_000)];
        for (period, cells, until, ago) in periods {
            let mut history = History::default();
            let stopped = until - ago;
            for quarter in 1..=4 * until {
                let flowed = quarter - quarter.saturating_sub(4 * stopped).min(8);
                history.observe(&site(11 * flowed, 11 * flowed, &[]), Timestamp(at(0).0 + quarter * SECOND / 4));
            }
            let flow = history.flow(period, 2 * cells, at(until));
            let lowest = flow.captured.iter().flatten().map(|sample| sample.low).fold(f64::INFINITY, f64::min);
            let stopped = flow.captured.iter().flatten().filter(|sample| sample.low < 22.0).count();
            assert!(lowest < 4.5 && (1..=8).contains(&stopped), "{period:?}: {lowest}, {:?}", flow.captured);
            let verified = flow.verified.iter().flatten().all(|sample| sample.low.to_bits() == sample.high.to_bits());
            assert!(verified, "means");
        }
    }

    #[test]
    fn until_the_window_moves_a_new_part_changes_nothing_but_itself() {
        let mut history = History::default();
        for second in 0..600 {
            history.observe(&site(second * second, 0, &[]), at(second));
        }
        let (mut moves, mut before) = (0, history.flow(Period::Quarter, 120, at(600)));
        for second in 601..=660 {
            let flow = history.flow(Period::Quarter, 120, at(second));
            let changed = flow.captured.iter().zip(&before.captured).filter(|(one, other)| one != other).count();
            moves += usize::from(changed > 1);
            before = flow;
        }
        assert_eq!(moves, 1, "in a minute");
    }

    #[test]
    fn the_window_moves_in_whole_cells_and_holds_what_is_over() {
        for (parts, step) in [(16, 2), (60, 4), (90, 6), (120, 8), (180, 12)] {
            for over in 1_000..1_100 {
                let shown = window(over, parts);
                assert_eq!((shown.end - shown.start, shown.end % step), (parts as u64, 0));
                assert!((over..over + step).contains(&shown.end), "{over} {shown:?}");
            }
        }
        assert_eq!([300, 120, 111, 102, 60, 59].map(cells), [90, 90, 90, 90, 60, 45]);
    }

    #[test]
    fn percentiles_are_of_the_period_alone() {
        let mut history = History::default();
        history.observe(&site(1_000, 1_000, &[(4_000_000, 1_000)]), at(0));
        history.observe(&site(1_100, 1_100, &[(500_000, 98), (2_000_000, 2), (4_000_000, 1_000)]), at(20));
        let flow = history.flow(Period::Minute, 6, at(60));
        assert_eq!(flow.after, Some((0.5, 2.0)));
        assert_eq!(highest(&flow.slowest).to_bits(), 2.0f64.to_bits());
    }

    #[test]
    fn an_hour_of_news_is_few_points_and_keeps_its_sums() {
        let mut history = History::default();
        for quarter in 0..4 * 3_600u64 {
            let now = Timestamp(at(0).0 + quarter * SECOND / 4);
            history.observe(&site(10 * quarter, 10 * quarter, &[]), now);
        }
        assert!(history.points.len() < 1_600, "{}", history.points.len());
        let flow = history.flow(Period::Hour, 60, at(3_600));
        let known: Vec<f64> = flow.captured.iter().flatten().map(|rate| rate.mean).collect();
        assert!(known.len() >= 58 && known.iter().take(58).all(|rate| (rate - 40.0).abs() < 0.5), "{known:?}");
    }
}

#[cfg(test)]
mod rates_tests {
    use super::*;

    #[test]
    fn a_rate_shows_after_two_seconds_and_goes_when_nothing_comes() {
        let life = |captured| LifeLine { captured, ..LifeLine::default() };
        let mut rates = Rates::default();
        rates.observe(&life(100), Timestamp(0));
        rates.observe(&life(140), Timestamp::from_seconds(1));
        assert_eq!(rates.still_at(), None);
        rates.observe(&life(180), Timestamp::from_seconds(2));
        assert!((rates.captured() - 40.0).abs() < 1e-9);
        assert_eq!(rates.still_at(), Some(Timestamp::from_seconds(8)));
        rates.settle(Timestamp::from_seconds(8));
        assert_eq!(rates, Rates::default());
    }
}

#[cfg(test)]
mod progress_tests {
    use super::*;

    fn view(step: &str, done: u64) -> ProgressView {
        let (step, file, unit) = (step.to_owned(), "mission.bag".to_owned(), "messages".to_owned());
        ProgressView { step, file, done, of: 1_000, messages: done / 10, unit }
    }

    #[test]
    fn the_time_left_is_by_the_pace_of_the_present_step() {
        let at = Timestamp::from_seconds;
        let mut progress = Progress::default();
        progress.set(vec![view("hashing", 900)], at(0));
        progress.set(vec![view("importing", 100)], at(10));
        assert_eq!(progress.lines(at(10)), ["importing mission.bag: 10 % 10 messages"]);
        progress.set(vec![view("importing", 200)], at(30));
        assert_eq!(progress.lines(at(30)), ["importing mission.bag: 20 % 20 messages, about 3 min left"]);
        progress.set(vec![view("importing", 990)], at(188));
        assert_eq!(progress.lines(at(188)), ["importing mission.bag: 99 % 99 messages, about 10 s left"]);
        progress.set(Vec::new(), at(190));
        assert!(!progress.any());
    }

    #[test]
    fn records_are_counted_as_such() {
        let at = Timestamp::from_seconds;
        let told = |step: &str, file: &str, unit: &str, done, messages| ProgressView {
            file: file.to_owned(),
            unit: unit.to_owned(),
            messages,
            ..view(step, done)
        };
        let mut progress = Progress::default();
        progress.set(vec![told("auditing", "this home", "records", 0, 0)], at(0));
        progress.set(vec![told("auditing", "this home", "records", 250, 250)], at(10));
        assert_eq!(progress.lines(at(10)), ["auditing this home: 25 % 250 records, about 30 s left"]);
    }

    #[test]
    fn of_what_has_no_end_only_the_count_is_told() {
        let mut progress = Progress::default();
        progress.set(vec![ProgressView { of: 0, ..view("exporting", 5) }], Timestamp(0));
        assert_eq!(progress.lines(Timestamp(0)), ["exporting mission.bag: 0 messages"]);
    }
}
