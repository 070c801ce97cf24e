//! What the console costs on a terminal, compared with htop and btop in the same harness: `cargo bench --bench
//! console`. bottom's figures are those in the specification. Run it on an idle machine.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    missing_docs,
    reason = "a benchmark prints, and stops where it cannot go on"
)]

#[path = "../tests/support/mod.rs"]
mod support;

use std::time::{Duration, Instant};

use authros::app::{Action, Settings, State, Verb, update};
use authros::service::reply::TopicRow;
use authros::term::colour::Depth;
use authros::term::renderer::Painter;
use authros::term::stage::{Scene, Wish};
use authros::ui::Theme;
use support::figures::{self, Subject};
use support::{Console, Home, Terminal};

/// Bytes a second of the slow link.
const SLOW: u32 = 4_000;

struct Row {
    figure: &'static str,
    must: &'static str,
    bottom: &'static str,
    ours: String,
    others: Vec<String>,
}

fn main() {
    // `cargo test` builds and runs benches too; there this one does nothing.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let others: Vec<Subject> = ["htop", "btop"].into_iter().filter_map(Subject::installed).collect();
    let mut rows = Vec::new();
    first_frames(&mut rows, &others);
    idle(&mut rows, &others);
    keys(&mut rows, &others);
    slow_link(&mut rows);
    drawing(&mut rows);
    ends(&mut rows, &others);
    print(&rows, &others);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn first_frames(rows: &mut Vec<Row>, others: &[Subject]) {
    let measure = |subject: &Subject| {
        let frames: Vec<_> = (0..5).map(|_| figures::first_frame(subject)).collect();
        let bytes = frames.iter().map(|frame| frame.bytes).max().unwrap_or(0);
        (median(frames.iter().map(|frame| frame.milliseconds).collect()), bytes)
    };
    let ours = measure(&Subject::authros(4, &[]));
    let theirs: Vec<_> = others.iter().map(measure).collect();
    let milliseconds = |(time, _): &(f64, u64)| format!("{time:.0} ms");
    let bytes = |(_, bytes): &(f64, u64)| format!("{bytes} B");
    rows.push(Row {
        figure: "first frame, 80x24",
        must: "< 100 ms",
        bottom: "69 ms",
        ours: milliseconds(&ours),
        others: theirs.iter().map(milliseconds).collect(),
    });
    rows.push(Row {
        figure: "first frame, bytes",
        must: "<= 6000 B",
        bottom: "-",
        ours: bytes(&ours),
        others: theirs.iter().map(bytes).collect(),
    });
}

fn idle(rows: &mut Vec<Row>, others: &[Subject]) {
    for (figure, processor, bottom, terminal) in [
        ("idle, 80x24", "idle CPU, 80x24", "334 B/s", Terminal::of(80, 24)),
        ("idle, 200x50", "idle CPU, 200x50", "1806 B/s", Terminal::of(200, 50)),
    ] {
        let measure =
            |subject: &Subject| figures::idle(subject, &terminal, Duration::from_secs(8), Duration::from_secs(20));
        let ours = measure(&Subject::authros(0, &[]));
        let theirs: Vec<_> = others.iter().map(measure).collect();
        let bytes = |idle: &figures::Idle| format!("{:.0} B/s", idle.bytes);
        let cpu = |idle: &figures::Idle| format!("{:.2} %", idle.cpu);
        rows.push(Row {
            figure,
            must: "0 B/s",
            bottom,
            ours: bytes(&ours),
            others: theirs.iter().map(bytes).collect(),
        });
        let others = theirs.iter().map(cpu).collect();
        rows.push(Row { figure: processor, must: "< 0.2 %", bottom: "-", ours: cpu(&ours), others });
    }
}

fn keys(rows: &mut Vec<Row>, others: &[Subject]) {
    let ours = figures::bytes_per_key(&Subject::authros(4, &[]), &["2", "f"], &["j", "k"], 40);
    // Down and up, as their tables accept them; their own redraws in between count, because users see them too.
    let theirs = others.iter().map(|subject| figures::bytes_per_key(subject, &[], &["\u{1b}[B", "\u{1b}[A"], 20));
    rows.push(Row {
        figure: "bytes per cursor key",
        must: "<= 200 B",
        bottom: "145 B",
        ours: format!("{ours:.0} B"),
        others: theirs.map(|bytes| format!("{bytes:.0} B")).collect(),
    });
}

/// Twenty messages a second are captured while keys are pressed over a link of 4 kB/s.
fn slow_link(rows: &mut Vec<Row>) {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    let authros = authros.with_variable("SSH_CONNECTION", "192.0.2.1 50000 192.0.2.2 22");
    let terminal = Terminal { bytes_per_second: Some(SLOW), ..Terminal::of(80, 24) };
    let mut console = Console::open_in(&terminal, &authros, &[]);
    console.wait_for("/robot1/odom", 60);
    authros.run(&["topics", "watch", "/robot1/odom"]).expect_code(0);
    let keys = [
        ("2", "Watched"),
        ("3", "Uploads  "),
        ("1", "captured"),
        ("2", "Watched"),
        ("3", "Uploads  "),
        ("1", "captured"),
    ];
    let mut seconds = figures::key_to_frame(&mut console, &keys);
    seconds.extend(figures::key_to_frame(&mut console, &keys));
    let worst = seconds.iter().copied().fold(0.0, f64::max);
    rows.push(Row {
        figure: "key to frame, 4 kB/s, 20 msg/s",
        must: "< 0.8 s",
        bottom: "1.6-3.2 s",
        ours: format!("{:.2} s, worst {worst:.2}", median(seconds)),
        others: Vec::new(),
    });
}

fn drawing(rows: &mut Vec<Row>) {
    let mut state = State::new(Settings::default());
    let row = |index: usize| -> TopicRow {
        serde_json::from_value(serde_json::json!({
            "topic": format!("/robot{index}/camera/compressed"), "type": "sensor_msgs/CompressedImage",
            "publishers": ["/driver"], "watched": index.is_multiple_of(2), "simulated": true, "hz": 20.5,
            "bytes_per_second": 116_000.0, "messages": 12, "lost_in_transport": 3, "lost_in_recorder": 0,
            "last_message": "2026-01-01T00:00:00Z",
        }))
        .expect("a row")
    };
    drop(update(&mut state, Action::Resize { columns: 200, rows: 50 }));
    drop(update(&mut state, Action::Do(Verb::Go(authros::app::Screen::Topics))));
    let now = state.now;
    state.topics.set((0..2_000).map(row).collect(), now);
    let theme = Theme::named("night").expect("embedded");
    let mut scene =
        Scene { state, theme, wish: Wish::Now, anew: true, extra: String::new(), suspended: false, over: false };
    let mut painter = Painter::new(Depth::True, (200, 50));
    let mut times = Vec::new();
    for _ in 0..200 {
        scene.anew = true;
        let begin = Instant::now();
        assert!(painter.paint(&mut scene).len() > 2_000, "a full screen");
        times.push(begin.elapsed().as_secs_f64() * 1000.0);
    }
    let ours = format!("{:.2} ms", median(times));
    rows.push(Row {
        figure: "draw of a full 200x50, 2,000 topics",
        must: "< 2 ms",
        bottom: "-",
        ours,
        others: Vec::new(),
    });
}

fn ends(rows: &mut Vec<Row>, others: &[Subject]) {
    let words = |lost: &figures::Lost| match (lost.ended_after, lost.code) {
        (Some(after), Some(code)) => format!("exit {code} after {after:.1} s"),
        (Some(after), None) => format!("gone after {after:.1} s"),
        (None, _) => format!("stays, {:.0} % CPU", lost.cpu),
    };
    for (figure, hung_up) in [("tty lost, with SIGHUP", true), ("tty lost, without SIGHUP", false)] {
        let measure = |subject: &Subject| {
            let directory = Home::new();
            words(&figures::lost(subject, directory.root(), hung_up))
        };
        let ours = measure(&Subject::authros(1, &[]));
        let others = others.iter().map(measure).collect();
        rows.push(Row { figure, must: "ends within 2 s", bottom: "stays, 37-83 %", ours, others });
    }
    for (figure, name, bottom) in [("SIGTERM", "TERM", "restored"), ("SIGQUIT", "QUIT", "left raw")] {
        let words =
            |subject: &Subject| if figures::restores(subject, name) { "restored" } else { "left raw" }.to_owned();
        let ours = words(&Subject::authros(1, &[]));
        let others = others.iter().map(words).collect();
        rows.push(Row { figure, must: "restored", bottom, ours, others });
    }
}

fn print(rows: &[Row], others: &[Subject]) {
    let names: Vec<&str> = others.iter().map(|subject| subject.name).collect();
    let head: Vec<String> = ["figure", "must", "authros"]
        .iter()
        .chain(&names)
        .chain(&["bottom (listed)"])
        .map(|&word| word.to_owned())
        .collect();
    let cell = |row: &Row, index: usize| row.others.get(index).cloned().unwrap_or_else(|| "-".to_owned());
    let mut lines = vec![head];
    for row in rows {
        let mut line = vec![row.figure.to_owned(), row.must.to_owned(), row.ours.clone()];
        line.extend((0..others.len()).map(|index| cell(row, index)));
        line.push(row.bottom.to_owned());
        lines.push(line);
    }
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    for line in &lines {
        let cells: Vec<String> =
            line.iter().enumerate().map(|(column, cell)| format!("{cell:0$}", width(column))).collect();
        println!("{}", cells.join("  ").trim_end());
    }
}
