//! Graphs in block characters: a column for each part of time. A part in which nothing came is a dot on the ground, so
//! that a stop is visible without colour; unknown parts are empty.

use ratatui::layout::Rect;

use super::canvas::{Canvas, row};
use super::theme::Role;

/// Bars in eighths of a cell.
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// One row of bars against a given scale, so that adjacent rows can be compared.
pub fn sparkline(samples: &[f64], scale: f64) -> String {
    samples.iter().map(|sample| bar(Some(*sample), scale, 0, 1)).collect()
}

/// Fills `area` with bars against `scale`, the newest value at its right edge.
pub fn draw(canvas: &mut Canvas, area: Rect, values: &[Option<f64>], scale: f64, role: Role) {
    let shown = values.get(values.len().saturating_sub(usize::from(area.width))..).unwrap_or(values);
    for level in 0..area.height {
        let line: String = shown.iter().map(|value| bar(*value, scale, level, area.height)).collect();
        canvas.put(row(area, area.height - 1 - level), &line, role);
    }
}

/// The character of a value in a row of a graph, `level` rows above its ground.
fn bar(value: Option<f64>, scale: f64, level: u16, rows: u16) -> char {
    let Some(value) = value.filter(|value| value.is_finite()) else { return ' ' };
    if value <= 0.0 || scale <= 0.0 {
        return if level == 0 { '.' } else { ' ' };
    }
    let eighths = (value / scale).min(1.0) * f64::from(rows) * 8.0;
    // Any value above zero has at least an eighth.
    let eighths = eighths.max(1.0) - f64::from(level) * 8.0;
    let filled = (1u8..=8).take_while(|eighth| eighths + 0.5 > f64::from(*eighth)).count();
    filled.checked_sub(1).and_then(|place| BARS.get(place)).copied().unwrap_or(' ')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ui::Theme;
    use ratatui::buffer::Buffer;

    #[test]
    fn bars_are_compared_on_one_scale_and_a_stop_is_a_dot() {
        assert_eq!(sparkline(&[0.0, 14.0, 58.0, 116.0], 116.0), ".▁▄█");
        assert_eq!(sparkline(&[14.0, 14.0, 0.0], 116.0), "▁▁.");
        assert_eq!(sparkline(&[0.0, 0.0], 0.0), "..");
        assert_eq!(sparkline(&[0.001], 1e9), "▁", "little is not nothing");
        assert_eq!(sparkline(&[f64::NAN, f64::INFINITY], 1.0), "  ");
    }

    #[test]
    fn a_graph_stands_on_its_ground_and_leaves_out_what_is_not_known() {
        let theme = Theme::named("night").expect("embedded");
        let area = Rect::new(0, 0, 4, 2);
        let mut buffer = Buffer::empty(area);
        let values = [Some(9.0), None, Some(0.0), Some(8.0), Some(16.0)];
        draw(&mut Canvas::new(&mut buffer, &theme), area, &values, 16.0, Role::Accent);
        let rows: Vec<String> = (0..2).map(|y| (0..4).map(|x| buffer[(x, y)].symbol()).collect()).collect();
        assert_eq!(rows, ["   █", " .██"]);
    }
}
