//! `manifest.json`: every member with its length and hashes, the claimed chain, and the exporter's signature. Each form
//! has one spelling: what two readers could take differently is refused before it means anything.

use authros_crypto::{Provider, pool, signature_from_der, signer_id};
use authros_model::{Address, Hash, PublicKey, SignerId, clean};
use rlp::Rlp;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;
use sha2::{Digest as _, Sha256};

use crate::BundleError;
use crate::archive::{MIMETYPE, Members};

/// The form of a bundle.
pub const FORMAT: &str = "authros-evidence/1";
/// The content of `mimetype`, and the type that the exporter's signature is for.
pub const MEDIA_TYPE: &str = "application/vnd.authros.evidence+zip";
pub const MANIFEST: &str = "manifest.json";
pub const SIGNATURE: &str = "manifest.der";
const AT_ONCE: usize = 64;
/// Members not in the manifest: itself, its signature, and those that are the same in each bundle.
const UNLISTED: [&str; 3] = [MIMETYPE, MANIFEST, SIGNATURE];

/// The manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// The names of its suite and algorithms, compared with those of this version.
    pub suite: Suite,
    /// The chain that it claims to be of.
    pub chain: ClaimedChain,
    /// Its exporter.
    pub exporter: Exporter,
    /// Every other member, by name.
    pub members: Vec<Member>,
}

/// A suite and its algorithms, by their names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the names of algorithms, by their use")]
pub struct Suite {
    pub name: String,
    pub signature: String,
    pub digest: String,
    pub cipher: String,
    pub kdf: String,
    pub chain: String,
}

impl Suite {
    /// The one that this version knows.
    pub fn known() -> Self {
        let [name, signature, digest, cipher, kdf, chain] =
            ["SM/1", "SM2-SM3", "SM3", "SM4-GCM", "HKDF-SM3", "Keccak-256"].map(str::to_owned);
        Self { name, signature, digest, cipher, kdf, chain }
    }
}

/// A chain and its contract, as the exporter names them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClaimedChain {
    /// Its id (EIP-155).
    pub id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    /// The contract.
    pub contract: Address,
}

/// Who made a bundle.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exporter {
    /// The account.
    pub account: Address,
    /// SM3 of the key that signed the manifest; the key is among the members.
    pub key: SignerId,
}

/// One member.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// Its name.
    pub name: String,
    /// Its length.
    pub bytes: u64,
    /// SM3 of it.
    pub sm3: Hash,
    /// SHA-256 of it.
    pub sha256: Hash,
}

impl Member {
    fn of_each(members: &[(&String, &Vec<u8>)], provider: &dyn Provider) -> Vec<Self> {
        let texts: Vec<&[u8]> = members.iter().map(|(_, bytes)| bytes.as_slice()).collect();
        let of = |((name, bytes), sm3): (&(&String, &Vec<u8>), [u8; 32])| {
            let (sm3, sha256) = (Hash(sm3), Hash(Sha256::digest(bytes).into()));
            Self { name: (*name).clone(), bytes: bytes.len() as u64, sm3, sha256 }
        };
        members.iter().zip(provider.sm3_many(&texts)).map(of).collect()
    }
}

impl Manifest {
    /// Of these members.
    pub fn of(members: &Members, chain: ClaimedChain, exporter: Exporter, provider: &dyn Provider) -> Self {
        let listed: Vec<(&String, &Vec<u8>)> =
            members.iter().filter(|(name, _)| !UNLISTED.contains(&name.as_str())).collect();
        let bytes = listed.iter().map(|(_, bytes)| bytes.len()).fold(0, usize::saturating_add);
        let pieces: Vec<&[(&String, &Vec<u8>)]> = listed.chunks(AT_ONCE).collect();
        let hashed = |piece: &&[(&String, &Vec<u8>)]| Member::of_each(piece, provider);
        let members = pool::each(&pieces, pool::helpers_for(pieces.len(), bytes), hashed);
        let members = members.into_iter().flatten().collect();
        Self { format: FORMAT.to_owned(), suite: Suite::known(), chain, exporter, members }
    }

