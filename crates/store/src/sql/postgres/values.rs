//! Values and cells as PostgreSQL's binary format has them.

use std::error::Error as StdError;

use bytes::{BufMut as _, BytesMut};
use tokio_postgres::types::{FromSql, IsNull, ToSql, Type};

use crate::sql::{Cell, Error, Result, Value};

type Fault = Box<dyn StdError + Sync + Send>;

/// Of the type that the server expects there.
#[derive(Debug)]
pub(super) struct Bound<'a>(pub Value<'a>);

pub(super) fn has_nul(value: Value<'_>) -> bool {
    matches!(value, Value::Text(text) if text.contains('\0'))
}

impl ToSql for Bound<'_> {
    fn to_sql(&self, of: &Type, out: &mut BytesMut) -> std::result::Result<IsNull, Fault> {
        match self.0 {
            Value::Null => return Ok(IsNull::Yes),
            Value::Integer(value) if *of == Type::INT8 => out.put_i64(value),
            Value::Integer(value) if *of == Type::INT4 => out.put_i32(value.try_into()?),
            Value::Integer(value) if *of == Type::INT2 => out.put_i16(value.try_into()?),
            Value::Integer(value) if *of == Type::BOOL => out.put_u8(u8::from(value != 0)),
            Value::Text(text) if *of == Type::TEXT => out.put_slice(text.as_bytes()),
            Value::Blob(bytes) if *of == Type::BYTEA => out.put_slice(bytes),
            Value::Integer(_) | Value::Text(_) | Value::Blob(_) => {
                return Err(format!("the statement expects a {of}").into());
            }
        }
        Ok(IsNull::No)
    }

    fn accepts(_of: &Type) -> bool {
        true
    }

    fn to_sql_checked(&self, of: &Type, out: &mut BytesMut) -> std::result::Result<IsNull, Fault> {
        self.to_sql(of, out)
    }
}

struct Found<'a>(Cell<'a>);

impl<'a> FromSql<'a> for Found<'a> {
    fn from_sql(of: &Type, raw: &'a [u8]) -> std::result::Result<Self, Fault> {
        let number = match *of {
            Type::INT8 => Some(i64::from_be_bytes(raw.try_into()?)),
            Type::INT4 => Some(i32::from_be_bytes(raw.try_into()?).into()),
            Type::INT2 => Some(i16::from_be_bytes(raw.try_into()?).into()),
            Type::BOOL => Some(raw.iter().any(|byte| *byte != 0).into()),
            Type::NUMERIC => whole(raw),
            _ => None,
        };
        Ok(Self(match (number, of) {
            (Some(number), _) => Cell::Integer(number),
            (None, of) if *of == Type::TEXT => Cell::Text(raw),
            (None, of) if *of == Type::BYTEA => Cell::Blob(raw),
            (None, _) => Cell::Other,
        }))
    }

    fn from_sql_null(_of: &Type) -> std::result::Result<Self, Fault> {
        Ok(Self(Cell::Null))
    }

    fn accepts(_of: &Type) -> bool {
        true
    }
}

/// The type of sums of BIGINT: digits to the base of 10,000. `None` for a fraction, or beyond 2^63 - 1.
fn whole(raw: &[u8]) -> Option<i64> {
    let mut words = raw.chunks_exact(2).filter_map(|pair| Some(i16::from_be_bytes(pair.try_into().ok()?)));
    let (count, weight, sign, _scale) = (words.next()?, words.next()?, words.next()?, words.next()?);
    let digits: Vec<i16> = words.collect();
    if count > weight.checked_add(1)? && digits.iter().skip(usize::try_from(weight + 1).ok()?).any(|digit| *digit != 0)
    {
        return None;
    }
    let digit = |place: i16| digits.get(usize::try_from(place).ok()?).copied();
    let value = (0..=weight)
        .try_fold(0_i64, |value, place| value.checked_mul(10_000)?.checked_add(digit(place).unwrap_or(0).into()))?;
    match sign {
        0 => Some(value),
        0x4000 => value.checked_neg(),
        _ => None,
    }
}

pub(in crate::sql) fn cell(row: &tokio_postgres::Row, column: usize) -> Result<Cell<'_>> {
    let found: Found<'_> = row.try_get(column).map_err(|error| Error::altered(column, &error.to_string()))?;
    Ok(found.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numeric(weight: i16, sign: u16, digits: &[i16]) -> Vec<u8> {
        let count = i16::try_from(digits.len()).expect("few").to_be_bytes();
        let head = [count, weight.to_be_bytes(), sign.to_be_bytes(), [0, 0]];
        head.into_iter().chain(digits.iter().map(|digit| digit.to_be_bytes())).flatten().collect()
    }

    #[test]
    fn sums_are_read_unless_they_are_fractions_or_too_large() {
        for (weight, sign, digits, value) in [
            (0, 0, &[][..], Some(0)),
            (0, 0, &[7][..], Some(7)),
            (1, 0, &[12, 3456][..], Some(123_456)),
            (2, 0, &[5][..], Some(500_000_000)),
            (0, 0x4000, &[41][..], Some(-41)),
            (4, 0, &[922, 3372, 368, 5477, 5807][..], Some(i64::MAX)),
            (4, 0, &[922, 3372, 368, 5477, 5808][..], None),
            (-1, 0, &[5000][..], None),
            (0, 0xc000, &[][..], None),
        ] {
            assert_eq!(whole(&numeric(weight, sign, digits)), value, "{digits:?}");
        }
    }

    #[test]
    fn a_number_goes_where_it_fits() {
        let sent = |value, of: &Type| {
            let mut out = BytesMut::new();
            Bound(value).to_sql(of, &mut out).map(|_| out.to_vec()).ok()
        };
        assert_eq!(sent(Value::Integer(258), &Type::INT8), Some(vec![0, 0, 0, 0, 0, 0, 1, 2]));
        assert_eq!(
            (sent(Value::Integer(258), &Type::INT2), sent(Value::Integer(70_000), &Type::INT2)),
            (Some(vec![1, 2]), None)
        );
        assert_eq!((sent(Value::Integer(1), &Type::BOOL), sent(Value::Text("1"), &Type::INT8)), (Some(vec![1]), None));
        assert!(has_nul(Value::Text("a\0b")) && !has_nul(Value::Blob(&[0])));
    }
}
