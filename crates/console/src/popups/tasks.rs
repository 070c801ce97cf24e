//! What runs, and what waits.

use strum::IntoEnumIterator as _;

use crate::app::{Feed, State, Tag};
use crate::model::counted;
use crate::service::reply::{TaskState, TaskView};
use crate::ui::{Canvas, Piece, Rect, Role, draw_lines, words};

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let mut lines: Vec<Piece> = state.work.iter().map(Tag::words).map(|words| (words, Role::Accent)).collect();
    lines.extend(state.progress.lines(state.shown_at()).into_iter().map(|line| (line, Role::Accent)));
    if lines.is_empty() {
        lines.push(("no commands running".to_owned(), Role::Dim));
    }
    lines.extend(records_on_their_way(state));
    lines.extend(workers(state));
    if let Some(chain) = &state.chain {
        let pending = format!("{:<15} {} pending", "transactions", chain.pending);
        lines.push((pending, if chain.pending > 0 { Role::Warning } else { Role::Body }));
        let causes = chain.lanes.iter().filter_map(|lane| Some(lane.paused.as_ref()?.cause(lane.account)));
        lines.extend(causes.map(|cause| (format!("paused  {cause}"), Role::Bad)));
    }
    for feed in Feed::iter() {
        let slot = state.feeds.slot(feed);
        if let (Some(failure), Some(at)) = (&slot.failure, slot.retry_at) {
            let seconds = at.0.saturating_sub(state.now.0) / 1_000_000_000;
            lines.push((format!("retry in {seconds} s  {feed:?}: {}", failure.message), Role::Warning));
        }
    }
    draw_lines(canvas, area, "Tasks", &lines, 0);
}

/// How many run, and each that stopped or restarted.
fn workers(state: &State) -> Vec<Piece> {
    let tasks: &[TaskView] = state.site.as_ref().map_or(&[], |site| &site.tasks);
    let running = tasks.iter().filter(|task| task.state == TaskState::Running).count();
    let mut lines = Vec::new();
    if !tasks.is_empty() {
        lines.push((format!("{:<15} {running} of {} running", "workers", tasks.len()), Role::Body));
    }
    for task in tasks.iter().filter(|task| task.state != TaskState::Running || task.restarts > 0) {
        let next = task.next_try.map_or_else(String::new, |seconds| format!(", retry in {seconds} s"));
        let why = task.reason.as_deref().map_or_else(String::new, |reason| format!(": {reason}"));
        let text = format!("{:<15} restarted {}{next}{why}", task.name, words::times(task.restarts));
        lines.push((text, if task.state == TaskState::Running { Role::Warning } else { Role::Bad }));
    }
    lines
}

fn records_on_their_way(state: &State) -> Vec<Piece> {
    let Some(site) = &state.site else { return vec![("the site is starting…".to_owned(), Role::Dim)] };
    let life = &site.life;
    let queue = &site.queue;
    let full = queue.bytes.saturating_mul(100).checked_div(queue.capacity).unwrap_or(0);
    let (messages, bytes) = (counted(queue.messages, "message"), words::size(queue.bytes));
    let stored = format!("{:<15} {messages}, {bytes} (buffer {full} % full)", "to be stored");
    let mut lines = vec![(stored, if full >= 80 { Role::Bad } else { Role::Body })];
    let stations = [
        ("to be anchored", life.stored.saturating_sub(life.anchored)),
        ("to be confirmed", life.anchored.saturating_sub(life.confirmed)),
        ("to be verified", life.confirmed.saturating_sub(life.verified + life.tampered)),
    ];
    lines.extend(stations.into_iter().map(|(what, count)| (format!("{what:<15} {}", words::count(count)), Role::Body)));
    lines.push((left(life.pending, state.rates.captured(), state.rates.verified()), Role::Accent));
    lines
}

/// At the present rates.
fn left(pending: u64, captured: f64, verified: f64) -> String {
    if pending == 0 {
        return "all captured records are verified, quarantined or accounted for".to_owned();
    }
    let count = words::count(pending);
    if verified < 0.1 {
        return format!("{count} pending; nothing is being verified now");
    }
    let records = f64::from(u32::try_from(pending).unwrap_or(u32::MAX));
    let net = verified - captured;
    if captured > 0.1 && net <= 0.1 {
        let behind = records / verified;
        return format!("{count} pending, about {behind:.0} s behind; keeping up");
    }
    format!("{count} pending, done in about {:.0} s", records / net.max(0.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_told_as_far_as_it_can_be() {
        assert!(left(0, 0.0, 0.0).starts_with("all"));
        assert!(left(45, 20.0, 0.0).contains("nothing is being verified"));
        assert!(left(45, 20.0, 20.0).contains("about 2 s behind"));
        assert!(left(45, 0.0, 15.0).contains("done in about 3 s"));
    }
}
