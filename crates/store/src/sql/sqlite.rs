//! SQLite's side: values bound where they are, rows read where they are, and its errors by what can be done about them.

use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{ErrorCode, ToSql};

use super::{Cell, Error, Kind, Params, Result, Value};
use crate::model::clean;

struct Bound<'a>(Value<'a>);

impl ToSql for Bound<'_> {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match self.0 {
            Value::Null => ValueRef::Null,
            Value::Integer(value) => ValueRef::Integer(value),
            Value::Text(text) => ValueRef::Text(text.as_bytes()),
            Value::Blob(bytes) => ValueRef::Blob(bytes),
        }))
    }
}

pub(super) fn bind(statement: &mut rusqlite::Statement<'_>, values: &impl Params) -> Result<()> {
    if values.count() != statement.parameter_count() {
        let detail = format!("{} values for {} parameters", values.count(), statement.parameter_count());
        return Err(Error::new(Kind::Other, detail));
    }
    for place in 0..values.count() {
        statement.raw_bind_parameter(place + 1, Bound(values.at(place)))?;
    }
    Ok(())
}

pub(super) fn cell<'a>(row: &'a rusqlite::Row<'_>, column: usize) -> Result<Cell<'a>> {
    Ok(match row.get_ref(column)? {
        ValueRef::Null => Cell::Null,
        ValueRef::Integer(value) => Cell::Integer(value),
        ValueRef::Text(bytes) => Cell::Text(bytes),
        ValueRef::Blob(bytes) => Cell::Blob(bytes),
        ValueRef::Real(_) => Cell::Other,
    })
}

/// At most `length` bytes of `ciphertext.bytes` in a row that was just found. Opened as a blob, so that not all pages of a
/// long one are read.
pub(super) fn front(file: &rusqlite::Connection, row: i64, length: usize) -> Result<Vec<u8>> {
    let torn = |error: rusqlite::Error| match error.sqlite_error_code() {
        // It was found in this same moment: pages of the file were altered.
        Some(ErrorCode::Unknown) => Error::new(Kind::Damaged, format!("its index names row {row}, which is not there")),
        _ => error.into(),
    };
    let blob = file.blob_open("main", "ciphertext", "bytes", row, true).map_err(torn)?;
    let mut bytes = vec![0; length.min(blob.len())];
    blob.read_at_exact(&mut bytes, 0)?;
    Ok(bytes)
}

impl From<rusqlite::Error> for Error {
    fn from(error: rusqlite::Error) -> Self {
        let detail = clean(&error.to_string(), 200);
        let is_altered =
            matches!(
                error,
                rusqlite::Error::IntegralValueOutOfRange(..)
                    | rusqlite::Error::InvalidColumnType(..)
                    | rusqlite::Error::FromSqlConversionFailure(..)
                    | rusqlite::Error::Utf8Error(..)
                    | rusqlite::Error::QueryReturnedNoRows
            ) || ["no such table", "no such index", "no such column"].iter().any(|start| detail.starts_with(start));
        let kind = match error.sqlite_error_code() {
            _ if is_altered => Kind::Altered,
            Some(ErrorCode::DiskFull) => Kind::Full,
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => Kind::Damaged,
            Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly | ErrorCode::PermissionDenied) => Kind::Denied,
            _ => Kind::Other,
        };
        Self { kind, detail }
    }
}
