//! Frames of the console and what precedes them: keys, rows, filters. Nothing is written to a terminal.

use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::fill::{OWNER, name, record};
use super::{Figures, timed};
use authros_console::app::{Action, Key, Screen, Settings, State, Verb, update};
use authros_console::ui::{Theme, draw};
use authros_model::Timestamp;
use authros_pipeline::columns::Shown;
use authros_service::failure::internal;
use authros_service::reply::TopicRow;
use authros_service::{Failure, Reply, UploadQuery, record_page};
use authros_store::{Ledger, RecordQuery};

/// Columns and rows.
const SIZE: (u16, u16) = (200, 50);
/// Topics in the graph, most of them not recorded.
const TOPICS: u64 = 2_000;
const NOW: Timestamp = Timestamp(1_800_000_000_000_000_000);

/// Each work, and microseconds of its rounds.
pub(super) fn time(ledger: &Ledger) -> Result<Figures, Failure> {
    let theme = Theme::named("night").map_err(|error| internal(error.to_string()))?;
    let mut figures = Vec::new();
    for (name, screen) in
        [("frame, overview", Screen::Overview), ("frame, topics", Screen::Topics), ("frame, uploads", Screen::Uploads)]
    {
        let mut state = console(ledger, screen)?;
        figures.push((name, frames(&state, &theme)?));
        if screen == Screen::Topics {
            figures.extend(keys(&mut state, &theme)?);
        }
    }
    let answer = Reply::Topics(topics()?);
    let encode = || serde_json::to_vec(&answer).map(drop).map_err(|error| internal(error.to_string()));
    figures.push(("encode", timed(encode)?));
    Ok(figures)
}

fn frames(state: &State, theme: &Theme) -> Result<Vec<f64>, Failure> {
    let wrong = |error: &dyn std::fmt::Display| internal(error.to_string());
    let mut terminal = Terminal::new(TestBackend::new(SIZE.0, SIZE.1)).map_err(|error| wrong(&error))?;
    timed(|| terminal.draw(|frame| drop(draw(frame, state, theme))).map(drop).map_err(|error| wrong(&error)))
}

fn keys(state: &mut State, theme: &Theme) -> Result<Figures, Failure> {
    let press = |state: &mut State, key| drop(update(state, Action::Key(key)));
    let key = timed(|| {
        press(state, Key::Down);
        Ok(())
    })?;
    let rows = topics()?;
    let rows_in = timed(|| {
        state.topics.set(rows.clone(), state.now);
        Ok(())
    })?;
    let mut figures = vec![("key", key), ("rows in", rows_in)];
    for key in ['/', 'r', '7', '7'] {
        press(state, Key::Char(key));
    }
    let filter = timed(|| {
        press(state, Key::Char('x'));
        press(state, Key::Backspace);
        Ok(())
    });
    figures.push(("filter", filter?));
    figures.push(("frame, filtered", frames(state, theme)?));
    Ok(figures)
}

/// A console on a screen, with the page returned by the ledger.
fn console(ledger: &Ledger, screen: Screen) -> Result<State, Failure> {
    let mut state = State::new(Settings::default());
    update(&mut state, Action::Tick(NOW));
    update(&mut state, Action::Resize { columns: SIZE.0, rows: SIZE.1 });
    update(&mut state, Action::Do(Verb::Go(screen)));
    state.topics.set(topics()?, NOW);
    let query = UploadQuery { limit: state.page_rows(), newest_first: true, ..UploadQuery::default() };
    let page = RecordQuery { owner: Some(OWNER), newest_first: true, limit: query.limit, ..RecordQuery::default() };
    let page = ledger.list(&page)?;
    let rows: Vec<Shown> = page.rows.into_iter().map(Shown::unread).collect();
    state.uploads.set(record_page(&rows, page.next, false), query.limit);
    Ok(state)
}

fn topics() -> Result<Vec<TopicRow>, Failure> {
    let row = |number| {
        let record = record(number);
        let json = serde_json::json!({
            "topic": name(number), "type": record.type_name, "publishers": ["/driver"], "watched": true,
            "simulated": true, "hz": 20.0, "bytes_per_second": 14_400.0, "messages": 500, "lost_in_transport": 0,
            "lost_in_recorder": 0, "last_message": null,
        });
        serde_json::from_value(json).map_err(|error| internal(error.to_string()))
    };
    (0..TOPICS).map(row).collect()
}
