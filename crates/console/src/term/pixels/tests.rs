//! The life of a picture on the screen: placed once, never again with the next frame, removed when it goes.

use std::num::NonZeroU16;

use super::*;
use crate::app::tests::{Robot, fixtures};
use crate::app::update::update;
use crate::app::{Action, Key, Popup, Screen, Tag, Verb};
use crate::ros::readable::Readable;
use crate::service::Reply;
use crate::term::encode::Depth;
use crate::term::renderer::{Painter, Scene, Stage};
use crate::ui::Theme;

/// A picture of every value, each pixel different from its neighbours.
pub(super) fn noise((width, height): (usize, usize), seed: u8) -> Raster {
    let part = |at: usize| u8::try_from(at * 7 % 251).unwrap_or(0) ^ seed;
    Raster { width, height, rgb: (0..width * height * 3).map(part).collect() }
}

/// The console with a record's picture over the list of those shared with it.
fn scene() -> Scene {
    let mut robot = Robot::at_work(true);
    robot.act(Action::Resize { columns: 100, rows: 30 });
    robot.act(Action::Do(Verb::Go(Screen::Received)));
    robot.site_answers(true);
    robot.presses(Key::Enter);
    let readable = Readable { picture: Some(noise((240, 160), 0)), ..Readable::default() };
    let opened = crate::service::reply::OpenedView { readable: Some(readable), ..fixtures::opened(1_000, true) };
    robot.is_answered(&Tag::Open("00000000000003e8".into()), Ok(Reply::Opened(Box::new(opened))));
    let theme = Theme { pixels: true, ..Theme::named("night").expect("embedded") };
    Stage::new(robot.state, theme).into_scene()
}

fn painter(way: Pictures) -> Painter {
    let pixels = Pixels { measure: || (9, 20), ..Pixels::new(way, None) };
    Painter::new(Depth::True, (100, 30)).with_pixels(pixels)
}

fn press(scene: &mut Scene, key: Key) {
    drop(update(&mut scene.state, Action::Key(key)));
}

/// How many pictures are placed and how many removed, in this order, by kitty's commands.
fn commands(bytes: &str) -> Vec<&'static str> {
    let mut found: Vec<(usize, &str)> = bytes.match_indices("\x1b_Ga=T").map(|(at, _)| (at, "put")).collect();
    found.extend(bytes.match_indices(TAKE_AWAY).map(|(at, _)| (at, "away")));
    found.sort_unstable();
    found.into_iter().map(|(_, what)| what).collect()
}

/// Where the one sixel in `bytes` is placed (column and row from 0), itself, and what comes after it.
fn sixel_in(bytes: &str) -> Option<((u16, u16), &str, &str)> {
    let (before, rest) = bytes.split_once("\x1bP")?;
    let end = rest.find("\x1b\\").expect("an end") + 2;
    let place = before.rsplit_once("\x1b7\x1b[").expect("a place").1.strip_suffix('H').expect("a place");
    let (row, column) = place.split_once(';').expect("row and column");
    let (row, column): (u16, u16) = (row.parse().expect("a row"), column.parse().expect("a column"));
    let (sixel, behind) = (&bytes[before.len()..before.len() + 2 + end], &rest[end..]);
    assert!(behind.starts_with("\x1b8") && !behind.contains("\x1bP"), "one sixel, and the cursor back");
    Some(((column - 1, row - 1), sixel, behind))
}

