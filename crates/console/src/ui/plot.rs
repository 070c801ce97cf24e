//! Points of a plane in Braille dots, two by four to a cell, both axes to one scale; pixels as half blocks.

use ratatui::layout::Rect;
use ratatui::style::{Color, Style};

use super::canvas::{Canvas, Placement, below, row};
use super::frame::above;
use super::theme::{Depth, Rgb, Role, SIXTEEN, distance};
use crate::ros::readable::{Plot, Raster};

/// Smallest width plotted, in units of the axes.
const LEAST: f64 = 0.1;

/// Braille bit of a column and row in the cell.
pub const DOTS: [[u8; 4]; 2] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];

#[derive(Debug, Clone, Copy, PartialEq)]
struct Window {
    left: f64,
    bottom: f64,
    dot: f64,
    /// Across and down.
    dots: (u16, u16),
}

impl Window {
    /// Smallest window around all points.
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

    /// From the left and from above.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the dots")]
    fn place(&self, point: (f64, f64)) -> Option<(u16, u16)> {
        let across = ((point.0 - self.left) / self.dot).round();
        let up = ((point.1 - self.bottom) / self.dot).round();
        let inside = (0.0..f64::from(self.dots.0)).contains(&across) && (0.0..f64::from(self.dots.1)).contains(&up);
        inside.then(|| (across as u16, self.dots.1 - 1 - up as u16))
    }
}

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

/// Row by row.
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

fn between(from: (u16, u16), to: (u16, u16)) -> impl Iterator<Item = (u16, u16)> {
    let steps = from.0.abs_diff(to.0).max(from.1.abs_diff(to.1)).max(1);
    let along = move |from: u16, to: u16, step: u16| {
        let (from, to) = (i64::from(from), i64::from(to));
        u16::try_from(from + (to - from) * i64::from(step) / i64::from(steps)).unwrap_or(0)
    };
    (0..=steps).map(move |step| (along(from.0, to.0, step), along(from.1, to.1, step)))
}

/// Dark to bright.
const RAMP: &[u8] = b" .:-=+*#%@";

/// Thresholds of ordered dithering, 0 to 15.
pub const BAYER: [[u8; 4]; 4] = [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];

/// Upper left of `area`, as large as fits, keeping the shape.
pub fn draw_raster(canvas: &mut Canvas, area: Rect, raster: &Raster) {
    let cells = (usize::from(area.width), usize::from(area.height));
    if canvas.theme.draws_pixels() {
        return place(canvas, area, raster);
    }
    let depth = canvas.depth();
    // A cell is about twice as high as wide.
    let fitted = raster.fit((cells.0, cells.1 * 2));
    each(area, (fitted.width, fitted.height.div_ceil(2)), |x, y, cell| {
        let (upper, lower) = (fitted.pixel(x, y * 2), fitted.pixel(x, y * 2 + 1));
        if depth == Depth::None {
            let bright = usize::midpoint(brightness(upper), brightness(lower));
            let letter = RAMP.get(bright * RAMP.len() / 256).copied().unwrap_or(b'@');
            return canvas.paint(cell, char::from(letter), Style::default());
        }
        let fg = coloured(upper, (x, y * 2), depth);
        let style = Style::default().fg(fg).bg(coloured(lower, (x, y * 2 + 1), depth));
        canvas.paint(cell, '▀', style);
    });
}

/// The half-blocks' place, clear of messages, which come and go.
fn place(canvas: &mut Canvas, area: Rect, raster: &Raster) {
    let area = area.intersection(above(*canvas.buffer.area()));
    let (width, height) = raster.size_within((usize::from(area.width), usize::from(area.height) * 2));
    let (Ok(width), Ok(height)) = (u16::try_from(width), u16::try_from(height.div_ceil(2))) else { return };
    let area = Rect { width, height, ..area };
    if !area.is_empty() {
        canvas.place(Placement { area, raster: raster.clone() });
    }
}

fn each(area: Rect, size: (usize, usize), mut paint: impl FnMut(usize, usize, Rect)) {
    for y in 0..size.1 {
        for x in 0..size.0 {
            let (Ok(right), Ok(down)) = (u16::try_from(x), u16::try_from(y)) else { continue };
            paint(x, y, Rect { x: area.x + right, y: area.y + down, width: 1, height: 1 });
        }
    }
}

fn brightness(pixel: [u8; 3]) -> usize {
    let [red, green, blue] = pixel.map(usize::from);
    (red * 299 + green * 587 + blue * 114) / 1000
}

