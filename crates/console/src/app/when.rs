//! Times: those of forms as typed, and what they mean; countdowns of parts.

use crate::app::{Form, Input, State};
use crate::model::{Clock, Direction, Timestamp};
use crate::service::reply::PartHealth;

/// Empty text = no end.
pub fn expiry(text: &str, clock: &Clock) -> Result<Option<Timestamp>, String> {
    let text = text.trim();
    if text.is_empty() || text == "never" {
        return Ok(None);
    }
    clock.end(text).map(Some).map_err(|error| error.to_string())
}

/// What the line under the cursor means now, if it is a time.
pub fn meaning(form: &Form, clock: &Clock) -> Option<String> {
    let line = form.lines.get(form.focus)?;
    let (direction, Input::Text(field)) = (line.time?, &line.input) else { return None };
    let text = field.text().trim();
    // While it is typed, it is not yet one.
    let moment = match direction {
        Direction::Back => clock.back(text).ok()?,
        Direction::Ahead => expiry(text, clock).ok()??,
    };
    Some(format!("= {}", clock.meaning(moment)))
}

const SECOND: u64 = 1_000_000_000;
const BEGINS: &str = "retry in ";

/// `None` = no countdown on screen.
pub fn moves_at(state: &State) -> Option<Timestamp> {
    let parts = state.site.iter().flat_map(|site| &site.health);
    let gone = gone(state);
    let goes_on = parts.filter_map(|part| part.retry).any(|seconds| seconds > gone + 1);
    (goes_on && !state.is_frozen()).then(|| Timestamp(state.site_at.0.saturating_add((gone + 1) * SECOND)))
}

/// The last second stays until the site reports the attempt.
pub fn tick(state: &mut State) {
    let gone = gone(state);
    if state.is_frozen() {
        return;
    }
    for part in state.site.iter_mut().flat_map(|site| &mut site.health) {
        if let Some(text) = said(part, gone) {
            part.text = text;
        }
    }
}

fn said(part: &PartHealth, gone: u64) -> Option<String> {
    let (seconds, after) = (part.retry?, part.text.strip_prefix(BEGINS)?.split_once(' ')?.1);
    Some(format!("{BEGINS}{} {after}", seconds.saturating_sub(gone).max(1)))
}

/// Whole seconds since the site's answer.
fn gone(state: &State) -> u64 {
    state.now.0.saturating_sub(state.site_at.0) / SECOND
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::form::{Field, Line};

    #[test]
    fn an_end_may_be_absent_and_is_never_past() {
        let clock = Clock { now: Timestamp(1_700_000_000_039_050_923), ..Clock::default() };
        assert_eq!((expiry("", &clock), expiry(" never ", &clock)), (Ok(None), Ok(None)));
        assert_eq!(expiry(" 30d ", &clock), Ok(Some(Timestamp::from_seconds(1_700_000_001 + 30 * 86_400))));
        assert_eq!(expiry("2023-11-16", &clock), Ok(Some(Timestamp::from_seconds(1_700_092_800))));
        // date -u -d '2023-11-15T18:00Z' +%s
        assert_eq!(expiry("tomorrow 18:00", &clock), Ok(Some(Timestamp::from_seconds(1_700_071_200))));
        for bad in ["2020-01-01", "d", "0d", "-1d", "12", "99999999999999999999d", "é", "soon"] {
            assert!(expiry(bad, &clock).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_a_time_means_stands_under_its_line_alone() {
        let clock = Clock { now: Timestamp::from_seconds(1_700_000_000), ..Clock::default() };
        let form = |text: &str| {
            let line = Line::text("Ends", "", Field::with(text)).time(Direction::Ahead);
            Form::new("", Vec::new(), vec![line, Line::text("Note", "", Field::with("18:00"))])
        };
        let meant = |text: &str| meaning(&form(text), &clock);
        assert_eq!(meant("tomorrow 18:00").as_deref(), Some("= 2023-11-15 18:00:00 UTC"));
        assert_eq!([meant(""), meant("tomor"), meant("yesterday")], [None, None, None]);
        let mut other = form("18:00");
        other.focus = 1;
        assert_eq!(meaning(&other, &clock), None);
    }
}
