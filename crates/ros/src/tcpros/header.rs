//! The connection header of TCPROS: fields `key=value`, each with its length before it.

/// The longest header accepted, bytes.
pub(crate) const LONGEST_HEADER: usize = 1 << 20;

/// The most fields in a header.
const MOST_FIELDS: usize = 64;

/// A connection header: its fields in order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct ConnectionHeader(Vec<(String, String)>);

impl ConnectionHeader {
    /// With these fields.
    pub fn new<'a>(fields: impl IntoIterator<Item = (&'a str, &'a str)>) -> Self {
        Self(fields.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect())
    }

    /// The value of a field.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }

    /// From the bytes after the length; invalid UTF-8 is replaced.
    pub fn parse(mut bytes: &[u8]) -> Result<Self, &'static str> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let (prefix, rest) = bytes.split_first_chunk().ok_or("a field's length is cut short")?;
            let length = usize::try_from(u32::from_le_bytes(*prefix)).map_err(|_| "a field is too long")?;
            let (field, rest) = rest.split_at_checked(length).ok_or("a field is cut short")?;
            let text = String::from_utf8_lossy(field);
            let (key, value) = text.split_once('=').ok_or("a field has no '='")?;
            if fields.len() == MOST_FIELDS {
                return Err("it has too many fields");
            }
            fields.push((key.to_owned(), value.to_owned()));
            bytes = rest;
        }
        Ok(Self(fields))
    }

    /// The bytes as sent, total length first. Fields beyond what 32 bits can count are left out.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        for (key, value) in &self.0 {
            if let Ok(length) = u32::try_from(key.len() + 1 + value.len()) {
                body.extend_from_slice(&length.to_le_bytes());
                body.extend_from_slice(key.as_bytes());
                body.push(b'=');
                body.extend_from_slice(value.as_bytes());
            }
        }
        let total = u32::try_from(body.len()).unwrap_or(u32::MAX);
        [total.to_le_bytes().as_slice(), &body].concat()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn broken_headers_are_refused() {
        assert_eq!(ConnectionHeader::parse(&[1, 0, 0]), Err("a field's length is cut short"));
        assert_eq!(ConnectionHeader::parse(&[255, 255, 255, 255, b'a']), Err("a field is cut short"));
        assert_eq!(ConnectionHeader::parse(&[1, 0, 0, 0, b'a']), Err("a field has no '='"));
        assert_eq!(ConnectionHeader::parse(&[2, 0, 0, 0, b'a', b'='].repeat(65)), Err("it has too many fields"));
        assert_eq!(ConnectionHeader::parse(&[]), Ok(ConnectionHeader::default()));
    }

    proptest! {
        #[test]
        fn round_trip_and_every_cut(fields in prop::collection::vec(("[a-z]{1,8}", ".{0,20}"), 1..6)) {
            let header = ConnectionHeader(fields);
            let bytes = header.to_bytes();
            let total = u32::try_from(bytes.len() - 4).expect("short");
            prop_assert_eq!(bytes.first_chunk(), Some(&total.to_le_bytes()));
            prop_assert_eq!(ConnectionHeader::parse(&bytes[4..]), Ok(header.clone()));
            for end in 5..bytes.len() {
                prop_assert_ne!(ConnectionHeader::parse(&bytes[4..end]), Ok(header.clone()));
            }
        }

        #[test]
        fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = ConnectionHeader::parse(&bytes);
        }
    }
}
