//! Tables: a title line, column heads, and the page of rows that contains the cursor.

use ratatui::layout::Rect;

use super::theme::Role;
use super::{Canvas, below, columns, right_of, row};
use crate::app::choosing::wanted;
use crate::app::table::Table;
use crate::app::{Screen, State};

/// The greatest width of a column of names.
const WIDEST_NAME: u16 = 56;
/// What chosen columns leave of it at least.
const LEAST_NAME: u16 = 12;

#[derive(Debug, Clone, Copy)]
pub struct Column {
    pub title: &'static str,
    /// Its name in `:columns`; empty = it cannot be chosen.
    pub name: &'static str,
    /// Its width; 0 = what is left (one column of a table).
    pub width: u16,
    pub most: u16,
    /// Whether it is right-aligned.
    pub right: bool,
    /// The terminal width from which it is shown, columns.
    pub from: u16,
    /// Shown only below this terminal width, columns.
    pub below: u16,
}

impl Column {
    /// A column of names that takes what is left, up to `WIDEST_NAME`; it carries the cursor.
    pub const fn name(title: &'static str) -> Self {
        Self { title, name: "", width: 0, most: WIDEST_NAME, right: false, from: 0, below: u16::MAX }
    }

    /// A column that takes all that is left; it carries the cursor.
    pub const fn wide(title: &'static str) -> Self {
        Self { title, name: "", width: 0, most: u16::MAX, right: false, from: 0, below: u16::MAX }
    }

    /// A column of words.
    pub const fn text(title: &'static str, width: u16) -> Self {
        Self { title, name: "", width, most: width, right: false, from: 0, below: u16::MAX }
    }

    /// A column of numbers.
    pub const fn number(title: &'static str, width: u16) -> Self {
        Self { title, name: "", width, most: width, right: true, from: 0, below: u16::MAX }
    }

    /// The same, to be chosen by that name; its width says when it is usual.
    pub const fn named(mut self, name: &'static str) -> Self {
        self.name = name;
        self
    }

    /// The same, only on terminals with fewer columns.
    pub const fn below(mut self, columns: u16) -> Self {
        self.below = columns;
        self
    }

    fn is_shown(&self, whole: u16) -> bool {
        self.from <= whole && whole < self.below
    }

    /// The same, only on terminals with at least this many columns.
    pub const fn from(mut self, columns: u16) -> Self {
        self.from = columns;
        self
    }
}

/// The same columns, with times wide enough for the local time if that is shown.
pub fn with_local_time(columns: &[Column], state: &State) -> Vec<Column> {
    let wide = |column: &Column| match column.title {
        "UTC" if state.local_time => Column { title: "UTC      local", width: 17, most: 17, ..*column },
        _ => *column,
    };
    columns.iter().map(wide).collect()
}

/// The columns of a list as they are shown.
pub struct Layout {
    /// The columns, in order.
    pub columns: Vec<Column>,
    /// The place of each among all columns of the list.
    places: Vec<usize>,
    /// Names of the chosen ones for which there is no room.
    pub left_out: Vec<&'static str>,
}

impl Layout {
    /// The chosen columns of a list that fit into `width`, or its usual ones; columns that cannot be chosen follow.
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

    /// The cells of a row, of those of all columns.
    pub fn pick(&self, mut cells: Vec<(String, Role)>) -> Vec<(String, Role)> {
        self.places.iter().map(|place| cells.get_mut(*place).map(std::mem::take).unwrap_or_default()).collect()
    }

    /// Whether the column of that name is shown.
    pub fn has(&self, name: &str) -> bool {
        self.columns.iter().any(|column| column.name == name)
    }

    /// What the title says of chosen columns that have no room; empty if all have.
    pub fn note(&self) -> String {
        match self.left_out.as_slice() {
            [] => String::new(),
            names => format!(", no room for {}", names.join(" ")),
        }
    }
}

