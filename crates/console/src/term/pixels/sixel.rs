//! Sixel graphics (DEC STD 070): a picture of 252 fixed colours, mixed by ordered dithering, with run lengths.

use std::collections::BTreeMap;

use super::coarser;
use crate::ros::readable::Raster;
use crate::ui::BAYER;

/// Steps of red, green and blue.
const STEPS: [u32; 3] = [6, 7, 6];
/// All mixtures of them.
const COLOURS: usize = 252;
/// Rows of pixels in one band.
const BAND: usize = 6;

/// The picture in `size` pixels, its upper left corner at the cursor, in at most `most` bytes: coarser if it would take
/// more.
pub fn encode(raster: &Raster, size: (usize, usize), most: usize) -> String {
    let mut grid = raster.fit(size);
    loop {
        let text = drawn(&grid, size);
        if text.len() <= most || grid.width.max(grid.height) <= 1 {
            return text;
        }
        grid = coarser(raster, &grid);
    }
}

/// Each pixel of the grid becomes a rectangle, so that all of them fill `size`.
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

/// The colour of each pixel of the grid, row by row.
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

/// The step below or above, depending on the threshold: an area of them approximates the value.
fn step(value: u8, steps: u32, threshold: u32) -> u32 {
    (u32::from(value) * (steps - 1) * 32 + (2 * threshold + 1) * 255) / (255 * 32)
}

/// Defines the numbers of the colours used, in per cent of red, green and blue.
fn define(text: &mut String, colours: &[u8]) {
    let mut used = [false; COLOURS];
    for colour in colours {
        if let Some(used) = used.get_mut(usize::from(*colour)) {
            *used = true;
        }
    }
    let per_cent = |step: usize, steps: usize| (step * 200 + steps - 1) / (2 * (steps - 1));
    for (index, _) in used.iter().enumerate().filter(|(_, used)| **used) {
        let (red, green, blue) = (index / 42, index / 6 % 7, index % 6);
        text.push_str(&format!("#{index};2;{};{};{}", per_cent(red, 6), per_cent(green, 7), per_cent(blue, 6)));
    }
}

/// One band: for each of its colours the pixels that have it, six of a column in one character. `rows` are those of the
/// grid; each column of the grid ends at the pixel given by `ends`.
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
pub(super) mod tests {
    use super::*;
    use crate::term::pixels::tests::noise;
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
            encode(&raster, (8, 7), 1_000),
            "\x1bP0;1q\"1;1;8;7#0;2;0;0;0#251;2;100;100;100#0!4~$#251!4?!4~-#0!4@$#251!4?!4@\x1b\\"
        );
        let grey = Raster { width: 16, height: 16, rgb: vec![120; 768] };
        let seen = decode(&encode(&grey, (16, 16), 10_000));
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
            let seen = decode(&encode(&raster, (across, down), usize::MAX));
            prop_assert_eq!((seen.width, seen.height), (across, down));
            assert_near(&seen, &raster.fit((across, down)));
            let text = encode(&raster, (across, down), 16 * 1024);
            prop_assert!(text.len() <= 16 * 1024, "{}", text.len());
            prop_assert_eq!(decode(&text).rgb.len(), across * down * 3);
        }
    }
}
