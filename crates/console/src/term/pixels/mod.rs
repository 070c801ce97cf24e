//! Pictures drawn by the terminal, if configured. The terminal is never queried; only pixels are sent.
//! kitty gets them as they are and scales them; Sixel (DEC STD 070) gets 252 dithered colours with run lengths.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use crate::config::Pictures;
use crate::ros::readable::Raster;
use crate::ui::{BAYER, Placement};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use crossterm::terminal::{WindowSize, window_size};
use ratatui::buffer::{Buffer, Cell};
use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr;

/// Pixels read of a picture, whatever size it claims.
const LARGEST: (usize, usize) = (512, 512);
/// Bytes of one picture.
const MOST: usize = 256 * 1024;
/// Allowed on the slowest line too.
const LEAST: usize = 16 * 1024;
/// Seconds that one picture may occupy a limited line.
const SECONDS: usize = 8;
/// Width and height of a cell in pixels, if unknown.
const ASSUMED: (usize, usize) = (8, 16);
const BELIEVED: RangeInclusive<usize> = 4..=64;

/// Pixels a side: xterm's defaults cut larger sixels.
const LARGEST_SIXEL: usize = 1000;

pub fn taking_away(way: Pictures) -> &'static str {
    match way {
        Pictures::HalfBlocks => "",
        Pictures::Sixel => "\x1b[m\x1b[2J",
        Pictures::Kitty => TAKE_AWAY,
    }
}

/// A cell's width and height, pixels.
type Measure = fn() -> (usize, usize);

#[derive(Debug)]
pub struct Pixels {
    way: Pictures,
    most: usize,
    measure: Measure,
    shown: Option<Placement>,
}

#[derive(Debug, Default)]
pub struct Change {
    /// Written before the frame's cells.
    pub away: &'static str,
    /// Written after them.
    pub put: String,
    pub covered: Option<Rect>,
}

impl Pixels {
    /// A limited line gets coarser pictures.
    pub fn new(way: Pictures, bytes_per_second: Option<u32>) -> Self {
        let rate = bytes_per_second.map(|rate| usize::try_from(rate).unwrap_or(MOST));
        let most = rate.map_or(MOST, |rate| rate.saturating_mul(SECONDS).clamp(LEAST, MOST));
        Self { way, most, measure: cell_size, shown: None }
    }

    /// Before the screen is cleared: returns the bytes that remove the picture.
    pub fn forget(&mut self) -> &'static str {
        match (self.shown.take(), self.way) {
            (Some(_), Pictures::Kitty) => TAKE_AWAY,
            // A sixel disappears with its cells.
            _ => "",
        }
    }

    /// Cells to rewrite so that the shown picture makes way for `wanted`.
    pub fn cells_below(&self, wanted: Option<&Placement>, buffer: &Buffer) -> Vec<(u16, u16, Cell)> {
        match &self.shown {
            Some(shown) if self.way == Pictures::Sixel && wanted != Some(shown) => cells(buffer, shown.area),
            _ => Vec::new(),
        }
    }

    /// Writes nothing if the picture is shown already.
    pub fn show(&mut self, wanted: Option<Placement>) -> Change {
        if wanted == self.shown {
            return Change::default();
        }
        let away = self.forget();
        let put = wanted.as_ref().map(|placement| self.put(placement)).unwrap_or_default();
        let covered = wanted.as_ref().map(|placement| placement.area);
        self.shown = wanted;
        Change { away, put, covered }
    }

    /// Restores the cursor: the next cells are written from there.
    fn put(&self, placement: &Placement) -> String {
        let (area, raster) = (placement.area, &placement.raster.fit(LARGEST));
        let (width, height) = (self.measure)();
        let room = (usize::from(area.width) * width, usize::from(area.height) * height);
        let picture = match self.way {
            Pictures::HalfBlocks => return String::new(),
            Pictures::Sixel => {
                let room = (room.0.min(LARGEST_SIXEL), room.1.min(LARGEST_SIXEL));
                encode_sixel(raster, filled(raster, room), self.most)
            }
            Pictures::Kitty => {
                let (across, down) = filled(raster, room);
                encode_kitty(raster, (across.div_ceil(width), down.div_ceil(height)), self.most)
            }
        };
        format!("\x1b7\x1b[{};{}H{picture}\x1b8", area.y + 1, area.x + 1)
    }
}

