//! The library of screens: what an emulated terminal holds after a frame, for named situations at three sizes, and how
//! it looks in every theme. `tools/pictures.py` draws pictures from the looks.

mod screens;

use std::num::NonZeroU16;

use vt100::{Cell, Color, Parser};

use super::encode::Depth;
use super::renderer::{Painter, Scene, Wish};
use crate::app::State;
use crate::ui::Theme;

/// What the sanitiser puts in place of hostile characters. The emulator drops it, which no terminal does.
const REPLACED: &str = "\u{fffd}";
/// Its stand-in inside the emulator.
const STAND_IN: &str = "\u{e000}";

const SIZES: [(u16, u16); 3] = [(80, 24), (120, 40), (200, 50)];

/// Situations whose looks are kept: those drawn as pictures.
const PICTURES: [&str; 10] = [
    "overview",
    "topics",
    "uploads-chosen-columns",
    "provenance",
    "record-plot",
    "grant-asked",
    "readers",
    "in-trouble",
    "quit-asked",
    "incidents",
];

/// How a situation can look: name, theme, colours of the terminal, ASCII only.
const LOOKS: [(&str, &str, Depth, bool); 7] = [
    ("night", "night", Depth::True, false),
    ("day", "day", Depth::True, false),
    ("contrast", "contrast", Depth::True, false),
    ("mono", "mono", Depth::True, false),
    ("sixteen", "night", Depth::Sixteen, false),
    ("no-color", "mono", Depth::None, false),
    ("ascii", "night", Depth::True, true),
];

/// What a terminal holds after the frame.
fn emulated(state: State, theme: Theme, depth: Depth) -> Parser {
    let (columns, rows) = state.size;
    let mut painter = Painter::new(depth, state.size);
    let size = |cells| NonZeroU16::new(cells).expect("not zero");
    let mut terminal = Parser::new(size(rows), size(columns), 0);
    let mut scene =
        Scene { state, theme, wish: Wish::Now, anew: true, extra: String::new(), suspended: false, over: false };
    terminal.process(painter.paint(&mut scene).replace(REPLACED, STAND_IN).as_bytes());
    terminal
}

fn theme(name: &str, ascii: bool) -> Theme {
    Theme::named(name).expect("embedded").with_ascii(ascii)
}

/// Its rows, each cell by `of`, without what is empty at their ends.
fn rows(terminal: &Parser, mut of: impl FnMut(&Cell) -> String) -> String {
    let (rows, columns) = terminal.screen().size();
    let cell = |row, column| terminal.screen().cell(row, column).filter(|cell| !cell.is_wide_continuation());
    let (rows, columns) = (rows.get(), columns.get());
    let mut line = |row| (0..columns).filter_map(|column| cell(row, column)).map(&mut of).collect::<String>();
    (0..rows).map(|row| line(row).trim_end().to_owned() + "\n").collect()
}

fn text(terminal: &Parser) -> String {
    let shown =
        |cell: &Cell| if cell.has_contents() { cell.contents().replace(STAND_IN, REPLACED) } else { " ".into() };
    rows(terminal, shown)
}

/// A letter for each style, none for plain cells; the styles come first.
fn letters(terminal: &Parser) -> String {
    let mut styles: Vec<String> = Vec::new();
    let grid = rows(terminal, |cell| {
        let style = style(cell);
        if style.is_empty() {
            return " ".to_owned();
        }
        let place = styles.iter().position(|other| *other == style).unwrap_or_else(|| {
            styles.push(style);
            styles.len() - 1
        });
        letter(place).to_string()
    });
    let legend = styles.iter().enumerate().map(|(place, style)| format!("# {} {style}\n", letter(place)));
    legend.collect::<String>() + &grid
}

fn letter(place: usize) -> char {
    ('a'..='z').chain('A'..='Z').nth(place).expect("few styles")
}

fn style(cell: &Cell) -> String {
    let colour = |name: &str, colour: Color| match colour {
        Color::Default => None,
        Color::Idx(index) => Some(format!("{name}={index}")),
        Color::Rgb(red, green, blue) => Some(format!("{name}=#{red:02x}{green:02x}{blue:02x}")),
    };
    let is = |word: &str, on: bool| on.then(|| word.to_owned());
    // An empty cell shows its background and its line only.
    let ink = cell.has_contents() && cell.contents() != " " || cell.inverse();
    let parts = [
        colour("fg", cell.fgcolor()).filter(|_| ink),
        colour("bg", cell.bgcolor()),
        is("bold", cell.bold() && ink),
        is("dim", cell.dim() && ink),
        is("underlined", cell.underline()),
        is("reversed", cell.inverse()),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

fn compare(name: &str, text: &str) {
    let mut settings = insta::Settings::clone_current();
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.set_snapshot_path("snapshots");
    settings.bind(|| insta::assert_snapshot!(name, text));
}

#[test]
fn forty_situations_at_three_sizes() {
    let all = screens::all();
    assert!(all.len() >= 40, "{}", all.len());
    for (name, begins) in all {
        let pages = SIZES.map(|size| {
            let terminal = emulated(begins(size).state, theme("night", false), Depth::True);
            format!("{}x{}\n{}", size.0, size.1, text(&terminal))
        });
        compare(name, &pages.join("\n"));
    }
}

#[test]
fn ten_of_them_in_every_theme_without_colours_and_in_ascii() {
    for name in PICTURES {
        let (_, begins) = screens::all().into_iter().find(|(other, _)| *other == name).expect(name);
        let plain = text(&emulated(begins(SIZES[0]).state, theme("night", false), Depth::True));
        let mut pages = format!("== text\n{plain}");
        for (look, theme_name, depth, ascii) in LOOKS {
            let terminal = emulated(begins(SIZES[0]).state, theme(theme_name, ascii), depth);
            if ascii {
                let shown = text(&terminal);
                assert!(shown.is_ascii(), "{name}");
                pages.push_str(&format!("== {look} text\n{shown}"));
            } else {
                assert_eq!(text(&terminal), plain, "{name}: nothing depends on colour in {look}");
            }
            pages.push_str(&format!("== {look}\n{}", letters(&terminal)));
        }
        compare(&format!("looks-{name}"), &format!("{pages}== end\n"));
    }
}

#[test]
fn without_colours_no_colour_is_sent() {
    for name in PICTURES {
        let (_, begins) = screens::all().into_iter().find(|(other, _)| *other == name).expect(name);
        for theme_name in ["night", "day", "contrast", "mono"] {
            let terminal = emulated(begins(SIZES[0]).state, theme(theme_name, false), Depth::None);
            let grid = letters(&terminal);
            assert!(!grid.contains("fg=") && !grid.contains("bg="), "{name} {theme_name}");
        }
    }
}
