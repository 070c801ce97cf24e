//! An X.509 certificate (RFC 5280), as much of it as a stamp needs.

use authros_model::{Timestamp, clean};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::der::{Der, Element, OCTETS, SEQUENCE, SET, context, primitive, seconds};
use super::signature::{Key, Scheme};
use super::{TimeError, form, names};

const PART: &str = "certificate";
const BEGIN: &str = "-----BEGIN CERTIFICATE-----";
const END: &str = "-----END CERTIFICATE-----";
/// keyCertSign, the sixth bit of keyUsage.
const MAY_SIGN_CERTIFICATES: u8 = 0x04;
/// digitalSignature and nonRepudiation.
const MAY_SIGN: u8 = 0xc0;

/// A certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Certificate {
    pub(super) der: Vec<u8>,
    pub(super) signed: Vec<u8>,
    /// How it is signed; not each way is one that is checked here.
    pub(super) scheme: Result<Scheme, TimeError>,
    pub(super) signature: Vec<u8>,
    pub(super) serial: Vec<u8>,
    pub(super) issuer: Vec<u8>,
    pub(super) subject: Vec<u8>,
    pub(super) from: u64,
    pub(super) until: u64,
    pub(super) key: Key,
    pub(super) uses: Uses,
}

/// What its extensions say.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Uses {
    /// It may issue others, with so many between it and the last at most; without a limit, that is `u64::MAX`.
    pub issuer: Option<u64>,
    /// The first byte of keyUsage.
    pub key: Option<u8>,
    /// A critical extended key usage that names timeStamping and nothing else.
    pub stamps: bool,
    /// It has a critical extension that nothing here knows.
    pub unknown: bool,
}

impl Uses {
    pub fn may_issue(&self) -> bool {
        self.issuer.is_some() && self.key.is_none_or(|bits| bits & MAY_SIGN_CERTIFICATES != 0)
    }

    pub fn may_stamp(&self) -> bool {
        self.stamps && self.key.is_none_or(|bits| bits & MAY_SIGN != 0)
    }
}

impl Certificate {
    /// From DER.
    ///
    /// # Errors
    /// [`TimeError`] where it is none, or signed in an unknown way.
    pub fn parse(der: &[u8]) -> Result<Self, TimeError> {
        let mut outer = Der::only(PART, der, SEQUENCE)?;
        let signed = outer.element(SEQUENCE)?;
        let algorithm = outer.element(SEQUENCE)?.whole;
        let scheme = match Scheme::read(&mut Der::new(PART, algorithm)?) {
            Err(error @ TimeError::Form { .. }) => return Err(error),
            found => found,
        };
        let signature = outer.bits()?.to_vec();
        outer.end()?;
        let mut inner = Der::new(PART, signed.content)?;
        if let Some(mut version) = inner.inside_optional(context(0))? {
            version.small()?;
            version.end()?;
        }
        let serial = inner.integer()?.to_vec();
        if inner.element(SEQUENCE)?.whole != algorithm {
            return Err(form(PART, "it names two signature algorithms"));
        }
        let issuer = inner.element(SEQUENCE)?.whole.to_vec();
        let mut validity = inner.inside(SEQUENCE)?;
        let (from, until) = (validity.any()?, validity.any()?);
        validity.end()?;
        let subject = inner.element(SEQUENCE)?.whole.to_vec();
        let key = Key::read(&mut inner)?;
        for unique in [1, 2] {
            inner.optional(primitive(unique))?;
        }
        let uses = match inner.inside_optional(context(3))? {
            Some(extensions) => uses(extensions)?,
            None => Uses::default(),
        };
        inner.end()?;
        let (from, until) = (seconds(from, PART, false)?, seconds(until, PART, false)?);
        let (der, signed) = (der.to_vec(), signed.whole.to_vec());
        Ok(Self { der, signed, scheme, signature, serial, issuer, subject, from, until, key, uses })
    }

