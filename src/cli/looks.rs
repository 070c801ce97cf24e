//! The console's appearance and keys: flags, settings, and the operator's own files.

use std::path::Path;

use super::args::ConsoleArguments;
use super::connect::Context;
use super::passphrase;
use crate::app::Keymap;
use crate::model::ErrorKind;
use crate::paths::Home;
use crate::service::Failure;
use crate::term::ConsoleOptions;
use crate::ui::Themes;

/// The longest file read, bytes.
const LONGEST: u64 = 256 * 1024;

/// The result of flags, settings and files.
///
/// # Errors
/// If a file is wrong, with file and line.
pub fn options(context: &Context, arguments: ConsoleArguments) -> Result<ConsoleOptions, Failure> {
    let settings = &context.config.console;
    let options = ConsoleOptions {
        theme: arguments.theme.or_else(|| settings.theme.clone()),
        themes: themes(&context.home)?,
        keymap: keymap(&context.home)?,
        ascii: arguments.ascii
            || settings.ascii.unwrap_or_else(|| !locale_has_unicode(|name| std::env::var(name).ok())),
        mouse: settings.mouse,
        operator: context.operator.as_ref().map(|operator| operator.name.to_string()),
        read_only: arguments.read_only,
        bytes_per_second: settings.bytes_per_second,
        directory: None,
        kept: Some(context.home.console(&context.profile)),
        pictures: settings.pictures,
        // The keyring is the owner's to lock and to unlock.
        lock_after: settings.lock_after.filter(|_| context.operator.is_none()),
        profiles: if context.operator.is_some() { Vec::new() } else { context.home.profiles() },
        tour: None,
        leaves_site: false,
        asks_passphrase: context.operator.is_none()
            && !passphrase::is_given(&context.global, &context.home, &context.profile),
    };
    if let Some(name) = &options.theme {
        options.themes.named(name).map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))?;
    }
    Ok(options)
}

fn keymap(home: &Home) -> Result<Keymap, Failure> {
    let path = home.keymap();
    let Some(text) = read(&path)? else { return Ok(Keymap::default()) };
    Keymap::with_file(&path.display().to_string(), &text)
        .map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))
}

fn themes(home: &Home) -> Result<Themes, Failure> {
    let entries = std::fs::read_dir(home.themes()).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut paths: Vec<_> = entries.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    paths.sort();
    let mut files = Vec::new();
    for path in paths {
        files.extend(read(&path)?.map(|text| (path.display().to_string(), text)));
    }
    Themes::with_files(&files).map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))
}

/// A file of the operator's; `None` if there is none.
fn read(path: &Path) -> Result<Option<String>, Failure> {
    let wrong = |what: String| Failure::new(ErrorKind::Input, format!("{}: {what}", path.display()));
    match std::fs::metadata(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(wrong(error.to_string())),
        Ok(about) if about.len() > LONGEST => return Err(wrong(format!("longer than {LONGEST} bytes"))),
        Ok(_) => {}
    }
    std::fs::read_to_string(path).map(Some).map_err(|error| wrong(error.to_string()))
}

/// Whether the locale allows more than ASCII; if it does not say, terminals nowadays do.
fn locale_has_unicode(variable: impl Fn(&str) -> Option<String>) -> bool {
    let set = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().filter_map(variable).find(|value| !value.is_empty());
    set.is_none_or(|value| {
        let value = value.to_ascii_lowercase();
        value.contains("utf-8") || value.contains("utf8")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_locale_variable_that_is_set_decides() {
        let with = |pairs: &'static [(&str, &str)]| {
            locale_has_unicode(|name| {
                pairs.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
            })
        };
        assert!(with(&[]) && with(&[("LANG", "de_DE.UTF-8")]) && with(&[("LC_ALL", ""), ("LANG", "C.utf8")]));
        assert!(!with(&[("LANG", "C")]) && !with(&[("LC_ALL", "POSIX"), ("LANG", "C.UTF-8")]));
    }
}