fn coloured(pixel: [u8; 3], place: (usize, usize), depth: Depth) -> Color {
    let (red, green, blue) = match depth {
        Depth::Sixteen => dithered(pixel, place),
        // Fewer steps make more neighbours equal, and equal cells are not sent again.
        _ => (pixel[0] & 0xf8, pixel[1] & 0xf8, pixel[2] & 0xf8),
    };
    Color::Rgb(red, green, blue)
}

/// Ordered: an area of the sixteen approximates the colour.
fn dithered(pixel: [u8; 3], place: (usize, usize)) -> Rgb {
    let shift = (i16::from(BAYER[place.1 % 4][place.0 % 4]) - 8) * 6;
    let part = |part: u8| u8::try_from((i16::from(part) + shift).clamp(0, 255)).unwrap_or(part);
    let wanted = (part(pixel[0]), part(pixel[1]), part(pixel[2]));
    SIXTEEN.into_iter().min_by_key(|colour| distance(wanted, *colour)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ui::theme::Theme;
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

#[cfg(test)]
mod raster_tests {
    use super::*;
    use crate::ui::theme::Theme;
    use ratatui::buffer::Buffer;

    fn drawn(raster: &Raster, depth: Depth, ascii: bool) -> Buffer {
        let theme = Theme { ascii, depth, ..Theme::named("night").expect("embedded") };
        let area = Rect::new(0, 0, 12, 6);
        let mut buffer = Buffer::empty(area);
        draw_raster(&mut Canvas::new(&mut buffer, &theme), area, raster);
        buffer
    }

    fn ramp() -> Raster {
        let rgb = (0..24).flat_map(|_| (0u8..24).flat_map(|x| [x * 10; 3])).collect();
        Raster { width: 24, height: 24, rgb }
    }

    #[test]
    fn half_blocks_carry_two_pixels_each() {
        let buffer = drawn(&ramp(), Depth::True, false);
        assert_eq!(buffer[(0, 0)].symbol(), "▀");
        assert!(matches!(buffer[(11, 5)].bg, Color::Rgb(224.., 224.., 224..)), "{:?}", buffer[(11, 5)]);
    }

    #[test]
    fn sixteen_colours_are_dithered() {
        let grey = Raster { width: 12, height: 12, rgb: vec![145; 432] };
        let buffer = drawn(&grey, Depth::Sixteen, false);
        let kinds: std::collections::BTreeSet<String> =
            buffer.content().iter().map(|cell| format!("{:?}", cell.fg)).collect();
        assert!(kinds.len() > 1, "a grey between two is mixed of both: {kinds:?}");
        assert!(
            buffer.content().iter().all(|cell| matches!(cell.fg, Color::Rgb(r, g, b) if SIXTEEN.contains(&(r, g, b))))
        );
    }

    fn placed(theme: &Theme, raster: &Raster, over: &str) -> Option<Placement> {
        let mut buffer = Buffer::empty(Rect::new(0, 0, 40, 12));
        let mut canvas = Canvas::new(&mut buffer, theme);
        draw_raster(&mut canvas, Rect::new(3, 2, 30, 10), raster);
        canvas.put(Rect::new(12, 7, 5, 1), over, crate::ui::theme::Role::Body);
        canvas.placement()
    }

    #[test]
    fn a_terminal_that_draws_pictures_gets_a_place_clear_of_messages() {
        let night = || Theme { pixels: true, ..Theme::named("night").expect("embedded") };
        let placement = placed(&night(), &ramp(), "").expect("a place");
        assert_eq!((placement.area, placement.raster), (Rect::new(3, 2, 12, 6), ramp()));
        assert!(placement.area.bottom() <= 8, "four rows are kept for messages and bar");
        assert_eq!(placed(&night(), &ramp(), "text"), None, "text over it wins");
        assert_eq!(placed(&night(), &Raster::default(), ""), None);
        let mono = Theme { pixels: true, ..Theme::named("mono").expect("embedded") };
        for theme in [
            Theme { ascii: true, ..night() },
            Theme { depth: Depth::None, ..night() },
            Theme { pixels: false, ..night() },
            mono,
        ] {
            assert_eq!(placed(&theme, &ramp(), ""), None);
        }
    }

    #[test]
    fn without_colours_it_is_characters() {
        for (shades, ascii) in [(Depth::None, false), (Depth::True, true)] {
            let buffer = drawn(&ramp(), shades, ascii);
            let row: String = (0..12).map(|x| buffer[(x, 2)].symbol()).collect();
            assert!(row.starts_with(' ') && row.ends_with('%') && row.is_ascii(), "{row}");
            assert!(buffer.content().iter().all(|cell| cell.fg == Color::Reset));
        }
    }
}
