//! Tables: a title line, column heads, and the page of rows that contains the cursor.

use ratatui::layout::{Position, Rect};

use super::canvas::{Canvas, below, columns, right_of, row};
use super::theme::Role;
use crate::app::{Screen, State, Table};
use crate::popups::columns::state::wanted;

/// Greatest width of a name column.
const WIDEST_NAME: u16 = 56;
/// What chosen columns leave of it.
const LEAST_NAME: u16 = 12;

#[derive(Debug, Clone, Copy)]
pub struct Column {
    pub title: &'static str,
    /// In `:columns`; empty = cannot be chosen.
    pub name: &'static str,
    /// 0 = what is left (one column of a table).
    pub width: u16,
    pub most: u16,
    pub right: bool,
    /// Terminal width from which it shows.
    pub from: u16,
    /// Terminal width below which it shows.
    pub below: u16,
}

impl Column {
    /// Takes what is left, up to `WIDEST_NAME`; carries the cursor.
    pub const fn name(title: &'static str) -> Self {
        Self { title, name: "", width: 0, most: WIDEST_NAME, right: false, from: 0, below: u16::MAX }
    }

    /// Takes all that is left; carries the cursor.
    pub const fn wide(title: &'static str) -> Self {
        Self { title, name: "", width: 0, most: u16::MAX, right: false, from: 0, below: u16::MAX }
    }

    pub const fn text(title: &'static str, width: u16) -> Self {
        Self { title, name: "", width, most: width, right: false, from: 0, below: u16::MAX }
    }

    pub const fn number(title: &'static str, width: u16) -> Self {
        Self { title, name: "", width, most: width, right: true, from: 0, below: u16::MAX }
    }

    /// Can be chosen by that name.
    pub const fn named(mut self, name: &'static str) -> Self {
        self.name = name;
        self
    }

    pub const fn below(mut self, columns: u16) -> Self {
        self.below = columns;
        self
    }

    fn is_shown(&self, whole: u16) -> bool {
        self.from <= whole && whole < self.below
    }

    pub const fn from(mut self, columns: u16) -> Self {
        self.from = columns;
        self
    }
}

/// Makes room for the local time if it is shown.
pub fn with_local_time(columns: &[Column], state: &State) -> Vec<Column> {
    let wide = |column: &Column| match column.title {
        "UTC" if state.local_time => Column { title: "UTC      local", width: 17, most: 17, ..*column },
        _ => *column,
    };
    columns.iter().map(wide).collect()
}

pub struct Layout {
    pub columns: Vec<Column>,
    /// Index of each among all columns of the list.
    places: Vec<usize>,
    /// Chosen ones without room.
    pub left_out: Vec<&'static str>,
}

impl Layout {
    /// The chosen columns that fit into `width`, or the usual ones; unnamed columns follow.
    pub fn new(all: &[Column], screen: Screen, table: &Table, width: u16) -> Self {
        let marks = all.iter().filter(|column| column.name.is_empty() && column.is_shown(width));
        let taken: u16 = marks.map(|column| column.width + 1).sum();
        let mut room = width.saturating_sub(GUTTER + taken + LEAST_NAME + 1);
        let mut layout = Self { columns: Vec::new(), places: Vec::new(), left_out: Vec::new() };
        for name in wanted(screen, table, width) {
            let Some((place, column)) = all.iter().enumerate().find(|(_, column)| column.name == name) else {
                continue;
            };
            let usual = table.columns.is_empty();
            if usual || column.width == 0 || column.width < room {
                room = room.saturating_sub(if column.width == 0 { 0 } else { column.width + 1 });
                layout.columns.push(*column);
                layout.places.push(place);
            } else {
                layout.left_out.push(name);
            }
        }
        for (place, column) in all.iter().enumerate().filter(|(_, column)| column.name.is_empty()) {
            layout.columns.push(*column);
            layout.places.push(place);
        }
        layout
    }

    /// Picks from the cells of all columns.
    pub fn pick(&self, mut cells: Vec<(String, Role)>) -> Vec<(String, Role)> {
        self.places.iter().map(|place| cells.get_mut(*place).map(std::mem::take).unwrap_or_default()).collect()
    }

    /// Names chosen columns without room.
    pub fn note(&self) -> String {
        match self.left_out.as_slice() {
            [] => String::new(),
            names => format!(", no room for {}", names.join(" ")),
        }
    }
}

/// With an arrow for the direction.
pub fn order(screen: Screen, table: &Table) -> String {
    let orders = screen.orders();
    let name = orders.get(table.sort).or(orders.first()).copied().unwrap_or_default();
    if table.reversed { format!("{name} ↑") } else { format!("{name} ↓") }
}

pub struct Sheet<'a> {
    pub title: &'a str,
    pub note: String,
    pub columns: &'a [Column],
    pub keys: &'a [String],
    /// Called only for rows on screen.
    pub cells: &'a dyn Fn(usize) -> Vec<(String, Role)>,
    pub table: &'a Table,
    /// Shown without rows.
    pub empty: &'a str,
    /// Rows older than the heading says.
    pub old: bool,
}