    /// From a bundle's members: it names each of them as it is, and no other.
    /// # Errors
    /// [`BundleError`] for the first that differs.
    pub fn read(members: &Members, provider: &dyn Provider) -> Result<Self, BundleError> {
        if members.get(MIMETYPE).is_none_or(|text| text != MEDIA_TYPE.as_bytes()) {
            return Err(BundleError::of(MIMETYPE, "does not say that this is an evidence bundle"));
        }
        let text = members.get(MANIFEST).ok_or_else(|| BundleError::of(MANIFEST, "is missing"))?;
        // Before the form, which a later version may have changed.
        if let Some(format) = named_format(text).filter(|format| format != FORMAT) {
            let found = clean(&format, 40);
            let text = format!("has the format '{found}', but this program reads {FORMAT}; use a newer authros");
            return Err(BundleError::of(MANIFEST, &text));
        }
        let manifest: Self = from_json(text).map_err(|error| BundleError::of(MANIFEST, &error))?;
        if manifest.suite != Suite::known() {
            let (found, known) = (clean(&manifest.suite.name, 40), Suite::known().name);
            let text =
                format!("has the suite '{found}' or other algorithms, but this program knows those of {known} alone");
            return Err(BundleError::of(MANIFEST, &text));
        }
        let expected = Self::of(members, manifest.chain.clone(), manifest.exporter.clone(), provider);
        let (mut named, mut there) = (manifest.members.iter(), expected.members.iter());
        loop {
            match (named.next(), there.next()) {
                (None, None) => return Ok(manifest),
                (Some(named), Some(there)) if named == there => {}
                (Some(named), Some(there)) if named.name == there.name => {
                    return Err(BundleError::of(&named.name, "does not match the manifest: its bytes were altered"));
                }
                (Some(named), there) if there.is_none_or(|there| named.name < there.name) => {
                    return Err(BundleError::of(&named.name, "is named in the manifest but missing"));
                }
                (_, Some(there)) => {
                    return Err(BundleError::of(&there.name, "is present but not named in the manifest"));
                }
                (Some(named), None) => {
                    return Err(BundleError::of(&named.name, "is named in the manifest but missing"));
                }
            }
        }
    }
}

/// DSSE's pre-authentication encoding, which no other text has.
pub fn signed_bytes(manifest: &[u8]) -> Vec<u8> {
    let head = format!("DSSEv1 {} {MEDIA_TYPE} {} ", MEDIA_TYPE.len(), manifest.len());
    [head.as_bytes(), manifest].concat()
}

pub fn is_signed(members: &Members, exporter: &Exporter, key: &PublicKey, provider: &dyn Provider) -> bool {
    let (Some(text), Some(signature)) = (members.get(MANIFEST), members.get(SIGNATURE)) else { return false };
    let Ok(signature) = signature_from_der(signature) else { return false };
    signer_id(key) == exporter.key && provider.verify(key, &signed_bytes(text), &signature).is_ok()
}

/// Deepest nesting of RLP lists; headers and nodes of a trie have less.
const DEEPEST: usize = 32;

pub(crate) fn to_json(member: &str, value: &impl Serialize) -> Result<Vec<u8>, BundleError> {
    serde_json::to_vec_pretty(value).map_err(|error| BundleError::of(member, &error.to_string()))
}

/// The `format` that a JSON document names, whatever else it has.
pub fn named_format(bytes: &[u8]) -> Option<String> {
    let told: Value = serde_json::from_slice(bytes).ok()?;
    told.get("format")?.as_str().map(str::to_owned)
}

/// Refuses a list of values in place of lines with names.
pub(crate) fn from_json<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    let read: T = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let told = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    expect_shape(&told, &read)?;
    Ok(read)
}

pub(crate) fn from_toml<T: Serialize + DeserializeOwned>(text: &str) -> Result<T, String> {
    let read: T = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    let told: toml::Table = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    expect_shape(&serde_json::to_value(told).map_err(|error| error.to_string())?, &read)?;
    Ok(read)
}

/// Serde takes a structure from a list of its values, too; written again, it is no list.
fn expect_shape<T: Serialize>(told: &Value, read: &T) -> Result<(), String> {
    let written = serde_json::to_value(read).map_err(|error| error.to_string())?;
    if is_of_shape(told, &written) { Ok(()) } else { Err("a list stands where named lines belong".to_owned()) }
}

