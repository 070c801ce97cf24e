//! Points of a plane in Braille dots, two by four to a cell, both axes to one scale; the ends of the axes beside it.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, row};
use super::theme::Role;
use crate::ros::readable::Plot;

/// The smallest width that is plotted, metres or the unit of the axes.
const LEAST: f64 = 0.1;

/// Which dot of a Braille pattern is at a column and row of the cell.
const DOTS: [[u8; 4]; 2] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];

/// The visible part of the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Window {
    left: f64,
    bottom: f64,
    /// Length of one dot.
    dot: f64,
    /// Dots across and down.
    dots: (u16, u16),
}

impl Window {
    /// The smallest one that shows all points.
    fn around(points: &[(f64, f64)], cells: (u16, u16)) -> Option<Self> {
        let dots = (cells.0.checked_mul(2)?, cells.1.checked_mul(4)?);
        if dots.0 < 4 || dots.1 < 4 {
            return None;
        }
        let range = |of: fn(&(f64, f64)) -> f64| {
            let ends = (f64::INFINITY, f64::NEG_INFINITY);
            points.iter().map(of).filter(|at| at.is_finite()).fold(ends, |(low, high), at| (low.min(at), high.max(at)))
        };
        let ((left, right), (bottom, top)) = (range(|point| point.0), range(|point| point.1));
        if left > right || bottom > top {
            return None;
        }
        let dot =
            ((right - left).max(LEAST) / f64::from(dots.0 - 1)).max((top - bottom).max(LEAST) / f64::from(dots.1 - 1));
        let centred = |low: f64, high: f64, dots: u16| f64::midpoint(low, high) - dot * f64::from(dots - 1) / 2.0;
        let window = Self { left: centred(left, right, dots.0), bottom: centred(bottom, top, dots.1), dot, dots };
        (dot.is_finite() && window.left.is_finite() && window.bottom.is_finite()).then_some(window)
    }

    /// The dot of a point, from the left and from above.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the dots")]
    fn place(&self, point: (f64, f64)) -> Option<(u16, u16)> {
        let across = ((point.0 - self.left) / self.dot).round();
        let up = ((point.1 - self.bottom) / self.dot).round();
        let inside = (0.0..f64::from(self.dots.0)).contains(&across) && (0.0..f64::from(self.dots.1)).contains(&up);
        inside.then(|| (across as u16, self.dots.1 - 1 - up as u16))
    }
}

/// Draws a plot with its title above and its ends below.
pub fn draw(canvas: &mut Canvas, area: Rect, plot: &Plot) {
    canvas.puts(row(area, 0), &[(&plot.title, Role::Title), ("  ", Role::Body), (&legend(plot), Role::Dim)]);
    let field = Rect { height: area.height.saturating_sub(2), ..below(area, 1) };
    let shown: Vec<(f64, f64)> = plot.points.iter().chain(plot.here.as_ref()).copied().collect();
    let Some(window) = Window::around(&shown, (field.width, field.height)) else {
        canvas.put(row(field, 0), "Nothing to plot.", Role::Dim);
        return;
    };
    for (at, pattern) in patterns(plot, &window).into_iter().enumerate().filter(|(_, pattern)| *pattern != 0) {
        let at = u16::try_from(at).unwrap_or(u16::MAX);
        let cell = Rect { x: field.x + at % field.width, y: field.y + at / field.width, width: 1, height: 1 };
        let dots = char::from_u32(0x2800 + u32::from(pattern)).unwrap_or(' ');
        canvas.put(cell, dots.encode_utf8(&mut [0; 4]), Role::Accent);
    }
    if let Some((across, down)) = plot.here.and_then(|here| window.place(here)) {
        let cell = Rect { x: field.x + across / 2, y: field.y + down / 4, width: 1, height: 1 };
        canvas.put(cell, "●", Role::Warning);
    }
    ends(canvas, row(area, area.height.saturating_sub(1)), plot, &window);
}