/// The sort column of a table, with an arrow if its order is reversed.
pub fn order(screen: Screen, table: &Table) -> String {
    let orders = screen.orders();
    let name = orders.get(table.sort).or(orders.first()).copied().unwrap_or_default();
    if table.reversed { format!("{name} ↑") } else { format!("{name} ↓") }
}

pub struct Sheet<'a> {
    /// Left part of the title line.
    pub title: &'a str,
    /// The rest of the title line.
    pub note: String,
    pub columns: &'a [Column],
    /// Keys of all rows, in order.
    pub keys: &'a [String],
    /// The cells of a row; called only for rows on screen.
    pub cells: &'a dyn Fn(usize) -> Vec<(String, Role)>,
    pub table: &'a Table,
    /// Shown if there are no rows.
    pub empty: &'a str,
    /// Whether the rows are older than the heading says.
    pub old: bool,
}

pub fn draw(canvas: &mut Canvas, area: Rect, sheet: &Sheet) {
    draw_title(canvas, row(area, 0), sheet);
    let widths = widths(sheet.columns, area.width);
    draw_cells(canvas, row(area, 1), sheet.columns, &widths, |column| (column.title.to_owned(), Role::Title));
    let body = below(area, 2);
    if sheet.keys.is_empty() {
        canvas.put(right_of(body, GUTTER), sheet.empty, Role::Dim);
        return;
    }
    let height = usize::from(body.height.max(1));
    let position = sheet.table.position(sheet.keys);
    let first = position - position % height;
    for (line, index) in (0u16..).zip((first..sheet.keys.len()).take(height)) {
        draw_row(canvas, row(body, line), sheet, &widths, index, index == position);
    }
}

/// Draws column heads and rows without a cursor.
pub fn draw_plain(canvas: &mut Canvas, area: Rect, columns: &[Column], rows: Vec<Vec<(String, Role)>>) {
    let widths = widths(columns, area.width);
    draw_cells(canvas, row(area, 0), columns, &widths, |column| (column.title.to_owned(), Role::Title));
    for (line, cells) in (1u16..area.height).zip(rows) {
        let mut cells = cells.into_iter();
        draw_cells(canvas, row(area, line), columns, &widths, |_| cells.next().unwrap_or_default());
    }
}

/// Columns before the first cell: cursor and mark.
const GUTTER: u16 = 2;

fn draw_title(canvas: &mut Canvas, area: Rect, sheet: &Sheet) {
    let mut rest = canvas.puts(area, &[(sheet.title, Role::Title), ("  ", Role::Body)]);
    let filter = &sheet.table.filter;
    // What narrows the list is never cut for what is said about it.
    if sheet.table.filtering || !filter.text().is_empty() {
        rest = canvas.puts(rest, &[("filter: ", Role::Accent)]);
        if sheet.table.filtering {
            let before: String = filter.text().chars().take(filter.cursor()).collect();
            canvas.set_cursor((rest.x + columns(&before)).min(area.right().saturating_sub(1)), rest.y);
        }
        let selected = sheet.table.filtering && filter.is_offered();
        let role = if selected { Role::Selection } else { Role::Accent };
        // While it is typed it has the line; afterwards half of it.
        let most = if sheet.table.filtering { rest.width } else { area.width / 2 };
        let place = Rect { width: most.min(rest.width), ..rest };
        rest = right_of(rest, canvas.put(place, filter.text(), role) + 2);
    }
    canvas.put(rest, &sheet.note, Role::Dim);
}

/// Columns from which a row is too long to be followed from one end.
const LONG_FROM: u16 = 100;

fn draw_row(canvas: &mut Canvas, area: Rect, sheet: &Sheet, widths: &[u16], index: usize, here: bool) {
    let marked = sheet.keys.get(index).is_some_and(|key| sheet.table.marks.contains(key));
    canvas.puts(area, &[(if here { "▌" } else { " " }, Role::Body), (if marked { "✓" } else { " " }, Role::Body)]);
    let cells = (sheet.cells)(index);
    // Both ends of a long row are lit, so that the eye finds the way across; all of it would cost too many bytes.
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

/// The width of each column; 0 = not shown.
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
