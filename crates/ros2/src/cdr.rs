//! Reading what a peer serialised by the first version of CDR; every length is checked against the bytes that are there.

/// Reads a body from its first byte on; numbers are aligned by their size.
pub struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Reader<'a> {
    /// Of a message with its four bytes of header; `None` for another encoding.
    pub fn of(message: &'a [u8]) -> Option<Self> {
        let (header, body) = message.split_at_checked(4)?;
        (header[0] == 0 && header[1] <= 1).then_some(Self { body, at: 0, little: header[1] == 1 })
    }

    /// The bytes that are left.
    pub fn left(&self) -> usize {
        self.body.len() - self.at.min(self.body.len())
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(length)?;
        let found = self.body.get(self.at..end)?;
        self.at = end;
        Some(found)
    }

    fn aligned<const LENGTH: usize>(&mut self) -> Option<[u8; LENGTH]> {
        self.at = self.at.next_multiple_of(LENGTH);
        let mut bytes: [u8; LENGTH] = self.take(LENGTH)?.try_into().ok()?;
        if !self.little {
            bytes.reverse();
        }
        Some(bytes)
    }

    /// One byte.
    pub fn byte(&mut self) -> Option<u8> {
        self.aligned::<1>().map(|[byte]| byte)
    }

    /// A number of 32 bits.
    pub fn number(&mut self) -> Option<u32> {
        self.aligned().map(u32::from_le_bytes)
    }

    /// A number of 64 bits.
    pub fn long(&mut self) -> Option<u64> {
        self.aligned().map(u64::from_le_bytes)
    }

    /// The length of a list whose elements take `least` bytes each, or more.
    pub fn count(&mut self, least: usize) -> Option<usize> {
        let count = self.number()? as usize;
        (count <= self.left() / least).then_some(count)
    }

    /// A text.
    pub fn text(&mut self) -> Option<&'a str> {
        let length = self.number()? as usize;
        let bytes = self.take(length)?;
        std::str::from_utf8(bytes.strip_suffix(&[0]).unwrap_or(bytes)).ok()
    }

    /// An id of 16 bytes in a field of this many.
    pub fn id(&mut self, length: usize) -> Option<[u8; 16]> {
        self.take(length)?.first_chunk().copied()
    }
}

/// Writes a body, little-endian.
#[derive(Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    fn aligned(&mut self, bytes: &[u8]) {
        self.0.resize(self.0.len().next_multiple_of(bytes.len()), 0);
        self.0.extend_from_slice(bytes);
    }

    /// A number of 64 bits.
    pub fn long(&mut self, number: u64) {
        self.aligned(&number.to_le_bytes());
    }

    /// A text; one longer than 32 bits can say is written as empty.
    pub fn text(&mut self, text: &str) {
        let (text, length) = u32::try_from(text.len() + 1).map_or(("", 1), |length| (text, length));
        self.aligned(&length.to_le_bytes());
        self.0.extend(text.bytes().chain([0]));
    }

    /// Yes or no.
    pub fn truth(&mut self, truth: bool) {
        self.0.push(u8::from(truth));
    }
}
