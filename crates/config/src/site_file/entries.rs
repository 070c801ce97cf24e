//! The lists of a site file: `[[watch]]`, `[[publisher]]`, `[[contact]]`, `[[admitted]]`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::str::FromStr;

use super::{Decisions, KnownAccount, Lines, MOST_CONTACTS};
use crate::ConfigError;
use crate::crypto::Fingerprint;
use crate::model::{Publisher, TopicName, clean};

/// The most entries of any other list.
const MOST: usize = 10_000;

/// One table of a list.
struct Entry<'a> {
    file: &'a str,
    lines: &'a Lines,
    /// `watch.0`.
    name: String,
    table: &'a toml::Table,
}

/// Takes the lists out of a document.
pub(super) fn read(document: &mut toml::Table, file: &str, lines: &Lines) -> Result<Decisions, ConfigError> {
    let watches = list(document, file, lines, "watch", &["topic", "type"], |entry, list: &mut BTreeMap<_, _>| {
        let (topic, type_name) = (entry.needed("topic")?, entry.text("type")?);
        Ok(list.insert(topic, type_name).is_none())
    })?;
    let keys = ["topic", "publisher"];
    let publishers = list(document, file, lines, "publisher", &keys, |entry, list: &mut BTreeSet<_>| {
        Ok(list.insert((entry.needed::<TopicName>("topic")?, entry.needed::<Publisher>("publisher")?)))
    })?;
    let keys = ["name", "address", "fingerprint"];
    let contacts = list(document, file, lines, "contact", &keys, |entry, list: &mut BTreeMap<_, KnownAccount>| {
        let (name, address) = (entry.needed("name")?, entry.needed("address")?);
        let fingerprint = entry.text::<Fingerprint>("fingerprint")?.map(|fingerprint| fingerprint.to_string());
        let another = list.values().all(|known| known.address != address);
        Ok(list.insert(name, KnownAccount { address, fingerprint }).is_none() && another)
    })?;
    let admitted = list(document, file, lines, "admitted", &["owner"], |entry, list: &mut BTreeSet<_>| {
        Ok(list.insert(entry.needed("owner")?))
    })?;
    Ok(Decisions { watches, publishers, contacts, admitted })
}

/// A list, if the document contains it; `add` returns whether an entry is new.
fn list<List: Default>(
    document: &mut toml::Table,
    file: &str,
    lines: &Lines,
    name: &str,
    keys: &[&str],
    add: impl Fn(&Entry<'_>, &mut List) -> Result<bool, ConfigError>,
) -> Result<Option<List>, ConfigError> {
    let Some(value) = document.remove(name) else { return Ok(None) };
    let fault = |place: &str, what: String| {
        Err(ConfigError::Entry { file: file.to_owned(), line: lines.line(place), what: clean(&what, 300) })
    };
    let Some(values) = value.as_array() else {
        return fault(name, format!("write '{name}' as [[{name}]] tables"));
    };
    let most = if name == "contact" { MOST_CONTACTS } else { MOST };
    if values.len() > most {
        return fault(name, format!("there are more than {most} [[{name}]] tables; remove some"));
    }
    let mut list = List::default();
    for (index, value) in values.iter().enumerate() {
        let place = format!("{name}.{index}");
        let Some(table) = value.as_table() else {
            return fault(&place, format!("write '{name}' as [[{name}]] tables"));
        };
        if let Some(key) = table.keys().find(|key| !keys.contains(&key.as_str())) {
            return fault(
                &format!("{place}.{key}"),
                format!("[[{name}]] has no key '{key}'; its keys are {}", keys.join(", ")),
            );
        }
        if !add(&Entry { file, lines, name: place.clone(), table }, &mut list)? {
            return fault(&place, format!("this [[{name}]] appears twice; remove one of them"));
        }
    }
    Ok(Some(list))
}

impl Entry<'_> {
    fn text<T: FromStr<Err: Display>>(&self, key: &str) -> Result<Option<T>, ConfigError> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        let text = value.as_str().ok_or_else(|| self.fault(key, format!("write {key} as \"text\"")))?;
        text.parse().map(Some).map_err(|error: T::Err| self.fault(key, error.to_string()))
    }

    fn needed<T: FromStr<Err: Display>>(&self, key: &str) -> Result<T, ConfigError> {
        self.text(key)?.ok_or_else(|| self.fault(key, format!("'{key}' is missing")))
    }

    fn fault(&self, key: &str, what: String) -> ConfigError {
        let line = self.lines.line(&format!("{}.{key}", self.name));
        ConfigError::Entry { file: self.file.to_owned(), line, what: clean(&what, 300) }
    }
}
