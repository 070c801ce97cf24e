//! What drawing a full screen of the console costs with 2,000 topics, over what it costs with 50:
//! `cargo bench -p authros-bench --bench draw`. Only what is visible may cost anything, so the ratio stays near one.

#![allow(clippy::expect_used, clippy::print_stdout, reason = "a measurement prints, and stops where it cannot go on")]

use std::time::Instant;

use authros_console::app::update::update;
use authros_console::app::{Action, Screen, Settings, State, Verb};
use authros_console::ui::Theme;
use authros_console::ui::draw::draw;
use authros_service::reply::TopicRow;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

const SIZE: (u16, u16) = (200, 50);
const FEW: usize = 50;
const MANY: usize = 2_000;
const ROUNDS: usize = 200;
/// The most that the ratio may be.
const MOST: f64 = 1.5;

fn main() {
    let [mut few, mut many] = [FEW, MANY].map(console);
    let theme = Theme::named("night").expect("embedded");
    let (mut least_few, mut least_many) = (f64::INFINITY, f64::INFINITY);
    // In turns, so that what else the machine does falls on both.
    for _ in 0..ROUNDS {
        least_few = least_few.min(milliseconds(&mut few, &theme));
        least_many = least_many.min(milliseconds(&mut many, &theme));
    }
    let ratio = least_many / least_few;
    println!(
        "a frame of 200x50: {least_few:.3} ms with {FEW} topics, {least_many:.3} ms with {MANY}: {ratio:.2} times"
    );
    assert!(ratio <= MOST, "more than {MOST} times");
}

fn milliseconds(state: &mut State, theme: &Theme) -> f64 {
    let mut terminal = Terminal::new(TestBackend::new(SIZE.0, SIZE.1)).expect("a terminal");
    let begun = Instant::now();
    terminal.draw(|frame| drop(draw(frame, state, theme))).expect("drawn");
    begun.elapsed().as_secs_f64() * 1e3
}

fn console(topics: usize) -> State {
    let mut state = State::new(Settings::default());
    drop(update(&mut state, Action::Resize { columns: SIZE.0, rows: SIZE.1 }));
    drop(update(&mut state, Action::Do(Verb::Go(Screen::Topics))));
    let now = state.now;
    state.topics.set((0..topics).map(row).collect(), now);
    state
}

fn row(number: usize) -> TopicRow {
    serde_json::from_value(serde_json::json!({
        "topic": format!("/robot{number}/camera/compressed"), "type": "sensor_msgs/CompressedImage",
        "publishers": ["/driver"], "watched": number.is_multiple_of(2), "simulated": true, "hz": 20.5,
        "bytes_per_second": 116_000.0, "messages": 12, "lost_in_transport": 3, "lost_in_recorder": 0,
        "last_message": "2026-01-01T00:00:00Z",
    }))
    .expect("a row")
}
