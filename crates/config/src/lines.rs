//! The lines of the keys in a TOML text.

use std::collections::BTreeMap;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::ConfigError;
use crate::model::clean;

/// The line of each key of a file, from 1; the second table of `[[watch]]` is `watch.1`, its topic `watch.1.topic`.
#[derive(Debug)]
pub(super) struct Lines {
    /// The file's name in messages.
    pub file: String,
    lines: BTreeMap<String, usize>,
}

impl Lines {
    /// The lines of `text`; invalid TOML yields none.
    pub fn of(file: &str, text: &str) -> Self {
        let ends: Vec<usize> = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
        let line = |at: usize| ends.partition_point(|end| *end < at) + 1;
        let mut lines = Self { file: file.to_owned(), lines: BTreeMap::new() };
        if let Ok(document) = DeTable::parse(text) {
            lines.table("", document.get_ref(), &line);
        }
        lines
    }

    /// The line of a key, otherwise of what contains it; the first line if neither is known.
    pub fn line(&self, name: &str) -> usize {
        let mut name = name;
        loop {
            match (self.lines.get(name), name.rsplit_once('.')) {
                (Some(line), _) => return *line,
                (None, Some((outer, _))) => name = outer,
                (None, None) => return 1,
            }
        }
    }

    /// The error for a key or table that is invalid.
    pub fn fault(&self, name: &str, what: &str) -> ConfigError {
        ConfigError::Entry { file: self.file.clone(), line: self.line(name), what: clean(what, 300) }
    }

    fn table(&mut self, prefix: &str, table: &DeTable<'_>, line: &impl Fn(usize) -> usize) {
        for (key, value) in table {
            let name =
                if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
            self.value(name, line(key.span().start), value, line);
        }
    }

    fn value(&mut self, name: String, at: usize, value: &Spanned<DeValue<'_>>, line: &impl Fn(usize) -> usize) {
        if let DeValue::Table(inner) = value.get_ref() {
            self.table(&name, inner, line);
        }
        if let DeValue::Array(parts) = value.get_ref() {
            for (index, part) in parts.iter().enumerate() {
                self.value(format!("{name}.{index}"), line(part.span().start), part, line);
            }
        }
        self.lines.insert(name, at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_of_the_same_name_are_told_apart() {
        let text = "robots = 1\n[chain]\nurl = \"a\"\n\n[cache]\nurl = \"b\"\n[[watch]]\ntopic = \"/a\"\n\n[[watch]]\n# c\n\
                    type = \"x\"\ndisk.reserve = \"1\"\n";
        let lines = Lines::of("f", text);
        let line = |name: &str| lines.line(name);
        assert_eq!((line("robots"), line("chain.url"), line("cache.url"), line("watch.0.topic")), (1, 3, 6, 8));
        assert_eq!((line("watch.1.type"), line("watch.1.disk.reserve")), (12, 13));
        assert_eq!((line("watch.1.topic"), line("nothing")), (10, 1), "what is not there is where it would stand");
        assert_eq!(Lines::of("f", "a = ").line("a"), 1);
    }
}
