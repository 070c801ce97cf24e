//! Encoding and parsing of fixed-order binary structures, big endian, with bounded lengths.

/// Why bytes do not have the expected structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// Fewer bytes than the structure needs.
    #[error("the data ends before the {0}")]
    Short(&'static str),
    /// Bytes are left over.
    #[error("{0} bytes are left over after the end")]
    Long(usize),
    /// A field holds a value that is not allowed.
    #[error("the {0} has an invalid value")]
    Value(&'static str),
}

/// Takes fields from the front of a byte slice; never reads past its end, never allocates more than it holds.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Over all of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// The unread rest.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The next `count` bytes.
    pub fn take(&mut self, count: usize, field: &'static str) -> Result<&'a [u8], WireError> {
        let (head, rest) = self.rest.split_at_checked(count).ok_or(WireError::Short(field))?;
        self.rest = rest;
        Ok(head)
    }

    /// The next `N` bytes as an array.
    pub fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let (head, rest) = self.rest.split_first_chunk().ok_or(WireError::Short(field))?;
        self.rest = rest;
        Ok(*head)
    }

    /// One byte.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, WireError> {
        self.array(field).map(u8::from_be_bytes)
    }

    /// Two bytes, big endian.
    pub fn u16(&mut self, field: &'static str) -> Result<u16, WireError> {
        self.array(field).map(u16::from_be_bytes)
    }

    /// Four bytes, big endian.
    pub fn u32(&mut self, field: &'static str) -> Result<u32, WireError> {
        self.array(field).map(u32::from_be_bytes)
    }

    /// Eight bytes, big endian.
    pub fn u64(&mut self, field: &'static str) -> Result<u64, WireError> {
        self.array(field).map(u64::from_be_bytes)
    }

    /// A text with a two-byte length before it.
    ///
    /// # Errors
    /// [`WireError`] if it is truncated or not UTF-8.
    pub fn text(&mut self, field: &'static str) -> Result<String, WireError> {
        let length = usize::from(self.u16(field)?);
        let bytes = self.take(length, field)?;
        std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| WireError::Value(field))
    }

    /// Ends parsing: nothing may be left.
    pub fn end(&self) -> Result<(), WireError> {
        if self.rest.is_empty() { Ok(()) } else { Err(WireError::Long(self.rest.len())) }
    }
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
