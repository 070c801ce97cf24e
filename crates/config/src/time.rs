//! The time stamp authorities to ask.

use std::path::PathBuf;

use super::error::ConfigError;
use super::read::{Values, value, wrong};
use crate::model::clean;

/// The most authorities.
const MOST: usize = 4;
/// The form of the setting's value.
const FORM: &str =
    "use [{ name = \"NAME\", url = \"http://HOST/PATH\", certificate = \"/PATH/OF.pem\" }], at most four of them";

/// A time stamp authority (RFC 3161).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TimeAuthority {
    /// Its name; the host of its URL unless a name was set.
    pub name: String,
    /// Its address for requests.
    pub url: String,
    /// The file with its certificate, or that of its issuer, PEM.
    pub certificate: PathBuf,
}

/// A list of tables in the file, the same text in a variable.
pub(super) fn authorities(values: &Values) -> Result<Vec<TimeAuthority>, ConfigError> {
    let Some(text) = value(values, "time.authorities") else { return Ok(Vec::new()) };
    let wrong = |what: &str| wrong(values, "time.authorities", what);
    let table: toml::Table = format!("authorities = {text}").parse().map_err(|_| wrong(FORM))?;
    let list = table.get("authorities").and_then(|list| list.as_array()).ok_or_else(|| wrong(FORM))?;
    if list.len() > MOST {
        return Err(wrong(FORM));
    }
    let mut found: Vec<TimeAuthority> = Vec::new();
    for entry in list {
        let authority = entry.as_table().and_then(authority).ok_or_else(|| wrong(FORM))?;
        if found.iter().any(|known| known.name == authority.name) {
            return Err(wrong("two authorities share a name; give each its own"));
        }
        if !authority.certificate.is_absolute() || !authority.certificate.is_file() {
            return Err(wrong("certificate must be the absolute path of a PEM file"));
        }
        found.push(authority);
    }
    Ok(found)
}

fn authority(table: &toml::Table) -> Option<TimeAuthority> {
    if table.keys().any(|key| !["name", "url", "certificate"].contains(&key.as_str())) {
        return None;
    }
    let text = |key: &str| table.get(key).and_then(|value| value.as_str()).filter(|text| !text.is_empty());
    let url = text("url").filter(|url| url.len() <= 500 && url.bytes().all(|byte| byte.is_ascii_graphic()))?;
    let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"))?;
    let host = rest.split('/').next().filter(|host| !host.is_empty() && !host.contains('@'))?;
    let name = match table.get("name") {
        Some(_) => text("name").filter(|name| name.len() <= 80 && clean(name, 80) == **name)?,
        None => host,
    };
    let (name, url) = (name.to_owned(), url.to_owned());
    Some(TimeAuthority { name, url, certificate: PathBuf::from(text("certificate")?) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;

    fn read(text: &str) -> Result<Vec<TimeAuthority>, String> {
        let path = std::path::Path::new("config.toml");
        let none = |_: &str| None;
        let config = Config::resolve(&none, &none, Some((path, text)));
        config.map(|config| config.time_authorities).map_err(|error| error.to_string())
    }

    #[test]
    fn authorities_are_a_list_of_tables() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let path = file.path().display();
        let one = format!("[[time.authorities]]\nurl = \"http://127.0.0.1:9/tsa\"\ncertificate = \"{path}\"\n");
        let two =
            format!("{one}[[time.authorities]]\nname = \"Two\"\nurl = \"https://h/\"\ncertificate = \"{path}\"\n");
        let found = read(&two).expect("usable");
        let told: Vec<(&str, &str)> = found.iter().map(|one| (one.name.as_str(), one.url.as_str())).collect();
        assert_eq!(told, [("127.0.0.1:9", "http://127.0.0.1:9/tsa"), ("Two", "https://h/")]);
        assert_eq!(found[0].certificate, file.path());
        assert_eq!(read(""), Ok(Vec::new()));
        assert!(read(&format!("{one}{one}")).expect_err("twice").contains("share a name"));
        assert!(read(&one.repeat(5)).is_err());
        for (from, to) in [
            ("http://", "ftp://"),
            ("http://127", "http://a@127"),
            ("url", "uri"),
            ("certificate = \"/", "certificate = \""),
        ] {
            assert!(read(&one.replacen(from, to, 1)).is_err(), "{from}");
        }
        assert!(read("[time]\nauthorities = \"http://h/\"").is_err());
    }
}