    /// From PEM: the first certificate of it.
    ///
    /// # Errors
    /// [`TimeError`] where there is none.
    pub fn from_pem(text: &str) -> Result<Self, TimeError> {
        let after = text.split_once(BEGIN).map(|(_, after)| after);
        let body = after.and_then(|after| after.split_once(END)).map(|(body, _)| body);
        let body = body.ok_or_else(|| form(PART, "it is not a PEM certificate"))?;
        let plain: String = body.split_ascii_whitespace().collect();
        let bytes = STANDARD.decode(plain).map_err(|_| form(PART, "its PEM is broken"))?;
        Self::parse(&bytes)
    }

    /// As DER.
    pub fn der(&self) -> &[u8] {
        &self.der
    }

    /// What names it: the common name of its subject, else its serial number, for people.
    pub fn name(&self) -> String {
        common_name(&self.subject).unwrap_or_else(|| {
            let digits: String = self.serial.iter().take(20).map(|byte| format!("{byte:02x}")).collect();
            format!("serial number {digits}")
        })
    }

    /// Whether it was valid at a time, seconds.
    pub(super) fn valid_at(&self, at: u64) -> Result<(), TimeError> {
        if (self.from..=self.until).contains(&at) {
            return Ok(());
        }
        let [at, from, until] = [at, self.from, self.until].map(Timestamp::from_seconds);
        Err(TimeError::NotValid { name: self.name(), at, from, until })
    }
}

fn uses(mut der: Der<'_>) -> Result<Uses, TimeError> {
    let (mut uses, mut seen) = (Uses::default(), Vec::new());
    let mut all = der.inside(SEQUENCE)?;
    der.end()?;
    while !all.is_empty() {
        let mut one = all.inside(SEQUENCE)?;
        let name = one.object()?;
        if seen.contains(&name) {
            return Err(form(PART, "an extension appears twice"));
        }
        seen.push(name);
        let is_critical = if one.next_tag() == Some(super::der::BOOLEAN) { one.boolean()? } else { false };
        let value = one.element(OCTETS)?;
        one.end()?;
        uses.take(name, is_critical, value)?;
    }
    Ok(uses)
}

impl Uses {
    fn take(&mut self, name: &[u8], is_critical: bool, value: Element<'_>) -> Result<(), TimeError> {
        match name {
            names::BASIC_CONSTRAINTS => {
                let mut inner = Der::only(PART, value.content, SEQUENCE)?;
                let issues = inner.next_tag() == Some(super::der::BOOLEAN) && inner.boolean()?;
                let most = if inner.is_empty() { u64::MAX } else { inner.small()? };
                inner.end()?;
                self.issuer = issues.then_some(most);
            }
            names::KEY_USAGE => {
                let mut outer = Der::new(PART, value.content)?;
                let bits = outer.element(super::der::BITS)?.content;
                outer.end()?;
                self.key = Some(bits.get(1).copied().unwrap_or(0));
            }
            names::EXTENDED_KEY_USAGE => {
                let mut inner = Der::only(PART, value.content, SEQUENCE)?;
                let first = inner.object()?;
                self.stamps = is_critical && first == names::TIME_STAMPING && inner.is_empty();
            }
            names::POLICIES => {}
            _ => self.unknown |= is_critical,
        }
        Ok(())
    }
}

/// The last common name in a distinguished name, cleaned.
fn common_name(name: &[u8]) -> Option<String> {
    const COMMON_NAME: &[u8] = b"\x55\x04\x03";
    let mut parts = Der::only(PART, name, SEQUENCE).ok()?;
    let mut found = None;
    while !parts.is_empty() {
        let mut set = parts.inside(SET).ok()?;
        while !set.is_empty() {
            let mut one = set.inside(SEQUENCE).ok()?;
            if one.object().ok()? == COMMON_NAME {
                found = Some(clean(&String::from_utf8_lossy(one.any().ok()?.content), 80));
            }
        }
    }
    found
}
