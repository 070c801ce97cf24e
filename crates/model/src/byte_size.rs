//! A number of bytes as people write it: `268435456`, `512 KiB`, `256MiB`, `1.5 GiB`, `10GB`.

use std::fmt;
use std::str::FromStr;

use super::clean;

/// Units by their suffix, longest first.
const UNITS: [(&str, u64); 9] = [
    ("kib", 1 << 10),
    ("mib", 1 << 20),
    ("gib", 1 << 30),
    ("tib", 1 << 40),
    ("kb", 1_000),
    ("mb", 1_000_000),
    ("gb", 1_000_000_000),
    ("tb", 1_000_000_000_000),
    ("b", 1),
];

/// A number of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct ByteSize(pub u64);

/// Why a text is not a number of bytes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a size; give one such as 256MiB, 10GB or 1048576")]
pub struct ByteSizeError(String);

impl FromStr for ByteSize {
    type Err = ByteSizeError;

    fn from_str(text: &str) -> Result<Self, ByteSizeError> {
        let wrong = || ByteSizeError(clean(text, 40));
        let lower = text.trim().to_ascii_lowercase();
        let (number, unit) = UNITS
            .iter()
            .find_map(|(name, unit)| lower.strip_suffix(name).map(|number| (number, *unit)))
            .unwrap_or((&lower, 1));
        let (whole, part) = number.trim_end().split_once('.').unwrap_or((number.trim_end(), ""));
        let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        if !digits(whole) || !part.is_empty() && (!digits(part) || part.len() > 6) || number.trim_end().ends_with('.') {
            return Err(wrong());
        }
        let whole: u64 = whole.parse().map_err(|_| wrong())?;
        let scale = 10u128.pow(u32::try_from(part.len()).unwrap_or(0));
        let part = part.parse::<u128>().unwrap_or(0) * u128::from(unit) / scale;
        let bytes = u128::from(whole) * u128::from(unit) + part;
        u64::try_from(bytes).ok().filter(|bytes| *bytes < 1 << 62).map(Self).ok_or_else(wrong)
    }
}

impl fmt::Display for ByteSize {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fitting = UNITS[..4].iter().rev().find(|(_, unit)| self.0 >= *unit);
        let Some((name, unit)) = fitting else { return write!(formatter, "{} B", self.0) };
        let name = match *name {
            "kib" => "KiB",
            "mib" => "MiB",
            "gib" => "GiB",
            _ => "TiB",
        };
        let tenths = u128::from(self.0) * 10 / u128::from(*unit);
        match tenths % 10 {
            0 => write!(formatter, "{} {name}", tenths / 10),
            tenth => write!(formatter, "{}.{tenth} {name}", tenths / 10),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_as_people_write_them() {
        let read = |text: &str| text.parse::<ByteSize>().map(|size| size.0).ok();
        assert_eq!(read("0"), Some(0));
        assert_eq!(
            (read("256MiB"), read("256 mib"), read("1.5 KiB")),
            (Some(268_435_456), Some(268_435_456), Some(1536))
        );
        assert_eq!((read("10GB"), read("12 b"), read("2TiB")), (Some(10_000_000_000), Some(12), Some(2 << 40)));
        for bad in ["", "MiB", "-1", "1.", "1.x MB", "1e9", "9999999999TiB", "10 XB", "1 2"] {
            assert_eq!(read(bad), None, "{bad}");
        }
        assert_eq!(ByteSize(268_435_456).to_string(), "256 MiB");
        assert_eq!((ByteSize(1536).to_string(), ByteSize(900).to_string()), ("1.5 KiB".into(), "900 B".into()));
    }
}
