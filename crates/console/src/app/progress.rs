//! Progress of imports, exports, audits and back-ups, and the time left at the pace so far.

use crate::model::Timestamp;
use crate::service::reply::ProgressView;

/// A shorter run says nothing about its pace, nanoseconds.
const LEAST: u64 = 2_000_000_000;

/// One piece of work.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Run {
    view: ProgressView,
    /// When its present step was first seen, and its progress then.
    seen: (Timestamp, u64),
}

/// All current runs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress(Vec<Run>);

impl Progress {
    /// Takes over their present progress.
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

    /// Whether anything runs.
    pub fn any(&self) -> bool {
        !self.0.is_empty()
    }

    /// A line for each.
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

    /// Seconds at the pace since its step was first seen.
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