/// The second column of a wide character belongs to its first.
fn cells(buffer: &Buffer, area: Rect) -> Vec<(u16, u16, Cell)> {
    let mut found = Vec::new();
    let area = area.intersection(*buffer.area());
    for y in area.top()..area.bottom() {
        // A wide character may begin left of the area.
        let mut x = area.left().saturating_sub(1);
        while x < area.right() {
            let cell = &buffer[(x, y)];
            let width = u16::try_from(cell.symbol().width().max(1)).unwrap_or(1);
            if x + width > area.left() {
                found.push((x, y, cell.clone()));
            }
            x += width;
        }
    }
    found
}

/// Fills that many pixels, keeping the shape.
fn filled(raster: &Raster, room: (usize, usize)) -> (usize, usize) {
    let (width, height) = (raster.width.max(1), raster.height.max(1));
    if width.saturating_mul(room.1) >= height.saturating_mul(room.0) {
        (room.0, (height.saturating_mul(room.0) / width).max(1))
    } else {
        ((width.saturating_mul(room.1) / height).max(1), room.1)
    }
}

/// From the kernel (TIOCGWINSZ).
fn cell_size() -> (usize, usize) {
    window_size().ok().and_then(|window| cell_of(&window)).unwrap_or(ASSUMED)
}

/// `None` if the kernel knows nothing plausible.
fn cell_of(window: &WindowSize) -> Option<(usize, usize)> {
    let part = |pixels: u16, cells: u16| {
        let size = usize::from(pixels).checked_div(usize::from(cells))?;
        BELIEVED.contains(&size).then_some(size)
    };
    Some((part(window.width, window.columns)?, part(window.height, window.rows)?))
}

/// In fewer pixels than `grid` has, down to one.
fn coarser(raster: &Raster, grid: &Raster) -> Raster {
    let less = |size: usize| (size - size.div_ceil(6)).max(1);
    raster.fit((less(grid.width), less(grid.height)))
}

/// There is one at a time.
const IMAGE: u32 = 0x4155_5448;
/// Also frees the terminal's copy; the terminal does not answer.
pub const TAKE_AWAY: &str = "\x1b_Ga=d,d=I,i=1096111176,q=2\x1b\\";

/// Bytes of data in a chunk.
const PIECE: usize = 4096;
/// Bytes around a chunk's data.
const AROUND: usize = 96;

/// Upper left corner at the cursor, which stays; coarser if it exceeds `most` bytes. The terminal does not answer.
pub fn encode_kitty(raster: &Raster, cells: (usize, usize), most: usize) -> String {
    let mut grid = raster.clone();
    while length(&grid) > most && grid.rgb.len() > 3 {
        grid = coarser(raster, &grid);
    }
    let data = STANDARD.encode(&grid.rgb);
    let pieces = data.len().div_ceil(PIECE);
    let mut text = String::with_capacity(length(&grid));
    for (place, piece) in data.as_bytes().chunks(PIECE).enumerate() {
        let more = u8::from(place + 1 < pieces);
        let control = if place == 0 {
            let (width, height) = (grid.width, grid.height);
            let (columns, rows) = cells;
            format!("a=T,f=24,s={width},v={height},i={IMAGE},c={columns},r={rows},C=1,q=2,m={more}")
        } else {
            format!("q=2,m={more}")
        };
        text.extend(["\x1b_G", &control, ";"]);
        text.extend(piece.iter().copied().map(char::from));
        text.push_str("\x1b\\");
    }
    text
}

