//! The graphs of the Overview: captured and verified on one scale, what is pending, how long records take.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, right_of, row};
use super::theme::Role;
use super::{graph, words};
use crate::app::State;
use crate::app::history::{Flow, highest};
use crate::app::state::GRAPH_PARTS;

/// Columns of the names of the graphs.
const NAMES: u16 = 10;
/// Terminal size from which the graphs are high, two side by side.
const HIGH_FROM: (u16, u16) = (110, 26);
/// Rows of a high graph.
const HIGH: u16 = 5;
/// Rows that the busiest topics keep.
const KEPT: u16 = 5;
/// Graphs, and their heading.
const ROWS: u16 = 5;

/// One graph.
struct Panel {
    name: &'static str,
    text: String,
    values: Vec<Option<f64>>,
    scale: f64,
    role: Role,
}

/// Draws as much as fits; returns what is left of `area`.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) -> Rect {
    if state.site.is_none() || area.height < ROWS + KEPT {
        return area;
    }
    let flow = state.history.flow(state.period, GRAPH_PARTS, state.shown_at());
    if !flow.any() {
        return area;
    }
    let minutes = |period: crate::app::history::Period| format!("{} min", period.minutes());
    let heading = format!("Last {}", minutes(state.period));
    let hint = format!("  m: {}", minutes(state.period.next()));
    canvas.puts(row(area, 0), &[(&heading, Role::Title), (&hint, Role::Dim)]);
    let panels = panels(state, flow);
    let rest = below(area, 1);
    if area.width >= HIGH_FROM.0 && area.height >= HIGH_FROM.1 {
        high(canvas, rest, &panels)
    } else {
        low(canvas, rest, &panels)
    }
}

fn panels(state: &State, flow: Flow) -> [Panel; 4] {
    let scale = highest(&flow.captured).max(highest(&flow.verified));
    let rate = |now: f64, values: &[Option<f64>]| format!("{now:.1}/s, peak {:.1}", highest(values).max(now));
    let after = flow.after.map_or_else(
        || "none verified".to_owned(),
        |(half, most)| format!("p50 {}, p99 {}", words::seconds(half), words::seconds(most)),
    );
    let pending = state.pending_records();
    let most = highest(&flow.pending).max(f64::from(u32::try_from(pending).unwrap_or(u32::MAX)));
    [
        Panel {
            name: "captured",
            text: rate(state.rates.captured(), &flow.captured),
            values: flow.captured,
            scale,
            role: Role::Accent,
        },
        Panel {
            name: "verified",
            text: rate(state.rates.verified(), &flow.verified),
            values: flow.verified,
            scale,
            role: Role::Good,
        },
        Panel {
            name: "pending",
            text: format!("{}, peak {most:.0}", words::count(pending)),
            scale: highest(&flow.pending),
            values: flow.pending,
            role: Role::Warning,
        },
        Panel { name: "latency", text: after, scale: highest(&flow.slowest), values: flow.slowest, role: Role::Body },
    ]
}

/// A row each: name, bars, figures.
fn low(canvas: &mut Canvas, area: Rect, panels: &[Panel]) -> Rect {
    let bars = u16::try_from(GRAPH_PARTS).unwrap_or(u16::MAX).min(area.width.saturating_sub(NAMES + 24));
    for (line, panel) in (0u16..).zip(panels) {
        let place = row(area, line);
        canvas.put(place, panel.name, Role::Dim);
        let place = right_of(place, NAMES);
        graph::draw(canvas, Rect { width: bars, ..place }, &panel.values, panel.scale, panel.role);
        canvas.put(right_of(place, bars + 1), &panel.text, Role::Body);
    }
    below(area, ROWS - 1)
}

/// Two side by side, with their figures above.
fn high(canvas: &mut Canvas, area: Rect, panels: &[Panel]) -> Rect {
    let width = area.width / 2;
    for (place, panel) in (0u16..).zip(panels) {
        let here = below(right_of(area, place % 2 * width), place / 2 * (HIGH + 2));
        let here = Rect { width: width - 2, ..here };
        canvas.puts(row(here, 0), &[(panel.name, Role::Title), ("  ", Role::Body), (&panel.text, Role::Body)]);
        let bars = Rect { height: HIGH.min(here.height.saturating_sub(1)), ..below(here, 1) };
        graph::draw(canvas, bars, &panel.values, panel.scale, panel.role);
    }
    below(area, 2 * (HIGH + 2))
}
