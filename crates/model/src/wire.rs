//! Encoding and parsing of fixed-order binary structures, big endian, with bounded lengths.

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    #[error("the data ends before the {0}")]
    Short(&'static str),
    #[error("{0} bytes are left over after the end")]
    Long(usize),
    #[error("{}", value_text(.0))]
    Value(&'static str),
}

fn value_text(field: &str) -> String {
    match field {
        "version" => "it is of a version that this program does not read; use a newer authros".to_owned(),
        _ => format!("the {field} has an invalid value"),
    }
}

/// Takes fields from the front of a byte slice; never reads past its end, never allocates more than it holds.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    pub fn take(&mut self, count: usize, field: &'static str) -> Result<&'a [u8], WireError> {
        let (head, rest) = self.rest.split_at_checked(count).ok_or(WireError::Short(field))?;
        self.rest = rest;
        Ok(head)
    }

    pub fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let (head, rest) = self.rest.split_first_chunk().ok_or(WireError::Short(field))?;
        self.rest = rest;
        Ok(*head)
    }

    /// With a two-byte length before it.
    pub fn text(&mut self, field: &'static str) -> Result<String, WireError> {
        let length = usize::from(self.u16(field)?);
        let bytes = self.take(length, field)?;
        std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| WireError::Value(field))
    }

    /// Nothing may be left.
    pub fn end(&self) -> Result<(), WireError> {
        if self.rest.is_empty() { Ok(()) } else { Err(WireError::Long(self.rest.len())) }
    }
}

/// A value with exactly one encoding.
pub trait Wire: Sized {
    fn put(&self, out: &mut Vec<u8>);

    /// Takes it from the front; errors call it `field`.
    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError>;

    fn encoded(&self) -> Vec<u8> {
        self.behind(&[])
    }

    /// Nothing may be left over.
    fn whole(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let value = Self::read(&mut reader, "structure")?;
        reader.end()?;
        Ok(value)
    }

    /// Its encoding behind a label.
    fn behind(&self, label: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(256);
        out.extend_from_slice(label);
        self.put(&mut out);
        out
    }

    /// Errors call the label `field`.
    fn whole_behind(label: &[u8], field: &'static str, bytes: &[u8]) -> Result<Self, WireError> {
        Self::whole(bytes.strip_prefix(label).ok_or(WireError::Value(field))?)
    }
}

/// Structures whose encoding is that of their fields, in this order, each with what errors call it.
#[macro_export]
macro_rules! layout {
    ($($name:ident { $($field:ident: $word:literal),+ $(,)? })+) => {$(
        impl $crate::wire::Wire for $name {
            fn put(&self, out: &mut Vec<u8>) {
                $($crate::wire::Wire::put(&self.$field, out);)+
            }

            fn read(reader: &mut $crate::wire::Reader<'_>, _: &'static str) -> Result<Self, $crate::wire::WireError> {
                $(let $field = $crate::wire::Wire::read(reader, $word)?;)+
                Ok(Self { $($field),+ })
            }
        }
    )+};
    ($($name:ident(0))+) => {$(
        impl $crate::wire::Wire for $name {
            fn put(&self, out: &mut Vec<u8>) {
                $crate::wire::Wire::put(&self.0, out);
            }

            fn read(
                reader: &mut $crate::wire::Reader<'_>,
                field: &'static str,
            ) -> Result<Self, $crate::wire::WireError> {
                $crate::wire::Wire::read(reader, field).map(Self)
            }
        }
    )+};
    ($($name:ident by $code:ident, $from:ident)+) => {$(
        impl $crate::wire::Wire for $name {
            fn put(&self, out: &mut Vec<u8>) {
                $crate::wire::Wire::put(&self.$code(), out);
            }

            fn read(reader: &mut $crate::wire::Reader<'_>, field: &'static str) -> Result<Self, $crate::wire::WireError> {
                Self::$from($crate::wire::Wire::read(reader, field)?).ok_or($crate::wire::WireError::Value(field))
            }
        }
    )+};
}

/// `encode` and `parse` of a body that consists of a label, called `$word` in errors, and one encoding.
#[macro_export]
macro_rules! body {
    ($name:ident behind $label:expr, $word:literal) => {
        impl $name {
            /// Its encoding.
            pub fn encode(&self) -> Vec<u8> {
                $crate::wire::Wire::behind(self, $label)
            }

            /// From its encoding; only the form is checked.
            /// # Errors
            /// If the bytes are not exactly one.
            pub fn parse(bytes: &[u8]) -> Result<Self, $crate::wire::WireError> {
                $crate::wire::Wire::whole_behind($label, $word, bytes)
            }
        }
    };
    ($name:ident) => {
        $crate::body!($name behind &[], "label");
    };
}