/// Not less than the bytes sent.
fn length(grid: &Raster) -> usize {
    let data = grid.rgb.len().div_ceil(3) * 4;
    data + data.div_ceil(PIECE) * AROUND
}

/// Steps of red, green and blue.
const STEPS: [u32; 3] = [6, 7, 6];
const BAND: usize = 6;

/// Upper left corner at the cursor; coarser if it exceeds `most` bytes.
pub fn encode_sixel(raster: &Raster, size: (usize, usize), most: usize) -> String {
    let mut grid = raster.fit(size);
    loop {
        let text = drawn(&grid, size);
        if text.len() <= most || grid.width.max(grid.height) <= 1 {
            return text;
        }
        grid = coarser(raster, &grid);
    }
}

/// Each pixel of the grid becomes a rectangle; together they fill `size`.
fn drawn(grid: &Raster, size: (usize, usize)) -> String {
    let colours = dithered(grid);
    let mut text = format!("\x1bP0;1q\"1;1;{};{}", size.0, size.1);
    define(&mut text, &colours);
    for top in (0..size.1).step_by(BAND) {
        if top > 0 {
            text.push('-');
        }
        let rows = top..(top + BAND).min(size.1);
        let rows: Vec<usize> = rows.map(|row| row * grid.height / size.1).collect();
        let ends = (1..=grid.width).map(|column| (column * size.0).div_ceil(grid.width));
        band(&mut text, &colours, &rows, &ends.collect::<Vec<_>>());
    }
    text.push_str("\x1b\\");
    text
}

fn dithered(grid: &Raster) -> Vec<u8> {
    let places = (0..grid.height).flat_map(|y| (0..grid.width).map(move |x| (x, y)));
    let colour = |(x, y): (usize, usize)| {
        let threshold = u32::from(BAYER[y % 4][x % 4]);
        let parts = grid.pixel(x, y).into_iter().zip(STEPS);
        let index = parts.fold(0, |index, (part, steps)| index * steps + step(part, steps, threshold));
        u8::try_from(index).unwrap_or(0)
    };
    places.map(colour).collect()
}

/// An area of dithered steps approximates the value.
fn step(value: u8, steps: u32, threshold: u32) -> u32 {
    (u32::from(value) * (steps - 1) * 32 + (2 * threshold + 1) * 255) / (255 * 32)
}

/// In per cent of red, green and blue.
fn define(text: &mut String, colours: &[u8]) {
    let used: BTreeSet<usize> = colours.iter().map(|colour| usize::from(*colour)).collect();
    let per_cent = |step: usize, steps: usize| (step * 200 + steps - 1) / (2 * (steps - 1));
    for index in used {
        let (red, green, blue) = (index / 42, index / 6 % 7, index % 6);
        text.push_str(&format!("#{index};2;{};{};{}", per_cent(red, 6), per_cent(green, 7), per_cent(blue, 6)));
    }
}

/// For each colour, the pixels that have it, six of a column in one character; columns end at `ends`.
fn band(text: &mut String, colours: &[u8], rows: &[usize], ends: &[usize]) {
    let width = ends.len();
    let mut planes: BTreeMap<u8, Vec<u8>> = BTreeMap::new();
    for (bit, row) in rows.iter().enumerate() {
        for (column, colour) in colours.iter().skip(row * width).take(width).enumerate() {
            let plane = planes.entry(*colour).or_insert_with(|| vec![0; width]);
            plane[column] |= 1 << bit;
        }
    }
    for (place, (colour, plane)) in planes.iter().enumerate() {
        if place > 0 {
            text.push('$');
        }
        text.push_str(&format!("#{colour}"));
        let used = plane.iter().rposition(|bits| *bits != 0).map_or(0, |last| last + 1);
        let mut begin = 0;
        for run in plane[..used].chunk_by(|one, other| one == other) {
            let end = begin + run.len();
            let from = begin.checked_sub(1).map_or(0, |before| ends[before]);
            repeat(text, char::from(b'?' + run[0]), ends[end - 1] - from);
            begin = end;
        }
    }
}

