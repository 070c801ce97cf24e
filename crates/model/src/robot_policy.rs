//! What a robot tells of the policy that its owner sets for it.

use super::wire::{Reader, Wire, WireError, put_list, read_list};

const LABEL: &[u8] = b"AuthROS/policy/1";
/// The most differences named.
const MOST: usize = 64;
/// The longest text, bytes.
const LONGEST: usize = 1024;

/// `label (16) || heard (8) || running (8) || 0, or 1 || reason || count (1, at most 64) || differences`; each text has
/// its length (2, at most 1,024) before it. Sealed as a statement of the robot's recorder.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PolicyReport {
    /// The newest version received.
    pub heard: u64,
    /// The version in force; 0 = its own settings alone.
    pub running: u64,
    /// Why the newest version was not applied.
    pub refused: Option<String>,
    /// Where the policy overrules its own settings.
    pub overruled: Vec<String>,
}

impl PolicyReport {
    pub const TYPE: &'static str = "authros/PolicyReport";

    /// Encodes the bytes to be sealed; what is too long or too much is cut.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = (self.heard, self.running).behind(LABEL);
        self.refused.as_deref().map(cut).put(&mut out);
        put_list::<u8>(&mut out, &self.overruled.iter().map(|text| cut(text)).collect::<Vec<_>>(), MOST);
        out
    }

    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes.strip_prefix(LABEL).ok_or(WireError::Value("label"))?);
        let (heard, running) = (reader.u64("heard")?, reader.u64("running")?);
        let refused: Option<String> = Wire::read(&mut reader, "refused")?;
        let overruled: Vec<String> = read_list::<u8, _>(&mut reader, 0..=MOST, ("count", "text"))?;
        reader.end()?;
        if refused.iter().chain(&overruled).any(|text| text.len() > LONGEST) {
            return Err(WireError::Value("text"));
        }
        Ok(Self { heard, running, refused, overruled })
    }
}

fn cut(text: &str) -> String {
    text[..text.floor_char_boundary(LONGEST)].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_too_long_is_cut_and_can_be_read() {
        let report = PolicyReport {
            refused: Some("ä".repeat(4000)),
            overruled: vec!["x".repeat(2000); 100],
            ..PolicyReport::default()
        };
        let read = PolicyReport::parse(&report.encode()).expect("it fits");
        assert_eq!(read.refused.expect("a reason").len(), LONGEST);
        assert_eq!((read.overruled.len(), read.overruled[0].len()), (MOST, LONGEST));
    }

    proptest! {
        #[test]
        fn round_trip_and_every_cut_is_refused(
            heard: u64, running: u64, refused in proptest::option::of("[ -~]{0,40}"),
            overruled in proptest::collection::vec("[ -~]{0,20}", 0..4), noise: Vec<u8>
        ) {
            let report = PolicyReport { heard, running, refused, overruled };
            let bytes = report.encode();
            prop_assert_eq!(PolicyReport::parse(&bytes), Ok(report));
            prop_assert!((0..bytes.len()).all(|cut| PolicyReport::parse(&bytes[..cut]).is_err()));
            prop_assert!(PolicyReport::parse(&[bytes, vec![0]].concat()).is_err());
            let _ = PolicyReport::parse(&[LABEL, &noise].concat());
        }
    }
}