#[test]
fn a_kitty_picture_is_put_once_and_taken_away() {
    let (mut scene, mut painter) = (scene(), painter(Pictures::Kitty));
    let first = painter.paint(&mut scene);
    assert_eq!(commands(&first), ["put"]);
    assert!(!first.contains('▀') && first.len() <= MOST + 6_000, "{}", first.len());
    assert_eq!(painter.paint(&mut scene), "");
    scene.state.complain("words of three lines ".repeat(20));
    let next = painter.paint(&mut scene);
    assert!(next.contains("words") && commands(&next).is_empty(), "messages are clear of it");
    scene.anew = true;
    assert_eq!(commands(&painter.paint(&mut scene)), ["away", "put"]);
    drop(update(&mut scene.state, Action::Resize { columns: 120, rows: 40 }));
    assert_eq!(commands(&painter.paint(&mut scene)), ["away", "put"]);
    press(&mut scene, Key::Tab);
    assert_eq!(commands(&painter.paint(&mut scene)), ["away"], "another face of the record");
    press(&mut scene, Key::BackTab);
    assert_eq!(commands(&painter.paint(&mut scene)), ["put"]);
    scene.theme.ascii = true;
    assert_eq!(commands(&painter.paint(&mut scene)), ["away"]);
    scene.theme.ascii = false;
    assert_eq!(commands(&painter.paint(&mut scene)), ["put"]);
    press(&mut scene, Key::Escape);
    press(&mut scene, Key::Escape);
    assert_eq!(commands(&painter.paint(&mut scene)), ["away"]);
    assert_eq!(painter.paint(&mut scene), "");
}

#[test]
fn another_picture_takes_the_place_of_the_one_before() {
    let (mut scene, mut painter) = (scene(), painter(Pictures::Kitty));
    painter.paint(&mut scene);
    let Some(Popup::Record(opening)) = scene.state.popups.last_mut() else { panic!("no record") };
    let view = opening.lookup.answer.as_mut().expect("answered").as_mut().expect("opened");
    view.readable.as_mut().expect("readable").picture = Some(noise((240, 160), 9));
    assert_eq!(commands(&painter.paint(&mut scene)), ["away", "put"]);
}

#[test]
fn a_sixel_stays_within_its_cells_and_is_written_over_when_it_goes() {
    let (mut scene, mut painter) = (scene(), painter(Pictures::Sixel));
    let first = painter.paint(&mut scene);
    let ((column, row), sixel, _) = sixel_in(&first).expect("one sixel");
    let picture = sixel_tests::decode(sixel);
    assert!(sixel.len() <= MOST && picture.width > 240, "{} bytes, {} wide", sixel.len(), picture.width);
    let cells = |pixels: usize, cell: usize| u16::try_from(pixels.div_ceil(cell)).expect("fits");
    let area = Rect::new(column, row, cells(picture.width, 9), cells(picture.height, 20));
    assert!(area.bottom() <= 26 && area.right() <= 98, "{area:?}");
    let shape = picture.width * 160 / picture.height;
    assert!((238..=242).contains(&shape), "{} x {}", picture.width, picture.height);
    assert_eq!(painter.paint(&mut scene), "");
    scene.state.complain("words of three lines ".repeat(20));
    let next = painter.paint(&mut scene);
    assert!(next.contains("words") && sixel_in(&next).is_none());
    expect_untouched(&next, area);
    scene.anew = true;
    assert!(sixel_in(&painter.paint(&mut scene)).is_some());
    press(&mut scene, Key::Escape);
    press(&mut scene, Key::Escape);
    let gone = painter.paint(&mut scene);
    assert!(sixel_in(&gone).is_none() && !gone.contains("\x1b_G"));
    expect_written(&gone, area);
    assert_eq!(painter.paint(&mut scene), "");
}

/// A screen full of marks, and the effect of `bytes` on it.
fn over_marks(bytes: &str) -> vt100::Parser {
    let size = |cells| NonZeroU16::new(cells).expect("not zero");
    let mut terminal = vt100::Parser::new(size(30), size(100), 0);
    for row in 1..=30 {
        terminal.process(format!("\x1b[{row};1H{}", "\u{2592}".repeat(100)).as_bytes());
    }
    terminal.process(bytes.as_bytes());
    terminal
}

fn marks(bytes: &str, area: Rect) -> usize {
    let terminal = over_marks(bytes);
    let marked = |(x, y)| terminal.screen().cell(y, x).is_some_and(|cell| cell.contents() == "\u{2592}");
    area.positions().filter(|place| marked((place.x, place.y))).count()
}

fn expect_untouched(bytes: &str, area: Rect) {
    assert_eq!(marks(bytes, area), usize::from(area.width) * usize::from(area.height), "written over the picture");
}

fn expect_written(bytes: &str, area: Rect) {
    assert_eq!(marks(bytes, area), 0, "the picture shows through");
}