fn is_of_shape(told: &Value, written: &Value) -> bool {
    match (told, written) {
        (Value::Object(told), Value::Object(written)) => told.iter().all(|(name, value)| match written.get(name) {
            Some(written) => is_of_shape(value, written),
            // An empty list is not written.
            None => value.as_array().is_some_and(Vec::is_empty),
        }),
        (Value::Array(told), Value::Array(written)) => {
            told.len() == written.len() && told.iter().zip(written).all(|(told, written)| is_of_shape(told, written))
        }
        (Value::String(_), Value::String(_))
        | (Value::Number(_), Value::Number(_))
        | (Value::Bool(_), Value::Bool(_)) => true,
        _ => false,
    }
}

/// Whether these bytes are one item of RLP, each length of it in its shortest form.
pub(crate) fn is_canonical(bytes: &[u8]) -> bool {
    item(bytes, 0) == Some(bytes.len())
}

/// The bytes of an item that is no list; `Rlp::data` gives those of a list as well.
pub(crate) fn text<'a>(item: &Rlp<'a>) -> Option<&'a [u8]> {
    if item.is_list() { None } else { item.data().ok() }
}

fn item(bytes: &[u8], depth: usize) -> Option<usize> {
    let first = *bytes.first()?;
    let (base, is_list) = match first {
        0..=0x7f => return Some(1),
        0x80..=0xbf => (0x80, false),
        _ => (0xc0, true),
    };
    let short = usize::from(first - base);
    let (begin, length) = match short.checked_sub(55) {
        None | Some(0) => (1, short),
        Some(digits) => {
            let digits = bytes.get(1..=digits)?;
            let length = digits
                .iter()
                .try_fold(0usize, |length, digit| Some(length.checked_mul(256)?.saturating_add(usize::from(*digit))))?;
            if digits.first() == Some(&0) || length <= 55 {
                return None;
            }
            (1 + digits.len(), length)
        }
    };
    let end = begin.checked_add(length)?;
    let mut content = bytes.get(begin..end)?;
    if !is_list {
        let is_short = begin == 1 && matches!(content, [0..=0x7f]);
        return (!is_short).then_some(end);
    }
    while !content.is_empty() {
        let used = if depth < DEEPEST { item(content, depth + 1)? } else { return None };
        content = content.get(used..)?;
    }
    Some(end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ClaimedChain;

    #[test]
    fn lines_with_names_are_no_list() {
        let (zero, account) = ("00".repeat(32), format!("0x{}", "c0".repeat(20)));
        let good = format!(r#"{{"id":7,"genesis":"{zero}","contract":"{account}"}}"#);
        from_json::<ClaimedChain>(good.as_bytes()).expect("the form");
        let list = format!(r#"[7,"{zero}","{account}"]"#);
        serde_json::from_str::<ClaimedChain>(&list).expect("serde takes it");
        let why = from_json::<ClaimedChain>(list.as_bytes()).expect_err("refused");
        assert!(why.contains("a list"), "{why}");
        from_toml::<ClaimedChain>(&format!("id = 7\ngenesis = \"{zero}\"\ncontract = \"{account}\""))
            .expect("the form");
        for wrong in ["7", "\"text\"", "null", "{}", "[]"] {
            assert!(from_json::<ClaimedChain>(wrong.as_bytes()).is_err(), "{wrong}");
        }
    }

    #[test]
    fn rlp_has_one_form() {
        let long = [&[0xb8, 56][..], &[1; 56]].concat();
        for good in [&[0x80][..], &[0x7f], &[0x81, 0x80], &[0xc0], &[0xc2, 0xc0, 5], &long] {
            assert!(is_canonical(good), "{good:02x?}");
        }
        let padded = [&[0xb9, 0, 56][..], &[1; 56]].concat();
        let short = [&[0xb8, 55][..], &[1; 55]].concat();
        let huge = [0xbf, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff];
        for bad in [&[][..], &[0x81, 0x7f], &[0x81], &[0x80, 0], &[0xc2, 0x81, 5], &[0xc1], &padded, &short, &huge] {
            assert!(!is_canonical(bad), "{bad:02x?}");
        }
        let nested = |levels: usize| {
            (0..levels).fold(vec![0xc0], |inner, _| {
                let mut list = rlp::RlpStream::new_list(1);
                list.append_raw(&inner, 1);
                list.out().to_vec()
            })
        };
        assert!(is_canonical(&nested(DEEPEST)) && !is_canonical(&nested(DEEPEST + 1)));
    }
}
