//! Forms of which there is one spelling: lines with names are never a list, and RLP has its shortest form. What two
//! readers could take differently is refused before it means anything.

use rlp::Rlp;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// How deep lists of RLP may lie in each other: headers and nodes of a trie have less.
const DEEPEST: usize = 32;

/// Reads JSON of exactly this form: where it has lines with names, a list of their values is refused, too.
///
/// # Errors
/// What is wrong, in words.
pub(crate) fn from_json<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    let read: T = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let told = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    expect_shape(&told, &read)?;
    Ok(read)
}

/// The same of TOML.
///
/// # Errors
/// What is wrong, in words.
pub(crate) fn from_toml<T: Serialize + DeserializeOwned>(text: &str) -> Result<T, String> {
    let read: T = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    let told: toml::Table = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    expect_shape(&serde_json::to_value(told).map_err(|error| error.to_string())?, &read)?;
    Ok(read)
}

/// Serde takes a structure from a list of its values, too; written again, it is not one.
fn expect_shape<T: Serialize>(told: &Value, read: &T) -> Result<(), String> {
    let written = serde_json::to_value(read).map_err(|error| error.to_string())?;
    if is_of_shape(told, &written) { Ok(()) } else { Err("a list stands in place of lines with names".to_owned()) }
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

/// The length of the item at the beginning, if it is canonical.
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