fn repeat(text: &mut String, character: char, times: usize) {
    if times > 3 {
        text.push_str(&format!("!{times}{character}"));
    } else {
        text.extend(std::iter::repeat_n(character, times));
    }
}

#[cfg(test)]
mod kitty_tests {
    use super::tests::noise;
    use super::*;
    use proptest::prelude::*;

    /// A picture as a terminal reads it: its size, its cells, its pixels.
    pub fn decode(text: &str) -> ((usize, usize), (usize, usize), Vec<u8>) {
        let mut data = String::new();
        let mut first = String::new();
        let mut more = true;
        for command in text.split_terminator("\x1b\\") {
            assert!(more, "something behind the last piece");
            let (control, piece) = command.strip_prefix("\x1b_G").and_then(|c| c.split_once(';')).expect("a command");
            assert!(piece.len() <= PIECE && control.len() <= AROUND - 8, "{} {}", control.len(), piece.len());
            more = key(control, "m") == 1;
            assert!(!more || piece.len() % 4 == 0, "a piece ends between bytes");
            assert_eq!(key(control, "q"), 2, "the terminal would answer");
            if first.is_empty() {
                first = control.to_owned();
            }
            data.push_str(piece);
        }
        assert!(!more && first.starts_with("a=T,f=24,") && key(&first, "C") == 1, "{first}");
        assert_eq!(key(&first, "i"), usize::try_from(IMAGE).expect("fits"));
        let pair = |one, other| (key(&first, one), key(&first, other));
        (pair("s", "v"), pair("c", "r"), STANDARD.decode(data).expect("base64"))
    }

    fn key(control: &str, name: &str) -> usize {
        let found = control.split(',').filter_map(|pair| pair.split_once('=')).find(|(key, _)| *key == name);
        found.and_then(|(_, value)| value.parse().ok()).unwrap_or_else(|| panic!("no {name} in {control}"))
    }

    #[test]
    fn it_is_taken_away_by_the_number_it_was_put_under() {
        assert_eq!(TAKE_AWAY, format!("\x1b_Ga=d,d=I,i={IMAGE},q=2\x1b\\"));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]
        #[test]
        fn every_pixel_arrives(width in 1usize..=200, height in 1usize..=120, seed in any::<u8>()) {
            let raster = noise((width, height), seed);
            let text = encode_kitty(&raster, (20, 10), 256 * 1024);
            prop_assert_eq!(decode(&text), ((width, height), (20, 10), raster.rgb.clone()));
            let text = encode_kitty(&raster, (20, 10), 16 * 1024);
            prop_assert!(text.len() <= 16 * 1024, "{}", text.len());
            let (size, _, rgb) = decode(&text);
            let mut sizes = std::iter::successors(Some(raster.clone()), |grid| Some(coarser(&raster, grid))).take(50);
            let wanted = sizes.find(|grid| (grid.width, grid.height) == size).expect("a coarser one");
            prop_assert_eq!(rgb, wanted.rgb);
            prop_assert!(size.0 * size.1 * 2 >= (width * height).min(3_900), "{:?}", size);
        }
    }
}

#[cfg(test)]
mod sixel_tests {
    use super::tests::noise;
    use super::*;
    use proptest::prelude::*;

    /// Removes a number from the front of `text` and returns it.
    fn number(text: &mut &str) -> usize {
        let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let value = text[..end].parse().expect("a number");
        *text = &text[end..];
        value
    }

    fn numbers(text: &mut &str) -> Vec<usize> {
        let mut found = vec![number(text)];
        while let Some(rest) = text.strip_prefix(';') {
            *text = rest;
            found.push(number(text));
        }
        found
    }

