//! A row of an answer, of either engine. What is read must be of the type that was written; nothing is converted.

use super::{Error, Result, postgres, sqlite};

/// A row's value, where the engine has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cell<'a> {
    Null,
    Integer(i64),
    /// UTF-8, unless it was altered.
    Text(&'a [u8]),
    Blob(&'a [u8]),
    /// Of a type that no column of this program has.
    Other,
}

impl Cell<'_> {
    fn word(self) -> &'static str {
        match self {
            Self::Null => "NULL",
            Self::Integer(_) => "a number",
            Self::Text(_) => "a text",
            Self::Blob(_) => "bytes",
            Self::Other => "of another type",
        }
    }
}

pub(crate) enum Row<'a> {
    Sqlite(&'a rusqlite::Row<'a>),
    Postgres(&'a tokio_postgres::Row),
}

impl Row<'_> {
    pub fn get<T: FromCell>(&self, column: usize) -> Result<T> {
        let cell = self.cell(column)?;
        T::from_cell(cell).ok_or_else(|| Error::altered(column, &format!("is {}, not {}", cell.word(), T::WHAT)))
    }

    pub fn cell(&self, column: usize) -> Result<Cell<'_>> {
        match self {
            Self::Sqlite(row) => sqlite::cell(row, column),
            Self::Postgres(row) => postgres::cell(row, column),
        }
    }
}

pub(crate) trait FromCell: Sized {
    /// For people.
    const WHAT: &'static str;

    /// `None` for another type.
    fn from_cell(cell: Cell<'_>) -> Option<Self>;
}

macro_rules! integers {
    ($($integer:ty),*) => {
        $(impl FromCell for $integer {
            const WHAT: &'static str = "a number of its column";

            fn from_cell(cell: Cell<'_>) -> Option<Self> {
                let Cell::Integer(value) = cell else { return None };
                value.try_into().ok()
            }
        })*
    };
}

integers!(u8, u32, i64);

impl FromCell for bool {
    const WHAT: &'static str = "a truth value";

    fn from_cell(cell: Cell<'_>) -> Option<Self> {
        let Cell::Integer(value) = cell else { return None };
        Some(value != 0)
    }
}

impl FromCell for String {
    const WHAT: &'static str = "a text";

    fn from_cell(cell: Cell<'_>) -> Option<Self> {
        let Cell::Text(bytes) = cell else { return None };
        std::str::from_utf8(bytes).ok().map(str::to_owned)
    }
}

impl FromCell for Vec<u8> {
    const WHAT: &'static str = "bytes";

    fn from_cell(cell: Cell<'_>) -> Option<Self> {
        let Cell::Blob(bytes) = cell else { return None };
        Some(bytes.to_vec())
    }
}

impl<const N: usize> FromCell for [u8; N] {
    const WHAT: &'static str = "bytes of its column's length";

    fn from_cell(cell: Cell<'_>) -> Option<Self> {
        let Cell::Blob(bytes) = cell else { return None };
        bytes.try_into().ok()
    }
}

impl<T: FromCell> FromCell for Option<T> {
    const WHAT: &'static str = T::WHAT;

    fn from_cell(cell: Cell<'_>) -> Option<Self> {
        match cell {
            Cell::Null => Some(None),
            cell => T::from_cell(cell).map(Some),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_is_read_as_what_it_is_and_nothing_is_converted() {
        assert_eq!(u8::from_cell(Cell::Integer(255)), Some(255));
        assert_eq!([u8::from_cell(Cell::Integer(256)), u8::from_cell(Cell::Text(b"1"))], [None, None]);
        assert_eq!(Option::<i64>::from_cell(Cell::Null), Some(None));
        assert_eq!((i64::from_cell(Cell::Null), Vec::<u8>::from_cell(Cell::Text(b"x"))), (None, None));
        assert_eq!(<[u8; 2]>::from_cell(Cell::Blob(&[1, 2])), Some([1, 2]));
        assert_eq!((<[u8; 2]>::from_cell(Cell::Blob(&[1])), String::from_cell(Cell::Text(&[0xff]))), (None, None));
    }
}