pub fn draw(canvas: &mut Canvas, area: Rect, sheet: &Sheet) {
    draw_title(canvas, row(area, 0), sheet);
    let widths = widths(sheet.columns, area.width);
    draw_cells(canvas, row(area, 1), sheet.columns, &widths, |column| (column.title.to_owned(), Role::Title));
    let body = below(area, 2);
    if sheet.keys.is_empty() {
        canvas.put_wrapped(right_of(body, GUTTER), sheet.empty, Role::Dim);
        return;
    }
    let height = usize::from(body.height.max(1));
    let position = sheet.table.position(sheet.keys);
    let first = position - position % height;
    for (line, index) in (0u16..).zip((first..sheet.keys.len()).take(height)) {
        draw_row(canvas, row(body, line), sheet, &widths, index, index == position);
    }
}

/// Without a cursor.
pub fn draw_plain(canvas: &mut Canvas, area: Rect, columns: &[Column], rows: Vec<Vec<(String, Role)>>) {
    let widths = widths(columns, area.width);
    draw_cells(canvas, row(area, 0), columns, &widths, |column| (column.title.to_owned(), Role::Title));
    for (line, cells) in (1u16..area.height).zip(rows) {
        let mut cells = cells.into_iter();
        draw_cells(canvas, row(area, line), columns, &widths, |_| cells.next().unwrap_or_default());
    }
}

/// Cursor and mark, before the first cell.
const GUTTER: u16 = 2;

fn draw_title(canvas: &mut Canvas, area: Rect, sheet: &Sheet) {
    let mut rest = canvas.puts(area, &[(sheet.title, Role::Title), ("  ", Role::Body)]);
    let filter = &sheet.table.filter;
    // The filter is never cut for the note.
    if sheet.table.filtering || !filter.text().is_empty() {
        rest = canvas.puts(rest, &[("filter: ", Role::Accent)]);
        if sheet.table.filtering {
            let before: String = filter.text().chars().take(filter.cursor()).collect();
            let x = (rest.x + columns(&before)).min(area.right().saturating_sub(1));
            canvas.cursor = Some(Position { x, y: rest.y });
        }
        let selected = sheet.table.filtering && filter.is_offered();
        let role = if selected { Role::Selection } else { Role::Accent };
        // While typed, it has the line; afterwards half of it.
        let most = if sheet.table.filtering { rest.width } else { area.width / 2 };
        let place = Rect { width: most.min(rest.width), ..rest };
        rest = right_of(rest, canvas.put(place, filter.text(), role) + 2);
    }
    canvas.put(rest, &sheet.note, Role::Dim);
}

/// Rows this long are hard to follow from one end.
const LONG_FROM: u16 = 100;

fn draw_row(canvas: &mut Canvas, area: Rect, sheet: &Sheet, widths: &[u16], index: usize, here: bool) {
    let marked = sheet.keys.get(index).is_some_and(|key| sheet.table.marks.contains(key));
    canvas.puts(area, &[(if here { "▌" } else { " " }, Role::Body), (if marked { "✓" } else { " " }, Role::Body)]);
    let cells = (sheet.cells)(index);
    // Highlights both ends of a long row to guide the eye; all of it would cost too many bytes.
    let shown = |((text, _), width): (&(String, Role), &u16)| *width > 0 && !text.is_empty();
    let last = cells.iter().zip(widths).rposition(shown).filter(|_| area.width >= LONG_FROM);
    let mut cells = cells.into_iter().enumerate();
    draw_cells(canvas, area, sheet.columns, widths, |column| {
        let (place, (text, role)) = cells.next().unwrap_or_default();
        let role = if sheet.old { Role::Dim } else { role };
        (text, if here && (column.width == 0 || Some(place) == last) { Role::Selection } else { role })
    });
}

fn draw_cells(
    canvas: &mut Canvas,
    area: Rect,
    columns: &[Column],
    widths: &[u16],
    mut cell: impl FnMut(&Column) -> (String, Role),
) {
    let mut rest = right_of(area, GUTTER);
    for (column, width) in columns.iter().zip(widths) {
        let (text, role) = cell(column);
        if *width == 0 {
            continue;
        }
        let place = Rect { width: (*width).min(rest.width), ..rest };
        if column.right {
            canvas.put_right(place, &text, role)
        } else {
            canvas.put(place, &text, role)
        };
        rest = right_of(rest, *width + 1);
    }
}

/// 0 = not shown.
fn widths(columns: &[Column], whole: u16) -> Vec<u16> {
    let shown = |column: &Column| column.is_shown(whole);
    let fixed: u16 = columns.iter().filter(|column| shown(column)).map(|column| column.width + 1).sum();
    let left = whole.saturating_sub(GUTTER + fixed).max(8);
    let width = |column: &Column| match (shown(column), column.width) {
        (false, _) => 0,
        (true, 0) => left.min(column.most),
        (true, width) => width,
    };
    columns.iter().map(width).collect()
}