    /// What a terminal draws: width, height and each pixel; every one of them is drawn exactly once.
    pub fn decode(text: &str) -> Raster {
        let body = text.strip_prefix("\x1bP0;1q\"").and_then(|text| text.strip_suffix("\x1b\\")).expect("one sixel");
        let mut rest = body;
        let attributes = numbers(&mut rest);
        let (width, height) = (attributes[2], attributes[3]);
        assert_eq!(attributes[..2], [1, 1]);
        let mut palette = BTreeMap::new();
        let mut pixels = vec![None; width * height];
        let (mut x, mut top, mut colour, mut times) = (0, 0, 0, 1);
        while let Some(first) = rest.chars().next() {
            rest = &rest[1..];
            match first {
                '#' => {
                    let found = numbers(&mut rest);
                    colour = found[0];
                    if let [_, kind, parts @ ..] = &found[..] {
                        assert_eq!((*kind, parts.len()), (2, 3));
                        let part = |at: usize| u8::try_from(parts[at] * 255 / 100).expect("per cent");
                        palette.insert(colour, [part(0), part(1), part(2)]);
                    }
                }
                '!' => times = number(&mut rest),
                '$' => x = 0,
                '-' => (x, top) = (0, top + BAND),
                '?'..='~' => {
                    let bits = u32::from(first) - 63;
                    for _ in 0..std::mem::replace(&mut times, 1) {
                        for y in (0..BAND).filter(|y| bits & 1 << y != 0) {
                            assert!(x < width && top + y < height, "{x} {} outside of {width} {height}", top + y);
                            let before = pixels[(top + y) * width + x].replace(palette[&colour]);
                            assert_eq!(before, None, "drawn twice");
                        }
                        x += 1;
                    }
                }
                other => panic!("{other:?} in a sixel"),
            }
        }
        Raster { width, height, rgb: pixels.into_iter().flat_map(|pixel| pixel.expect("drawn")).collect() }
    }

    /// Every pixel is within one step of its intended value.
    fn assert_near(seen: &Raster, wanted: &Raster) {
        for y in 0..seen.height {
            for x in 0..seen.width {
                let (from, to) =
                    (wanted.pixel(x * wanted.width / seen.width, y * wanted.height / seen.height), seen.pixel(x, y));
                let near = from
                    .iter()
                    .zip(to)
                    .zip(STEPS)
                    .all(|((from, to), steps)| u32::from(from.abs_diff(to)) <= 255 / (steps - 1) + 2);
                assert!(near, "{x} {y}: {from:?} became {to:?}");
            }
        }
    }

    #[test]
    fn black_white_and_what_is_between() {
        let raster = Raster { width: 2, height: 1, rgb: vec![0, 0, 0, 255, 255, 255] };
        assert_eq!(
            encode_sixel(&raster, (8, 7), 1_000),
            "\x1bP0;1q\"1;1;8;7#0;2;0;0;0#251;2;100;100;100#0!4~$#251!4?!4~-#0!4@$#251!4?!4@\x1b\\"
        );
        let grey = Raster { width: 16, height: 16, rgb: vec![120; 768] };
        let seen = decode(&encode_sixel(&grey, (16, 16), 10_000));
        let sum: u32 = seen.rgb.iter().copied().map(u32::from).sum();
        assert!((115..=125).contains(&(sum / 768)), "{}", sum / 768);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]
        #[test]
        fn every_pixel_is_drawn_once_and_near_its_colour(
            width in 1usize..=200, height in 1usize..=120, across in 1usize..=400, down in 1usize..=300, seed in any::<u8>(),
        ) {
            let raster = noise((width, height), seed);
            let seen = decode(&encode_sixel(&raster, (across, down), usize::MAX));
            prop_assert_eq!((seen.width, seen.height), (across, down));
            assert_near(&seen, &raster.fit((across, down)));
            let text = encode_sixel(&raster, (across, down), 16 * 1024);
            prop_assert!(text.len() <= 16 * 1024, "{}", text.len());
            prop_assert_eq!(decode(&text).rgb.len(), across * down * 3);
        }
    }
}

#[cfg(test)]
mod tests;