#[test]
fn without_the_setting_or_colours_nothing_is_put() {
    for (way, depth) in
        [(Pictures::HalfBlocks, Depth::True), (Pictures::Kitty, Depth::None), (Pictures::Sixel, Depth::None)]
    {
        let (mut scene, mut painter) = (scene(), painter(way));
        scene.theme = Theme { depth, pixels: way != Pictures::HalfBlocks, ..scene.theme };
        let bytes = painter.paint(&mut scene);
        assert!(!bytes.contains("\x1b_G") && !bytes.contains("\x1bP"), "{way:?} {depth:?}");
        assert_eq!(bytes.contains('▀'), way == Pictures::HalfBlocks);
        assert_eq!(taking_away(way).is_empty(), way == Pictures::HalfBlocks);
    }
}

#[test]
fn a_slow_line_gets_a_coarser_picture() {
    let placement = Placement { area: Rect::new(2, 3, 60, 20), raster: noise((240, 160), 3) };
    for (way, rate, most) in [
        (Pictures::Kitty, Some(4_000), 32_000),
        (Pictures::Sixel, Some(4_000), 32_000),
        (Pictures::Kitty, Some(500), LEAST),
        (Pictures::Sixel, Some(500), LEAST),
        (Pictures::Sixel, None, MOST),
    ] {
        let change = Pixels { measure: || ASSUMED, ..Pixels::new(way, rate) }.show(Some(placement.clone()));
        let bytes = change.put.len();
        assert!(bytes <= most + 32 && bytes >= most / 3, "{way:?} {rate:?}: {bytes}");
        assert!(change.put.starts_with("\x1b7\x1b[4;3H\x1b") && change.put.ends_with("\x1b\\\x1b8"));
    }
}

#[test]
fn a_cell_is_as_large_as_the_kernel_says_if_that_can_be() {
    let window = |width, height| WindowSize { columns: 100, rows: 30, width, height };
    assert_eq!(cell_of(&window(900, 620)), Some((9, 20)));
    for wrong in [window(0, 0), window(900, 0), window(300, 620), window(u16::MAX, 620)] {
        assert_eq!(cell_of(&wrong), None);
    }
    assert_eq!(cell_of(&WindowSize { columns: 0, rows: 0, width: 900, height: 600 }), None);
}

#[test]
fn a_picture_fills_its_cells_with_its_shape_kept() {
    let filled = |size, room| filled(&noise(size, 0), room);
    assert_eq!(filled((240, 160), (240, 160)), (240, 160));
    assert_eq!(filled((120, 80), (250, 160)), (240, 160));
    assert_eq!(filled((100, 1), (800, 16)), (800, 8));
    assert_eq!(filled((1, 100), (8, 800)), (8, 800));
    assert_eq!(filled((0, 0), (8, 16)), (8, 8));
}

fn shown(way: Pictures, measure: Measure) -> String {
    let placement = Placement { area: Rect::new(0, 0, 60, 20), raster: noise((240, 160), 0) };
    Pixels { measure, ..Pixels::new(way, None) }.show(Some(placement)).put
}

#[test]
fn cells_of_any_shape_leave_the_picture_its_own() {
    let cases: [(Measure, &str); 3] =
        [(|| (8, 16), ",c=60,r=20,"), (|| (8, 20), ",c=60,r=16,"), (|| (8, 12), ",c=45,r=20,")];
    for (measure, wanted) in cases {
        let put = shown(Pictures::Kitty, measure);
        assert!(put.contains(wanted), "{wanted} in {}", &put[..90]);
    }
    let put = shown(Pictures::Sixel, || (30, 60));
    assert!(put.contains("\"1;1;1000;666#"), "xterm shows no larger one: {}", &put[..60]);
}

#[test]
fn a_wide_character_at_the_edge_is_written_whole() {
    let mut buffer = Buffer::empty(Rect::new(0, 0, 8, 1));
    buffer.set_string(1, 0, "机a机", ratatui::style::Style::default());
    let found = cells(&buffer, Rect::new(2, 0, 3, 1));
    let found: Vec<(u16, &str)> = found.iter().map(|(x, _, cell)| (*x, cell.symbol())).collect();
    assert_eq!(found, [(1, "机"), (3, "a"), (4, "机")]);
}