fn legend(plot: &Plot) -> String {
    let word = if plot.path { "places" } else { "points" };
    let here = if plot.here.is_some() { if plot.path { "; ● this record" } else { "; ● the sensor" } } else { "" };
    format!("{} {word}{here}", plot.points.len())
}

fn ends(canvas: &mut Canvas, area: Rect, plot: &Plot, window: &Window) {
    let right = window.left + window.dot * f64::from(window.dots.0 - 1);
    let top = window.bottom + window.dot * f64::from(window.dots.1 - 1);
    let text =
        format!("{} {:.2} to {right:.2}   {} {:.2} to {top:.2}", plot.axes.0, window.left, plot.axes.1, window.bottom);
    canvas.put(area, &text, Role::Dim);
}

/// The Braille pattern of each cell, row by row.
fn patterns(plot: &Plot, window: &Window) -> Vec<u8> {
    let width = usize::from(window.dots.0 / 2);
    let mut cells = vec![0; width * usize::from(window.dots.1 / 4)];
    let mut set = |(across, down): (u16, u16)| {
        let at = usize::from(down / 4) * width + usize::from(across / 2);
        if let Some(cell) = cells.get_mut(at) {
            *cell |= DOTS[usize::from(across % 2)][usize::from(down % 4)];
        }
    };
    let places: Vec<Option<(u16, u16)>> = plot.points.iter().map(|point| window.place(*point)).collect();
    places.iter().flatten().copied().for_each(&mut set);
    if plot.path {
        for pair in places.windows(2) {
            if let [Some(from), Some(to)] = pair {
                between(*from, *to).for_each(&mut set);
            }
        }
    }
    cells
}

/// Dots on the line between two dots.
fn between(from: (u16, u16), to: (u16, u16)) -> impl Iterator<Item = (u16, u16)> {
    let steps = from.0.abs_diff(to.0).max(from.1.abs_diff(to.1)).max(1);
    let along = move |from: u16, to: u16, step: u16| {
        let (from, to) = (i64::from(from), i64::from(to));
        u16::try_from(from + (to - from) * i64::from(step) / i64::from(steps)).unwrap_or(0)
    };
    (0..=steps).map(move |step| (along(from.0, to.0, step), along(from.1, to.1, step)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ui::Theme;
    use ratatui::buffer::Buffer;

    fn drawn(points: Vec<(f64, f64)>, path: bool, here: Option<(f64, f64)>) -> Vec<String> {
        let theme = Theme::named("night").expect("embedded");
        let area = Rect::new(0, 0, 20, 10);
        let mut buffer = Buffer::empty(area);
        let axes = ("x, m".to_owned(), "y, m".to_owned());
        let plot = Plot { title: "Path".to_owned(), axes, points, path, here };
        draw(&mut Canvas::new(&mut buffer, &theme), area, &plot);
        (0..10).map(|y| (0..20).map(|x| buffer[(x, y)].symbol()).collect()).collect()
    }

    #[test]
    fn a_path_goes_through_its_points_and_shows_where_this_record_is() {
        let rows = drawn(vec![(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)], true, Some((4.0, 4.0)));
        assert!(rows[1].contains('●'), "{rows:#?}");
        assert!(rows[8].trim().chars().count() >= 14, "{rows:#?}");
        assert!(rows[9].contains("x, m"), "{rows:#?}");
    }

    #[test]
    fn hostile_points_are_left_out() {
        let far = vec![(f64::MAX, 1.0), (-f64::MAX, f64::NAN), (1.0, f64::INFINITY)];
        for points in [far, vec![(f64::NAN, f64::NAN)], vec![], vec![(1e300, 1e300); 5]] {
            let rows = drawn(points, true, None);
            assert_eq!(rows.len(), 10);
        }
        assert!(drawn(vec![(2.0, 2.0)], false, None).concat().contains(|c| ('\u{2801}'..='\u{28ff}').contains(&c)));
    }
}
