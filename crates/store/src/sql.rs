//! The stores' only way to a database: SQL with numbered parameters (`?1`), with values, rows and errors of its own. Two
//! engines are behind it, an SQLite file and a PostgreSQL server; no store names either.

mod connection;
mod dialect;
pub(crate) mod postgres;
mod row;
mod sqlite;

pub(crate) use self::connection::{Connection, Statement};
pub(crate) use self::row::{Cell, Row};

pub(crate) type Result<T> = std::result::Result<T, Error>;

/// What a caller may do about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A value, row, table or index is not as this program writes it.
    Altered,
    /// No room is left.
    Full,
    /// The file is damaged, or no database.
    Damaged,
    /// The file may not be opened or written.
    Denied,
    /// A text has a NUL character, which PostgreSQL cannot store.
    Nul,
    /// A conflict with another transaction: the same work succeeds later.
    Conflict,
    /// The server takes no writes: it is a standby, or its user may only read.
    Standby,
    /// The connection ended.
    Broken,
    /// Nobody knows whether a commit took place, or survives.
    Unknown,
    /// The server refuses the user, or what the user asks.
    Refused(Refusal),
    /// The server has as many connections as it takes.
    Crowded,
    Other,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// Of user and password, or of this machine.
    Login,
    /// There is no such database.
    Database,
    /// The database has tables of another program.
    Taken,
    Rights,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Error {
    pub kind: Kind,
    pub detail: String,
}

impl Error {
    pub fn new(kind: Kind, detail: impl Into<String>) -> Self {
        Self { kind, detail: detail.into() }
    }

    pub fn altered(column: usize, detail: &str) -> Self {
        Self::new(Kind::Altered, format!("column {column} {detail}"))
    }

    /// A query that must have a row has none.
    pub fn missing() -> Self {
        Self::new(Kind::Altered, "a row is missing")
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.detail)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Value<'a> {
    Null,
    Integer(i64),
    Text(&'a str),
    Blob(&'a [u8]),
}

pub(crate) trait ToValue {
    fn value(&self) -> Value<'_>;
}

impl ToValue for Value<'_> {
    fn value(&self) -> Value<'_> {
        *self
    }
}

impl<T: ToValue + ?Sized> ToValue for &T {
    fn value(&self) -> Value<'_> {
        (**self).value()
    }
}

impl<T: ToValue> ToValue for Option<T> {
    fn value(&self) -> Value<'_> {
        self.as_ref().map_or(Value::Null, ToValue::value)
    }
}

macro_rules! integers {
    ($($integer:ty),*) => {
        $(impl ToValue for $integer {
            fn value(&self) -> Value<'_> {
                Value::Integer(i64::from(*self))
            }
        })*
    };
}

integers!(bool, u8, i32, u32, i64);

impl ToValue for str {
    fn value(&self) -> Value<'_> {
        Value::Text(self)
    }
}

impl ToValue for String {
    fn value(&self) -> Value<'_> {
        Value::Text(self)
    }
}

impl ToValue for [u8] {
    fn value(&self) -> Value<'_> {
        Value::Blob(self)
    }
}

impl<const N: usize> ToValue for [u8; N] {
    fn value(&self) -> Value<'_> {
        Value::Blob(self)
    }
}

impl ToValue for Vec<u8> {
    fn value(&self) -> Value<'_> {
        Value::Blob(self)
    }
}

/// The values of a statement's parameters; nothing is copied to hand them over.
pub(crate) trait Params {
    fn count(&self) -> usize;
    /// From 0; NULL beyond the last.
    fn at(&self, place: usize) -> Value<'_>;
}

impl<P: Params + ?Sized> Params for &P {
    fn count(&self) -> usize {
        (**self).count()
    }

    fn at(&self, place: usize) -> Value<'_> {
        (**self).at(place)
    }
}

impl Params for [&dyn ToValue] {
    fn count(&self) -> usize {
        self.len()
    }

    fn at(&self, place: usize) -> Value<'_> {
        self.get(place).map_or(Value::Null, |value| value.value())
    }
}

impl Params for [&dyn ToValue; 0] {
    fn count(&self) -> usize {
        0
    }

    fn at(&self, _place: usize) -> Value<'_> {
        Value::Null
    }
}

impl Params for Vec<Value<'_>> {
    fn count(&self) -> usize {
        self.len()
    }

    fn at(&self, place: usize) -> Value<'_> {
        self.get(place).copied().unwrap_or(Value::Null)
    }
}

impl Params for Option<Value<'_>> {
    fn count(&self) -> usize {
        usize::from(self.is_some())
    }

    fn at(&self, _place: usize) -> Value<'_> {
        self.unwrap_or(Value::Null)
    }
}

// Not for every length: `[]` would have no type.
macro_rules! arrays {
    ($($length:literal),*) => {
        $(impl<T: ToValue> Params for [T; $length] {
            fn count(&self) -> usize {
                $length
            }

            fn at(&self, place: usize) -> Value<'_> {
                self.get(place).map_or(Value::Null, ToValue::value)
            }
        })*
    };
}

arrays!(1, 2, 3, 4, 5, 6, 7, 8);

macro_rules! tuples {
    ($(($($name:ident $place:tt),*))*) => {
        $(impl<$($name: ToValue),*> Params for ($($name,)*) {
            fn count(&self) -> usize {
                [$($place),*].len()
            }

            fn at(&self, place: usize) -> Value<'_> {
                match place {
                    $($place => self.$place.value(),)*
                    _ => Value::Null,
                }
            }
        })*
    };
}

tuples! {
    (A 0, B 1)
    (A 0, B 1, C 2)
    (A 0, B 1, C 2, D 3)
    (A 0, B 1, C 2, D 3, E 4)
    (A 0, B 1, C 2, D 3, E 4, F 5)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7)
}

/// Values of different types.
macro_rules! params {
    ($($value:expr),* $(,)?) => {
        &[$(&$value as &dyn $crate::sql::ToValue),*] as &[&dyn $crate::sql::ToValue]
    };
}
pub(crate) use params;

#[cfg(test)]
mod tests {
    use super::*;

    fn all(values: &impl Params) -> Vec<Value<'_>> {
        (0..=values.count()).map(|place| values.at(place)).collect()
    }

    #[test]
    fn values_are_handed_over_in_order_and_null_follows_the_last() {
        let (name, none) = ("a".to_owned(), None::<i64>);
        let expected = [Value::Integer(1), Value::Text("a"), Value::Null, Value::Blob(&[7; 2]), Value::Null];
        assert_eq!(all(&params![true, name, none, [7u8; 2]]), expected);
        assert_eq!(all(&(1u8, "a", none, vec![7u8; 2])), expected);
        assert_eq!(all(&[Some(3i64), None]), [Value::Integer(3), Value::Null, Value::Null]);
        assert_eq!((all(&[]), all(&Some(Value::Text("x"))).len()), (vec![Value::Null], 2));
    }
}
