//! The graphics protocol of kitty: a picture's pixels as they are, scaled by the terminal to a number of cells.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::coarser;
use crate::ros::readable::Raster;

/// The id of our picture in the terminal; there is one at a time.
const IMAGE: u32 = 0x4155_5448;
/// Removes it and frees the terminal's copy; the terminal does not answer.
pub const TAKE_AWAY: &str = "\x1b_Ga=d,d=I,i=1096111176,q=2\x1b\\";

/// The longest chunk of data, bytes.
const PIECE: usize = 4096;
/// The most bytes a chunk has around its data.
const AROUND: usize = 96;

/// The picture in this many `cells`, its upper left corner at the cursor, in at most `most` bytes: coarser if it would
/// take more. The cursor stays, and the terminal does not answer.
pub fn encode(raster: &Raster, cells: (usize, usize), most: usize) -> String {
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

/// At least the number of bytes of a picture as it is sent.
fn length(grid: &Raster) -> usize {
    let data = grid.rgb.len().div_ceil(3) * 4;
    data + data.div_ceil(PIECE) * AROUND
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::term::pixels::tests::noise;
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
            let text = encode(&raster, (20, 10), 256 * 1024);
            prop_assert_eq!(decode(&text), ((width, height), (20, 10), raster.rgb.clone()));
            let text = encode(&raster, (20, 10), 16 * 1024);
            prop_assert!(text.len() <= 16 * 1024, "{}", text.len());
            let (size, _, rgb) = decode(&text);
            let mut sizes = std::iter::successors(Some(raster.clone()), |grid| Some(coarser(&raster, grid))).take(50);
            let wanted = sizes.find(|grid| (grid.width, grid.height) == size).expect("a coarser one");
            prop_assert_eq!(rgb, wanted.rgb);
            prop_assert!(size.0 * size.1 * 2 >= (width * height).min(3_900), "{:?}", size);
        }
    }
}
