//! Small pictures in cells: half-blocks if there are colours (dithered if there are sixteen), characters by their
//! brightness if there are none. If the terminal draws pictures itself, only their place is decided here.

use ratatui::layout::Rect;
use ratatui::style::{Color, Style};

use super::bottom;
use super::canvas::Canvas;
use super::palette::{Rgb, SIXTEEN, distance};
use super::theme::Shades;
use crate::ros::readable::Raster;

/// Characters from dark to bright.
const RAMP: &[u8] = b" .:-=+*#%@";

/// Thresholds of ordered dithering, 0 to 15.
pub const BAYER: [[u8; 4]; 4] = [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];

/// A picture that the terminal draws itself, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    /// The cells it fills, all of them empty.
    pub area: Rect,
    /// Its pixels.
    pub raster: Raster,
}

/// Draws a picture into the upper left of `area`, as large as fits while keeping its shape.
pub fn draw(canvas: &mut Canvas, area: Rect, raster: &Raster) {
    let cells = (usize::from(area.width), usize::from(area.height));
    if canvas.draws_pixels() {
        return place(canvas, area, raster);
    }
    let shades = canvas.shades();
    if shades == Shades::None {
        // A cell is about twice as high as wide.
        let fitted = raster.fit((cells.0, cells.1 * 2));
        each(area, (fitted.width, fitted.height.div_ceil(2)), |x, y, cell| {
            let bright = usize::midpoint(brightness(fitted.pixel(x, y * 2)), brightness(fitted.pixel(x, y * 2 + 1)));
            let letter = RAMP.get(bright * RAMP.len() / 256).copied().unwrap_or(b'@');
            canvas.paint(cell, char::from(letter), Style::default());
        });
        return;
    }
    let fitted = raster.fit((cells.0, cells.1 * 2));
    each(area, (fitted.width, fitted.height.div_ceil(2)), |x, y, cell| {
        let colour = |y: usize| coloured(fitted.pixel(x, y), (x, y), shades);
        let style = Style::default().fg(colour(y * 2)).bg(colour(y * 2 + 1));
        canvas.paint(cell, '▀', style);
    });
}

/// The place that half-blocks would take, clear of the messages, which come and go.
fn place(canvas: &mut Canvas, area: Rect, raster: &Raster) {
    let area = area.intersection(bottom::above(canvas.screen()));
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

fn coloured(pixel: [u8; 3], place: (usize, usize), shades: Shades) -> Color {
    let (red, green, blue) = match shades {
        Shades::Sixteen => dithered(pixel, place),
        // Fewer steps make more neighbours equal, and equal cells are not sent again.
        _ => (pixel[0] & 0xf8, pixel[1] & 0xf8, pixel[2] & 0xf8),
    };
    Color::Rgb(red, green, blue)
}

/// One of the sixteen colours, depending on the place: an area of them approximates the colour.
fn dithered(pixel: [u8; 3], place: (usize, usize)) -> Rgb {
    let shift = (i16::from(BAYER[place.1 % 4][place.0 % 4]) - 8) * 6;
    let part = |part: u8| u8::try_from((i16::from(part) + shift).clamp(0, 255)).unwrap_or(part);
    let wanted = (part(pixel[0]), part(pixel[1]), part(pixel[2]));
    SIXTEEN.into_iter().min_by_key(|colour| distance(wanted, *colour)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ui::Theme;
    use ratatui::buffer::Buffer;

    fn drawn(raster: &Raster, shades: Shades, ascii: bool) -> Buffer {
        let theme = Theme::named("night").expect("embedded").with_ascii(ascii).with_shades(shades);
        let area = Rect::new(0, 0, 12, 6);
        let mut buffer = Buffer::empty(area);
        draw(&mut Canvas::new(&mut buffer, &theme), area, raster);
        buffer
    }

    fn ramp() -> Raster {
        let rgb = (0..24).flat_map(|_| (0u8..24).flat_map(|x| [x * 10; 3])).collect();
        Raster { width: 24, height: 24, rgb }
    }

    #[test]
    fn half_blocks_carry_two_pixels_each() {
        let buffer = drawn(&ramp(), Shades::All, false);
        assert_eq!(buffer[(0, 0)].symbol(), "▀");
        assert!(matches!(buffer[(11, 5)].bg, Color::Rgb(224.., 224.., 224..)), "{:?}", buffer[(11, 5)]);
    }

    #[test]
    fn sixteen_colours_are_dithered() {
        let grey = Raster { width: 12, height: 12, rgb: vec![145; 432] };
        let buffer = drawn(&grey, Shades::Sixteen, false);
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
        draw(&mut canvas, Rect::new(3, 2, 30, 10), raster);
        canvas.put(Rect::new(12, 7, 5, 1), over, crate::ui::Role::Body);
        canvas.placement()
    }

    #[test]
    fn a_terminal_that_draws_pictures_gets_a_place_clear_of_messages() {
        let night = || Theme::named("night").expect("embedded").with_pixels(true);
        let placement = placed(&night(), &ramp(), "").expect("a place");
        assert_eq!((placement.area, placement.raster), (Rect::new(3, 2, 12, 6), ramp()));
        assert!(placement.area.bottom() <= 8, "four rows are kept for messages and bar");
        assert_eq!(placed(&night(), &ramp(), "text"), None, "text over it wins");
        assert_eq!(placed(&night(), &Raster::default(), ""), None);
        let mono = Theme::named("mono").expect("embedded").with_pixels(true);
        for theme in [night().with_ascii(true), night().with_shades(Shades::None), night().with_pixels(false), mono] {
            assert_eq!(placed(&theme, &ramp(), ""), None);
        }
    }

    #[test]
    fn without_colours_it_is_characters() {
        for (shades, ascii) in [(Shades::None, false), (Shades::All, true)] {
            let buffer = drawn(&ramp(), shades, ascii);
            let row: String = (0..12).map(|x| buffer[(x, 2)].symbol()).collect();
            assert!(row.starts_with(' ') && row.ends_with('%') && row.is_ascii(), "{row}");
            assert!(buffer.content().iter().all(|cell| cell.fg == Color::Reset));
        }
    }
}