macro_rules! numbers {
    ($($number:ident)+) => {$(
        impl Reader<'_> {
            pub fn $number(&mut self, field: &'static str) -> Result<$number, WireError> {
                self.array(field).map($number::from_be_bytes)
            }
        }

        impl Wire for $number {
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_be_bytes());
            }

            fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
                reader.$number(field)
            }
        }
    )+};
}

numbers!(u8 u16 u32 u64);

impl<const N: usize> Wire for [u8; N] {
    fn put(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(self);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        reader.array(field)
    }
}

/// 1 or 0.
impl Wire for bool {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(u8::from(*self));
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        match reader.u8(field)? {
            byte @ 0..=1 => Ok(byte == 1),
            _ => Err(WireError::Value(field)),
        }
    }
}

/// With a two-byte length before it.
impl Wire for String {
    fn put(&self, out: &mut Vec<u8>) {
        put_text(out, self);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        reader.text(field)
    }
}

/// With a four-byte length before them.
impl Wire for Vec<u8> {
    fn put(&self, out: &mut Vec<u8>) {
        u32::try_from(self.len()).unwrap_or(u32::MAX).put(out);
        out.extend_from_slice(self);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        let length = usize::try_from(reader.u32(field)?).unwrap_or(usize::MAX);
        Ok(reader.take(length, field)?.to_vec())
    }
}

/// 0, or 1 and the value.
impl<T: Wire> Wire for Option<T> {
    fn put(&self, out: &mut Vec<u8>) {
        self.is_some().put(out);
        self.iter().for_each(|value| value.put(out));
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        bool::read(reader, field)?.then(|| T::read(reader, field)).transpose()
    }
}

macro_rules! tuples {
    ($(($($part:ident $at:tt),+))+) => {$(
        impl<$($part: Wire),+> Wire for ($($part),+) {
            fn put(&self, out: &mut Vec<u8>) {
                $(self.$at.put(out);)+
            }

            fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
                Ok(($($part::read(reader, field)?),+))
            }
        }
    )+};
}

tuples!((A 0, B 1) (A 0, B 1, C 2) (A 0, B 1, C 2, D 3));

/// Appends how many there are, and each; what is beyond `most` is cut.
pub fn put_list<Count: Wire + TryFrom<usize> + Default>(out: &mut Vec<u8>, list: &[impl Wire], most: usize) {
    let list = &list[..list.len().min(most)];
    Count::try_from(list.len()).unwrap_or_default().put(out);
    list.iter().for_each(|one| one.put(out));
}

/// As many as their count says, which must be in `allowed`. Errors call the count `fields.0`, an item `fields.1`.
pub fn read_list<Count: Wire + TryInto<usize>, One: Wire>(
    reader: &mut Reader<'_>,
    allowed: std::ops::RangeInclusive<usize>,
    fields: (&'static str, &'static str),
) -> Result<Vec<One>, WireError> {
    let count = Count::read(reader, fields.0)?.try_into().ok().filter(|count| allowed.contains(count));
    let count = count.ok_or(WireError::Value(fields.0))?;
    (0..count).map(|_| One::read(reader, fields.1)).collect()
}

/// Appends `text` with a two-byte length before it, truncated to 65,535 bytes at a character boundary.
pub fn put_text(out: &mut Vec<u8>, text: &str) {
    let kept = &text[..text.floor_char_boundary(usize::from(u16::MAX))];
    let length = u16::try_from(kept.len()).unwrap_or(u16::MAX);
    out.extend_from_slice(&length.to_be_bytes());
    out.extend_from_slice(kept.as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_in_order_and_refuses_short_and_long() {
        let mut out = vec![7];
        put_text(&mut out, "hé");
        let mut reader = Reader::new(&out);
        assert_eq!(reader.u8("a"), Ok(7));
        assert_eq!(reader.text("b").as_deref(), Ok("hé"));
        assert_eq!(reader.end(), Ok(()));
        assert_eq!(reader.u16("c"), Err(WireError::Short("c")));
        assert_eq!(Reader::new(&[0]).end(), Err(WireError::Long(1)));
        assert_eq!(Reader::new(&[0, 9, 1]).text("t"), Err(WireError::Short("t")));
    }
}
